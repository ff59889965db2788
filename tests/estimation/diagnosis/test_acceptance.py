"""Which effects of a model stand by their names: needed, no part of another, and no stand-in for a law."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimation.diagnosis import acceptance as module
from estimation.diagnosis.acceptance import (
    accept_effects,
    acceptance_criteria,
    effects_by_importance,
    indistinguishable_models,
    models_by_importance,
)
from estimation.diagnosis.bootstrap import BootstrapTest
from estimation.effects import EFFECTS
from estimation.fit.measurement_model import identify_measurement_model
from tests.estimation.searches import SWING, reached, searched
from tests.estimation.swings import swings

SPRING, RUB, RIPPLE, BIAS, SQUARE = (
    "joint_spring",
    "coulomb_friction",
    "torque_ripple",
    "bias",
    "quadratic_friction",
)


def strange(q, v, a):
    """A torque that no effect here draws."""
    return 0.05 * np.sin(8.0 * q) * q


def rubbing(size):
    return lambda q, v, a: size * np.tanh(v / 0.02)


LAWS = {
    "a spring and a friction": lambda q, v, a: 6.0 * q + rubbing(0.1)(q, v, a),
    "a friction": rubbing(0.3),
    "a friction and what nobody knows": lambda q, v, a: rubbing(0.5)(q, v, a) + strange(q, v, a),
    "a large friction and a small zero": lambda q, v, a: rubbing(2.0)(q, v, a) + 0.015,
}


@pytest.fixture(scope="module")
def searches():
    made = {}

    def of(law, base=SWING):
        if law not in made:
            data = swings(1, LAWS[law])
            made[law] = searched(data, SPRING, RUB, BIAS, SQUARE, base=base), identify_measurement_model(data)
        return made[law]

    return of


@pytest.mark.parametrize(
    ("law", "found", "complete", "kept"),
    [
        ("a spring and a friction", (SPRING, RUB), True, {SPRING, RUB}),
        ("a spring and a friction", (RUB, SPRING), False, {SPRING, RUB}),
        ("a spring and a friction", (), True, set()),
        ("a friction", (RUB, BIAS), True, {RUB}),  # what is not there is needless
        ("a friction", (SPRING,), False, set()),
        ("a friction", (SQUARE,), False, set()),  # an impostor leaves structure in the direction
        ("a friction and what nobody knows", (RUB,), False, {RUB}),  # it is found, whatever remains
        ("a friction and what nobody knows", (RUB, BIAS), False, {RUB}),
        ("a large friction and a small zero", (RUB, BIAS), True, {RUB}),  # less than a twentieth of all
    ],
)
def test_what_stands_by_its_name(searches, law, found, complete, kept):
    search, measurement = searches(law)
    end = accept_effects(search, reached(search, *found), measurement, complete=complete)
    assert set(search.added_effects(end)) == kept


def test_an_effect_that_turns_a_base_gain_beyond_its_bounds_is_not_established(searches, monkeypatch):
    search, measurement = searches("a friction")
    end = reached(search, RUB)
    monkeypatch.setattr(type(search), "is_sensible", lambda self, one: one is not end)
    assert accept_effects(search, end, measurement, complete=True) is search.start


def test_effects_come_with_the_most_telling_first(searches):
    search, _ = searches("a spring and a friction")
    end = reached(search, RUB, SPRING)
    assert effects_by_importance(search, end) == [SPRING, RUB]
    assert [set(search.added_effects(one)) for one in models_by_importance(search, end)] == [
        {SPRING},
        {RUB, SPRING},
    ]
    assert models_by_importance(search, search.start) == []
    assert effects_by_importance(search, search.start) == []


def test_models_are_held_against_a_law_without_a_name_block_by_block(searches):
    """Beside a base model that lacks a friction, such a law finds it; beside the friction, nothing."""
    search, _ = searches("a friction")
    end = reached(search, RUB)
    held = acceptance_criteria(search.start, end)
    blocks = end.problem.used.sum()
    assert held.named == pytest.approx(np.sum(end.solution.held_out) / blocks, rel=0.01)
    assert held.base > 20.0 * held.named
    assert held.nameless < 3.0 * held.named
    assert held.both == pytest.approx(held.named, rel=0.1)
    assert held.is_satisfied
    assert not held.is_outperformed
    assert acceptance_criteria(end, search.start).base == held.named


@pytest.fixture
def refused(monkeypatch):
    """Draws that refuse what a test says; the figure itself is `gained`'s own."""
    asked = []

    def refuse(which=lambda before, after: False):
        def gained(before, after, measurement, rng, effect=""):
            asked.append((before, after, effect))
            return BootstrapTest(1.0 if which(before, after) else 0.0, np.zeros(2))

        monkeypatch.setattr(module, "improvement_test", gained)
        return asked

    return refuse


def names(fit):
    return {one.name for one in fit.solution.model.effects} - {"pendulum", "viscous_friction"}


def test_the_smallest_part_from_which_draws_gain_as_much_by_the_whole_is_enough(searches, refused):
    search, measurement = searches("a spring and a friction")
    end = reached(search, SPRING, RUB)
    asked = refused(lambda before, after: not names(before))  # only the base model is refused
    found = accept_effects(search, end, measurement, complete=True)
    assert names(found) == {SPRING}
    assert [names(before) for before, after, _ in asked if after is end] == [set(), {SPRING}]


@pytest.mark.parametrize("others_refused", [False, True])
def test_a_rival_explains_half_of_what_the_effect_does_and_is_not_refused(searches, refused, others_refused):
    """Of friction: a spring explains nothing of it."""
    search, measurement = searches("a friction")
    end = reached(search, RUB)
    asked = refused(lambda before, after: others_refused)
    found = indistinguishable_models(search, end, RUB, measurement)
    assert RUB not in found
    assert SPRING not in found
    assert all(after is end for _, after, _ in asked)
    without = search.without(end, RUB)
    for name, one in found.items():
        assert search.added_effects(one) == [name]
        assert one.solution.held_out <= 0.5 * (without.solution.held_out + end.solution.held_out)
    assert not (others_refused and found)


@pytest.mark.parametrize(
    ("same", "found"),
    [(False, {"stribeck_friction", "load_dependent_friction"}), (True, {"load_dependent_friction"})],
)
def test_what_needs_more_parameters_to_draw_the_same_is_no_rival(refused, same, found, monkeypatch):
    """Friction that falls with the speed: with the load it has one parameter more.

    What creeps no way at all before it slides is another's name for the same, and no rival either.
    """
    refused()
    monkeypatch.setattr(module, "_is_same_curve", lambda *_: same)
    data = swings(1, lambda q, v, a: (0.2 + 0.15 * np.exp(-((v / 0.6) ** 2))) * np.tanh(v / 0.01))
    others = ("stribeck_friction", "presliding_friction", "load_dependent_friction", SPRING)
    search = searched(data, RUB, *others)
    assert (
        indistinguishable_models(search, reached(search, RUB), RUB, identify_measurement_model(data)).keys()
        == found
    )


def curve(values):
    return SimpleNamespace(solution=SimpleNamespace(residual=np.asarray(values)))


@pytest.mark.parametrize(
    ("one", "other", "without", "same"),
    [
        ([0.0, 0.0], [0.03, 0.0], [1.0, 0.0], True),  # by a thousandth of the energy of what both add
        ([0.0, 0.0], [0.04, 0.0], [1.0, 0.0], False),
        ([0.0, 0.0], [0.3, 0.0], [10.0, 0.0], True),
        ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], False),  # nothing is added
        ([0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], False),  # the contact begins elsewhere
        ([0.0, 0.0], [0.0, 0.0], [1.0, 0.0, 0.0], False),
    ],
)
def test_curves_are_the_same_but_for_a_small_share_of_what_they_add(one, other, without, same):
    assert module._is_same_curve(*map(curve, (one, other, without))) is same


@pytest.mark.parametrize(
    ("before", "left", "smooth", "outweighs"),
    [(3.0, 2.0, 1.0, True), (2.9, 2.0, 1.0, False), (2.0, 1.0, 1.0, True)],
)
def test_an_effect_takes_away_more_than_a_smooth_law_still_could(before, left, smooth, outweighs):
    one = SimpleNamespace(solution=SimpleNamespace(held_out=before))
    end = SimpleNamespace(
        solution=SimpleNamespace(held_out=left), flexible=SimpleNamespace(explained=left - smooth)
    )
    assert module._outweighs_the_rest(one, end) is outweighs


def _models(signals, shares):
    """A model with an effect, which leaves 1 of 4.33 a block, and that without it."""
    effect = SimpleNamespace(name="e", signals=signals)
    end, without = (
        SimpleNamespace(
            solution=SimpleNamespace(model=SimpleNamespace(effects=(effect,)), held_out=size),
            problem=SimpleNamespace(used=np.ones(10, dtype=bool)),
            held_out_mean_square=size / 10.0,
            filters=((7,), ()),
            flexible=SimpleNamespace(by_signal=shares, before=np.full(2, size / 2.0)),
        )
        for size in (10.0, 43.3)
    )
    return SimpleNamespace(without=lambda *_: without), end


@pytest.mark.parametrize(
    ("signals", "shares", "left"),
    [
        (("velocity",), {"velocity": 0.2, "load": 0.3}, 0.2),
        (("velocity", "load"), {"velocity": 0.2, "load": 0.3}, 0.3),
        (("velocity",), {"position": 0.9}, 0.0),  # in another's: not its fault
        (("past effort",), {"effort": 0.4}, 0.4),
        (("other joints",), {"joint velocity": 0.4}, 0.4),
        (("recorded",), {"temperature": 0.4}, 0.4),
        (("recorded",), {"velocity": 0.4}, 0.0),
    ],
)
def test_what_an_effect_leaves_in_its_own_signals(signals, shares, left):
    """Of an error of 1 a block."""
    assert module._left_of_its_own(_models(signals, shares)[1], "e") == pytest.approx(left)


@pytest.mark.parametrize(
    ("own", "noise", "follows"),
    [
        (0.2, 0.1, True),
        (0.2, 0.09, False),  # more than twice the noise
        (0.03, 0.001, True),  # no more than a hundredth of what the effect takes away
        (0.04, 0.001, False),
    ],
)
def test_a_wrong_law_leaves_more_than_noise_in_its_own_signals(own, noise, follows):
    search, end = _models(("velocity",), {"velocity": own})
    assert module._follows_its_law(search, end, "e", noise) is follows


@pytest.mark.parametrize(
    ("own", "beside", "stands"),
    [
        (0.2, 2.0, True),
        (0.4, 2.0, False),  # more than a tenth of what the effect takes away is left in its own signals
        (0.2, 1.12, True),
        (0.2, 1.1, False),  # a smooth law of the others does as well, within a twentieth of the error
    ],
)
def test_what_an_impostor_does_not_do_by_itself(own, beside, stands, monkeypatch):
    def flexible(problem, solution, filters, signals):
        assert (filters, signals) == (((7,), ()), ["velocity"])
        return SimpleNamespace(held_out=np.array([1.0 if solution is end.solution else beside]))

    search, end = _models(("velocity",), {"velocity": own})
    monkeypatch.setattr(module, "fit_flexible", flexible)
    assert module._stands_by_itself(search, end, "e") is stands


def test_an_effect_that_takes_away_more_than_is_left_is_not_nothing(searches):
    """Though nobody looked at its interval."""
    search, _ = searches("a friction")
    end = reached(search, RUB, BIAS)
    assert not module._may_be_nothing(search.start, end, RUB)
    assert module._may_be_nothing(search.without(end, BIAS), end, BIAS)
    half, whole = (SimpleNamespace(flexible=SimpleNamespace(before=np.array([one]))) for one in (1.0, 2.0))
    assert not module._may_be_nothing(whole, half, RUB)


def test_parts_that_are_fewer_than_their_whole_are_held_against_it():
    """Friction and a bias, where one effect has both; a whole of which a part is missing is no rival."""
    data = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.01) + 0.1)
    search = searched(data, RUB, BIAS, "asymmetric_friction")
    end = reached(search, RUB, BIAS)
    assert [one.name for one in module._wholes(search, end, RUB)] == ["asymmetric_friction"]
    assert module._wholes(search, reached(search, RUB), RUB) == []
    assert module._wholes(search, end, "pendulum") == []
    whole = module._with_whole(search, end, EFFECTS["asymmetric_friction"]())
    assert search.added_effects(whole) == ["asymmetric_friction"]
    assert whole.rmse == pytest.approx(end.rmse, rel=0.02)
    present = replace(search, effects=(*search.effects, EFFECTS[SPRING]()))
    assert module._wholes(present, reached(search, "asymmetric_friction"), RUB) == []
