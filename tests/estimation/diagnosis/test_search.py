"""Which effects the search tries in earnest, and which of laws that are alike bears the name."""

import numpy as np
import pytest

from estimation.diagnosis.candidates import Candidate
from estimation.diagnosis.established import simplest
from estimation.diagnosis.search import LEVEL, search_of
from estimation.effects import EFFECTS
from estimation.fit.inner_search import Attempts
from estimation.fit.readings import readings_of
from estimation.fit.standing import fit
from estimation.fit.trial import attempt
from estimation.model import Model
from tests.estimation.swings import swings

BASE = tuple(EFFECTS[name]() for name in ("pendulum", "viscous_friction"))


def rippling(q, v, a):
    return 0.3 * np.sin(15.0 * q) + 0.3 * np.tanh(v / 0.01)


@pytest.mark.parametrize("cycles", [14.9, 15.1])
def test_a_candidate_is_judged_as_if_the_parameters_of_the_others_followed(cycles):
    """A ripple whose period is off hides what friction explains; its slope by the period shows that."""
    ripple, friction = EFFECTS["torque_ripple"](), EFFECTS["coulomb_friction"]()
    model = Model("pendulum", (*BASE, ripple, friction))
    inner = {"torque_ripple.cycles": cycles, "coulomb_friction.transition": 0.01}
    whole = fit(swings(1, rippling), model, {**inner, "torque_ripple.cycles": 15.0})
    off = attempt(whole.plain, model, inner)
    followed = Candidate(friction, Attempts((off,), 1)).followed(whole.plain)
    assert off.held_out > 1.5 * whole.trial.held_out
    assert followed == pytest.approx(whole.trial.held_out, rel=0.1)


@pytest.mark.parametrize(("backward", "expected"), [(0.3, "coulomb_friction"), (0.15, "asymmetric_friction")])
@pytest.mark.parametrize("is_as_complete", [True, False])
def test_the_simplest_law_bears_the_name_where_the_data_and_what_is_left_allow(
    backward, expected, is_as_complete
):
    """Friction fitted as asymmetric; it is, or is the same both ways."""
    data = swings(1, lambda q, v, a: np.where(v > 0.0, 0.3, backward) * np.tanh(v / 0.01))
    effects = tuple(EFFECTS[name]() for name in ("coulomb_friction", "asymmetric_friction"))
    good = np.ones(len(data), dtype=np.bool_)
    search = search_of(data, Model("pendulum", BASE), good, effects, np.random.default_rng(0))
    tried = {one.effect.name: one for one in search.screened(search.start)}
    end = search.with_candidate(tried["asymmetric_friction"])
    found = simplest(search, end, readings_of(data), lambda one: is_as_complete or one is end)
    assert search.added(found) == [expected if is_as_complete else "asymmetric_friction"]


@pytest.mark.parametrize(("friction_nm", "needed"), [(0.004, False), (0.03, True)])
def test_what_is_certain_but_small_is_not_needed(friction_nm, needed):
    """Both take away more than chance would; one of them less than a twentieth of the error."""
    data = swings(1, lambda q, v, a: friction_nm * np.tanh(v / 0.01))
    good = np.ones(len(data), dtype=np.bool_)
    search = search_of(
        data, Model("pendulum", BASE), good, (EFFECTS["coulomb_friction"](),), np.random.default_rng(0)
    )
    (candidate,) = search.screened(search.start)
    end = search.with_candidate(candidate)
    assert search.p_value(search.start, end) <= LEVEL
    assert (end.rmse < 0.95 * search.start.rmse) == needed
    assert search.is_needed(search.start, end) == needed


@pytest.mark.parametrize(
    ("driven_before", "driven_after", "sound"),
    [(False, False, True), (False, True, False), (True, True, True), (True, False, True)],
)
def test_a_base_gain_may_be_beyond_its_bounds_only_if_it_was_from_the_start(
    driven_before, driven_after, sound
):
    """A joint that something drives has a negative friction."""

    def search(driven):
        data = swings(1, lambda q, v, a: -0.5 * driven * v)
        good, rng = np.ones(len(data), dtype=np.bool_), np.random.default_rng(0)
        return search_of(data, Model("pendulum", BASE), good, (), rng)

    after = search(driven_after).start
    assert search(driven_before).is_sound(after, "viscous_friction") == sound
    assert search(driven_before).is_sensible(after) == sound


def test_of_models_that_leave_as_much_the_simpler_is_better():
    data = swings(1)
    good, rng = np.ones(len(data), dtype=np.bool_), np.random.default_rng(0)
    search = search_of(data, Model("pendulum", BASE), good, (EFFECTS["coulomb_friction"](),), rng)
    larger = search.with_candidate(search.screened(search.start)[0])
    assert larger.trial.held_out == pytest.approx(search.start.trial.held_out, rel=0.02)
    assert search.is_better(search.start, larger)
    assert not search.is_better(larger, search.start)
