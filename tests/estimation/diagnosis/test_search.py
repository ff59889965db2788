"""Model search: which effects are tried, and which of equivalent laws is named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.diagnosis import acceptance
from palpate.estimation.diagnosis import search as module
from palpate.estimation.diagnosis.acceptance import indistinguishable_models, most_parsimonious
from palpate.estimation.diagnosis.bootstrap import BootstrapTest
from palpate.estimation.diagnosis.candidates import Candidate
from palpate.estimation.diagnosis.forms import analyze_kinds
from palpate.estimation.diagnosis.search import Search, _key, _select_runs, backward_step, prepare_search
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.inner_search import GridSearch
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.kinds import Kind
from palpate.estimation.model import Model
from tests.estimation.presses import NOISE_N, kelvin_voigt, maxwell, session
from tests.estimation.searches import PRESS, ROTOR, SWING, measured, reached, searched
from tests.estimation.swings import INERTIA, WEIGHT
from tests.estimation.swings import coarse_swings as swings
from tests.estimation.swings import swings as all_swings

BASE = SWING.effects


def rippling(q, v, a):
    return 0.3 * np.sin(15.0 * q) + 0.3 * np.tanh(v / 0.01)


@pytest.mark.parametrize("cycles", [14.9, 15.1])
def test_candidate_is_judged_with_refitted_parameters_of_the_others(cycles):
    """A ripple whose period is off hides what friction explains; its slope by the period shows that."""
    ripple, friction = EFFECTS["torque_ripple"](), EFFECTS["coulomb_friction"]()
    model = Model("pendulum", (*BASE, ripple, friction))
    inner = {"torque_ripple.cycles": cycles, "coulomb_friction.transition": 0.01}
    whole = fit_model(swings(1, rippling), model, {**inner, "torque_ripple.cycles": 15.0})
    off = solve_gains(whole.problem, model, inner)
    error_with_adapted_inner = Candidate(friction, GridSearch((off,), 1)).error_with_adapted_inner(
        whole.problem
    )
    assert off.held_out > 1.5 * whole.solution.held_out
    assert error_with_adapted_inner == pytest.approx(whole.solution.held_out, rel=0.1)


def test_search_without_an_effect_tries_the_others_and_keeps_the_fits():
    search = searched(all_swings(1, rippling), "coulomb_friction", "torque_ripple", "bias")
    end, (first, *_) = reached(search, "coulomb_friction"), search.screen(search.start)
    others = search.excluding(first.effect.name)
    for one in (others, others.coarse):
        tried = {candidate.effect.name for candidate in one.screen(one.start)}
        assert tried == {"coulomb_friction", "torque_ripple", "bias"} - {first.effect.name}
    assert others.start is search.start
    assert others.fitted(end.solution.model, {}) is end
    assert first in search.screen(search.start)


@pytest.mark.parametrize(("backward", "expected"), [(0.3, "coulomb_friction"), (0.15, "asymmetric_friction")])
@pytest.mark.parametrize("is_as_complete", [True, False])
def test_simplest_law_is_named_where_data_and_residual_allow(backward, expected, is_as_complete):
    """Friction fitted as asymmetric; it is, or is the same both ways."""
    data = swings(1, lambda q, v, a: np.where(v > 0.0, 0.3, backward) * np.tanh(v / 0.01))
    search = searched(data, "coulomb_friction", "asymmetric_friction")
    end = reached(search, "asymmetric_friction")
    found = most_parsimonious(
        search, end, identify_measurement_model(data), lambda one: is_as_complete or one is end
    )
    # one that is the same both ways is undetermined: it gives way whatever is left
    is_simple = is_as_complete or expected == "coulomb_friction"
    assert search.added_effects(found) == [expected if is_simple else "asymmetric_friction"]


def test_simpler_law_that_leaves_more_is_not_named(monkeypatch):
    """As where they come from a hundred slow samples."""
    monkeypatch.setattr(acceptance, "improvement_test", lambda *args: BootstrapTest(0.0, np.ones(2)))
    data = swings(1, lambda q, v, a: np.where(v > 0.0, 0.3, 0.15) * np.tanh(v / 0.01))
    search = searched(data, "coulomb_friction", "asymmetric_friction")
    end = reached(search, "asymmetric_friction")
    found = most_parsimonious(search, end, measured(search), lambda one: True)
    assert search.added_effects(found) == ["asymmetric_friction"]


def test_simpler_law_replaces_an_undetermined_one_only_if_it_leaves_about_as_little():
    """It leaves a tenth more, and the force forwards is said to be uncertain."""
    data = swings(1, lambda q, v, a: np.where(v > 0.0, 0.3, 0.285) * np.tanh(v / 0.01), rate_hz=250.0)
    search = searched(data, "coulomb_friction", "asymmetric_friction")
    end = reached(search, "asymmetric_friction")
    unknown = {name: replace(one, interval=(np.nan, np.nan)) for name, one in end.parameters.items()}
    vars(end)["parameters"] = unknown
    found = most_parsimonious(search, end, measured(search), lambda one: True)
    assert search.without(end, "asymmetric_friction").rmse / end.rmse > 1.05
    assert 1.05 < reached(search, "coulomb_friction").rmse / end.rmse < 1.2
    assert search.added_effects(found) == ["asymmetric_friction"]


def test_simplest_law_is_named_although_its_optimum_lies_between_the_start_values(monkeypatch):
    """Two branches can be equal, and one of them then has an undetermined share."""
    monkeypatch.setattr(Search, "alternatives", lambda *args: [])  # as where others are better at these

    def law(time_s, x, v, run):
        return 20.0 * kelvin_voigt(x, v, 400.0 * maxwell(time_s, x, run, 0.367))

    search = searched(session(5, law), "stress_relaxation", "relaxation_spectrum", base=PRESS)
    found = most_parsimonious(
        search, reached(search, "relaxation_spectrum"), measured(search), lambda one: True
    )
    assert search.added_effects(found) == ["stress_relaxation"]


@pytest.mark.parametrize(
    ("uneven", "expected"),
    [
        (lambda v: 0.1, {"coulomb_friction", "bias"}),  # 0.4 forwards and 0.2 backwards may be a bias
        (lambda v: 0.06 * np.abs(v), {"asymmetric_friction"}),
    ],
)
def test_asymmetric_friction_must_exceed_coulomb_friction_and_a_bias(uneven, expected):
    data = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.01) + uneven(v))
    search = searched(data, "coulomb_friction", "asymmetric_friction", "bias")
    end = backward_step(search, reached(search, "asymmetric_friction"))
    assert set(search.added_effects(end)) == expected
    for name in expected if "bias" in expected else ():
        assert "asymmetric_friction" in indistinguishable_models(search, end, name, measured(search))


def test_part_may_belong_to_the_base_model():
    data = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.01) + 0.1)
    base = SWING.with_effect(EFFECTS["bias"]())
    search = searched(data, "coulomb_friction", "asymmetric_friction", "bias", base=base)
    end = backward_step(search, reached(search, "asymmetric_friction"))
    assert search.added_effects(end) == ["coulomb_friction"]
    rivals = indistinguishable_models(search, end, "coulomb_friction", measured(search))
    assert list(rivals) == ["asymmetric_friction"]


def test_law_with_more_parameters_is_not_named_for_a_small_gain():
    """A joint's spring, preloaded, beside a bias that changes by a little over the range."""
    search = searched(swings(1, lambda q, v, a: 0.5 + 0.06 * q, runs=5), "bias", "joint_spring")
    bias, spring = (reached(search, name) for name in ("bias", "joint_spring"))
    assert 0.91 < spring.solution.held_out / bias.solution.held_out < 0.97
    assert search.added_effects(backward_step(search, bias)) == ["bias"]
    assert search.added_effects(backward_step(search, spring)) == ["bias"]


@pytest.mark.parametrize("noise_rad", [1e-5, 3e-5])
def test_elasticity_is_unbiased_behind_an_acceleration_with_smooth_errors(noise_rad):
    """Neighbours have their errors in common, so that the load seems better known than it is."""
    true, compliance = swings(1), 0.03
    load = INERTIA * true.acceleration + WEIGHT * np.sin(true.position)
    noise = noise_rad * np.random.default_rng(1).standard_normal(len(true))
    position = true.position + compliance * load + noise
    made = differentiate(true.time_s, position, true.run, 3)
    data = replace(true, position=position, velocity=made.velocity, acceleration=made.acceleration)
    search = searched(data, "joint_elasticity")
    found = reached(search, "joint_elasticity").solution.parameters["joint_elasticity.compliance"]
    assert found == pytest.approx(compliance, rel=0.06)


class Fit(SimpleNamespace):
    __hash__ = object.__hash__


def left(*effects, held_out=1.0, rmse=1.0, by_fold=(0.0,)):
    """What a search looks at of a model that leaves so much."""
    model = Model("pendulum", (*BASE, *(EFFECTS[name]() for name in effects)))
    linear_fit = SimpleNamespace(held_out=np.array(by_fold))
    return Fit(solution=SimpleNamespace(model=model, held_out=held_out, linear_fit=linear_fit), rmse=rmse)


COULOMB, RIPPLE = "coulomb_friction", "torque_ripple"  # two parameters, and three


@pytest.mark.parametrize(
    ("one", "other", "better"),
    [
        ((COULOMB, 97.9), (COULOMB, 100.0), True),  # of the same size, by 2 % of the squared error
        ((COULOMB, 98.0), (COULOMB, 100.0), False),
        ((RIPPLE, 90.2), (COULOMB, 100.0), True),  # a larger one by 5 % of the error, as an added effect
        ((RIPPLE, 90.3), (COULOMB, 100.0), False),
        ((COULOMB, 110.7), (RIPPLE, 100.0), True),
        ((COULOMB, 110.9), (RIPPLE, 100.0), False),
    ],
)
def test_more_parameters_must_be_worth_their_improvement(one, other, better):
    search = searched(swings(1, runs=2))
    ours, theirs = (left(name, held_out=held_out) for name, held_out in (one, other))
    assert [search.size(left(name)) for name in (COULOMB, RIPPLE)] == [2, 3]
    assert search.is_better(ours, theirs) is better


def test_smallest_of_equally_good_models_come_first():
    search = searched(swings(1, runs=2))
    made = [left(RIPPLE, held_out=99.0), left(held_out=103.0), left(COULOMB, held_out=100.9)]
    made += [left(held_out=101.1), left(COULOMB, held_out=100.5)]
    order = [one.solution.held_out for one in search.ordered(made)]
    assert order == [100.5, 100.9, 99.0, 101.1, 103.0]
    assert search.ordered([]) == []


@pytest.mark.parametrize(
    ("rmse", "helped", "p_value", "needed"),
    [
        *((0.95, 3, 0.01, True), (0.951, 3, 0.01, False)),  # of the error before
        *((0.5, 2, 0.01, False), (0.5, 5, 0.011, False)),  # folds of five; chance
    ],
)
def test_effect_is_needed_if_large_helpful_in_most_runs_and_significant(
    monkeypatch, rmse, helped, p_value, needed
):
    search = searched(swings(1, runs=2))
    monkeypatch.setattr(type(search), "p_value", lambda *_: p_value)
    by_fold = [0.5] * helped + [1.0] * (5 - helped)
    before, after = left(by_fold=[1.0] * 5), left(COULOMB, rmse=rmse, by_fold=by_fold)
    assert search.is_needed(before, after) is needed


@pytest.mark.parametrize(
    ("zeros", "is_sound"),
    [
        (lambda run: np.array([0.5, -0.4, 0.1, -0.2])[run], True),
        (lambda run: 0.5 + 0.01 * run, False),  # the model lacks a bias
        (lambda run: np.linspace(-0.5, 0.5, len(run)), False),  # or a drift
    ],
)
def test_zero_that_all_runs_share_or_that_drifts_does_not_vary_between_runs(zeros, is_sound):
    data = swings(1, runs=4)
    search = searched(replace(data, effort=data.effort + zeros(data.run)))
    end = search.fitted(SWING.with_effect(EFFECTS["run_offset"]()), {"run_offset.share": 0.9})
    assert search.is_sound(end, "run_offset") is is_sound


def test_model_order_matters_only_for_sensor_effects():
    made = [
        SWING.with_effect(EFFECTS[a]()).with_effect(EFFECTS[b]())
        for a, b in ((COULOMB, RIPPLE), (RIPPLE, COULOMB), ("delay", "lag"), ("lag", "delay"))
    ]
    keys = [_key(model) for model in made]
    assert keys[0] == keys[1]
    assert len(set(keys)) == 3


@pytest.mark.parametrize(
    ("runs", "blocks", "chosen"), [(6, 100, 6), (24, 100, 24), (24, 400, 12), (36, 400, 12), (12, 2000, 12)]
)
def test_coarse_data_have_twelve_runs_of_four_thousand_blocks(runs, blocks, chosen):
    run = np.repeat(np.arange(runs), blocks)
    effort = np.tile(np.linspace(0.0, 1.0, blocks), runs) * (run + 1)
    fields = {"run": run, "effort": effort, "trusted": np.ones(len(run), dtype=np.bool_)}
    blocked = type("Blocks", (), {**fields, "__len__": lambda self: len(self.run)})()
    found = np.unique(run[_select_runs(blocked)])
    assert len(found) == chosen
    assert np.ptp(np.diff(found)) == 0


def test_mostly_excluded_recording_is_searched_by_the_other_runs(whole_budget):
    """Of 100 runs, the three that are no copies: every eighth run by effort would miss them."""
    t, run = np.tile(np.arange(200) / 200.0, 100), np.repeat(np.arange(100), 200)
    size = np.where(run == 2, 1.2, np.where((run == 1) | (run > 62), 1.1, 1.0))
    w = 2.0 * np.pi
    x, v, a = 1e-3 * (1.0 - np.cos(w * t)), 1e-3 * w * np.sin(w * t), 1e-3 * w**2 * np.cos(w * t)
    effort = 3e3 * x + 2e6 * x**2 + np.random.default_rng(0).normal(0.0, NOISE_N, len(t))
    signals = (size * signal for signal in (x, v, a, effort))
    data = ChannelData("contact", ChannelKind.CONTACT, t + run, *signals, run, run * 0 - 1)
    search = prepare_search(data, PRESS, run < 3, (), np.random.default_rng(0))
    assert Kind.ELASTIC_SHAPE in analyze_kinds(search.coarse or search).kinds


def test_load_on_the_coarse_copy_is_that_of_each_model():
    """The load of a rotor without weight, whose inertia is fitted as zero, is no load of a pendulum."""
    data = all_swings(
        1,
        lambda q, v, a: 0.1 * np.abs(INERTIA * a + WEIGHT * np.sin(q)) * np.tanh(v / 0.02),
        seconds=12.0,
        rate_hz=500.0,
    )
    search = searched(data, "weight", "load_dependent_friction", base=ROTOR)
    assert np.ptp(search.coarse.start.data.context["load"]) == 0.0
    end = reached(search.coarse, "weight", "load_dependent_friction")
    assert np.ptp(end.data.context["load"]) > WEIGHT
    assert end.solution.parameters["load_dependent_friction.mu"] == pytest.approx(0.1, rel=0.05)


def test_each_form_of_an_effect_is_a_model_of_its_own():
    search = searched(swings(1))
    first, *others = EFFECTS["joint_elasticity"]().forms()
    made = [search.fitted(SWING.with_effect(form), {}) for form in (first, *others, first)]
    assert made[0] is made[-1]
    assert len({id(one) for one in made}) == 1 + len(others)


@pytest.mark.parametrize(("gap_error", "may_be"), [(0.0035, False), (0.0041, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_effect_of_zero_size_is_not_established(gap_error, may_be, sign):
    """However sure its other parameters are: without a gap there is no backlash."""
    search = searched(swings(1))
    end = search.fitted(SWING.with_effect(EFFECTS["backlash"]()), {})

    def one(name, value, error):
        interval = (value - 2.0 * error, value + 2.0 * error)
        return ParameterEstimate(f"backlash.{name}", "rad", value, error, interval)

    known = (
        one("gap", sign * 0.01, gap_error),
        *(one(f"motor_{n}", 0.4, 0.01) for n in ("inertia", "friction")),
    )
    vars(end)["parameters"] = {each.name: each for each in known}
    assert acceptance._has_zero_size(search.start, end, "backlash") is may_be


@pytest.mark.parametrize(
    ("step", "without", "end", "name", "below"),
    [
        (0.1, 0.055, 0.05, "bias", True),  # it adds 23 mN m, and a step's rounding is 29 mN m
        (0.1, 0.06, 0.05, "bias", False),
        (0.1, 0.04, 0.05, "bias", True),
        (0.1, 0.055, 0.05, "quantisation", False),  # that is what it is
        (0.1, 0.111, 0.11, "bias", False),  # more than a step is left: it says nothing
        (0.0, 0.055, 0.05, "bias", False),  # the reader does not round
    ],
)
def test_quantization_effect_is_limited_to_the_sensor_step(step, without, end, name, below):
    data = swings(1)
    effort = np.random.default_rng(1).normal(0.0, 1.0, len(data))
    effort = step * np.round(effort / step) if step else effort
    whole = SimpleNamespace(data=replace(data, effort=effort), rmse=end)
    search = SimpleNamespace(without=lambda *_: SimpleNamespace(rmse=without))
    assert acceptance._is_rounding(search, whole, name) is below


def test_fit_is_cached_unless_another_start_lowers_the_error():
    search = searched(swings(1, rippling), "torque_ripple", "coulomb_friction")
    ripple = SWING.with_effect(EFFECTS["torque_ripple"]())
    poor = search.fitted(ripple, {"torque_ripple.cycles": 40.0})
    assert search.fitted(ripple, {"torque_ripple.cycles": 15.0}) is poor
    beside = search.screen(poor)
    assert search.screen(poor) is beside
    assert search.alternatives(poor, "torque_ripple") is search.alternatives(poor, "torque_ripple")
    good = search.refitted(ripple, {"torque_ripple.cycles": 15.0})
    assert good.solution.sse < 0.9 * poor.solution.sse
    assert search.fitted(ripple, {}) is good
    assert search.refitted(ripple, {"torque_ripple.cycles": 40.0}) is good
    assert search.screen(good) is not beside  # what was tried beside the poor one says nothing now
    assert reached(search, "torque_ripple") is good


def test_base_model_keeps_the_fit_that_all_commands_show():
    """`compare` and `add` fit the base model from its own start, and check the diagnosis against this fit."""
    data = swings(1, rippling)
    ripple = SWING.with_effect(EFFECTS["torque_ripple"]())
    search = Search(data, ripple, np.ones(len(data), dtype=np.bool_), (), np.random.default_rng(0))
    shown = fit_model(data, ripple, {}).solution
    better = fit_model(data, ripple, {"torque_ripple.cycles": 15.0}).solution
    assert better.sse < 0.9 * shown.sse
    search.refitted(ripple, better.parameters)
    assert search.start.solution.sse == pytest.approx(shown.sse)


def test_misplaced_effect_is_searched_again_in_smaller_models_too():
    """A pulse that repeats is late by a part of its period, or by that and a whole one."""
    data = session(1, lambda t, x, v, run: 800.0 * np.clip(x, 0.0, None))
    t = np.arange(len(data)) / 200.0  # as many as blocks a second, so that there is no sketch
    x = 0.003 * np.sin(2.0 * np.pi * t / 0.3) + 0.003 * (1.0 - np.exp(-t / 9.0)) + 0.004
    late = 0.003 * np.sin(2.0 * np.pi * (t - 0.08) / 0.3) + 0.003 * (1.0 - np.exp(-(t - 0.08) / 9.0)) + 0.004
    noise = NOISE_N * np.random.default_rng(0).standard_normal(len(t))
    data = replace(
        data, time_s=t, position=x, velocity=np.gradient(x, t), effort=800.0 * late + noise, run=0 * data.run
    )
    search = replace(searched(data, "delay", "bias", base=PRESS), coarse=None)
    delayed = PRESS.with_effect(EFFECTS["delay"]())
    stuck = search.fitted(delayed, {"delay.time": -0.22})
    assert stuck.solution.parameters["delay.time"] < -0.1
    assert search.refit_effect(stuck, "delay").solution.parameters["delay.time"] == pytest.approx(
        0.08, abs=3e-3
    )
    right = fit_model(data, delayed.with_effect(EFFECTS["bias"]()), {"delay.time": 0.08})
    search._fits[_key(delayed)] = stuck
    less = search.without(right, "bias")
    assert less.solution.parameters["delay.time"] == pytest.approx(0.08, abs=3e-3)


STEP_NM = 0.5
TOO_FINE = {"quantisation.step": STEP_NM / 3.0, "quantisation.noise": 0.01}
STEPPED = SWING.with_effect(EFFECTS["quantisation"]())


@pytest.fixture
def rounded():
    """The search in a swing whose torque is rounded, with a coarse copy."""
    data = swings(1, rate_hz=250.0)
    return searched(replace(data, effort=STEP_NM * np.round(data.effort / STEP_NM)), "quantisation")


def test_steps_hidden_by_block_means_are_fitted_from_single_readings(rounded):
    off = rounded.fitted(STEPPED, TOO_FINE)
    assert rounded.coarse is not None
    assert abs(off.solution.parameters["quantisation.step"] - STEP_NM) > 0.1
    found = rounded.refined(off).solution.parameters["quantisation.step"]
    assert found == pytest.approx(STEP_NM, rel=1e-2)


def test_start_of_the_coarse_copy_does_not_replace_a_better_candidate(rounded):
    rounded.coarse.fitted(STEPPED, TOO_FINE)
    (candidate,) = rounded.screen(rounded.start)
    found = rounded.with_candidate(candidate).solution.parameters["quantisation.step"]
    assert found == pytest.approx(STEP_NM, rel=1e-2)


def test_progress_names_each_tried_experiment():
    told, data = [], swings(1, rippling)
    search = replace(searched(data, "bias", COULOMB, RIPPLE), progress=lambda *what: told.append(what))
    left = [one.held_out for one in search.screen(search.start)]
    assert left == sorted(left)
    beside = "joint_1: beside pendulum, viscous_friction"
    assert told == [(f"{beside}: {name}", k / 3) for k, name in enumerate(("bias", COULOMB, RIPPLE))]
    glanced = search.quick_screen(search.start)
    assert [one.held_out for one in glanced] == sorted(one.held_out for one in glanced)
    assert all(one.possible and len(one.search.solutions) <= 5 for one in glanced)


def test_extensions_are_sensible_promising_and_ordered(monkeypatch):
    data = swings(1, rippling, rate_hz=100.0)
    search = replace(searched(data, "bias", COULOMB, RIPPLE, "quadratic_friction"), coarse=None)
    made = search.extensions(search.start)
    assert [search.added_effects(one) for one in made][:2] == [[RIPPLE], [COULOMB]]
    assert len(made) == 2  # a bias lowers nothing, and no drag is negative
    assert made == search.ordered(made)
    assert len(replace(search, coarse=search).extensions(search.start)) == 2
    monkeypatch.setattr(type(search), "is_sensible", lambda self, one: self.added_effects(one) != [RIPPLE])
    assert search.added_effects(search.extensions(search.start)[0]) == [COULOMB]


def test_effect_is_exchanged_for_a_better_one():
    data = swings(1, lambda q, v, a: (0.2 + 0.15 * np.exp(-((v / 0.6) ** 2))) * np.tanh(v / 0.01))
    search = searched(data, COULOMB, "stribeck_friction", "quadratic_friction")
    (made,) = search.substitutions(reached(search, COULOMB), COULOMB)  # drag is nowhere near
    assert search.added_effects(made) == ["stribeck_friction"]


def test_alternatives_replace_an_effect_with_other_parameters_fixed():
    search = searched(swings(1, rippling), COULOMB, RIPPLE, "joint_spring", "asymmetric_friction")
    end = reached(search, RIPPLE, COULOMB)
    tried = {one.effect.name: one for one in search.alternatives(end, COULOMB)}
    assert COULOMB in tried
    assert RIPPLE not in tried
    for name in end.solution.model.inner:
        if not name.startswith(COULOMB):
            assert tried[COULOMB].search.best.parameters[name] == end.solution.parameters[name]
    made = search.substitutions(end, COULOMB)
    assert all(
        COULOMB not in search.added_effects(one) and RIPPLE in search.added_effects(one) for one in made
    )
    assert made == search.ordered(made)


def test_parts_are_tried_in_place_of_their_whole():
    data = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.01) + 0.1)
    search = searched(data, COULOMB, "bias", "asymmetric_friction")
    end = search.fitted(
        SWING.with_effect(EFFECTS["asymmetric_friction"]()), {"asymmetric_friction.transition": 0.01}
    )
    assert {COULOMB, "bias"} in [
        set(search.added_effects(one)) for one in search.substitutions(end, "asymmetric_friction")
    ]
    press = EFFECTS["adhesion"]()
    assert not press.applies_to(data)
    assert search.with_each(search.start, [press]) is search.start


@pytest.mark.parametrize(
    ("friction_nm", "low", "high"), [(0.0, 0.02, 1.0), (0.004, 0.005, 0.01), (0.3, 0.0, 0.0)]
)
def test_p_value_is_the_share_of_noise_samples_with_as_large_a_gain(friction_nm, low, high):
    """Nothing is there; something small; and so much of so many samples that nobody need ask."""
    search = searched(
        swings(2, lambda q, v, a: friction_nm * np.tanh(v / 0.02)), COULOMB, "bias", "joint_spring"
    )
    found = search.p_value(search.start, reached(search, COULOMB))
    assert low <= found <= high
    if found:
        assert found * 200 == pytest.approx(round(found * 200))


@pytest.mark.parametrize(
    ("count", "energy", "is_tested"),
    [
        (1001, 0.45, True),  # of few blocks, noise alone may give a large share
        (1001, 0.55, False),
        (2000, 0.24, True),  # and of twice as many half as much
        (2000, 0.27, False),
        (20_000, 0.09, True),
    ],
)
def test_smaller_residual_is_clear_without_a_test_of_more_blocks(monkeypatch, count, energy, is_tested):
    """`energy` is what the effect takes away, relative to what it leaves."""
    tested = []

    def improvements(*_, most, **__):
        tested.append(most)
        return np.zeros(200)

    monkeypatch.setattr(module, "null_improvements", improvements)
    monkeypatch.setattr(module, "applicable_effects", lambda *_: ())
    problem = SimpleNamespace(used=slice(None), blocked=SimpleNamespace(run=np.zeros(count)))
    before = SimpleNamespace(
        data=None,
        problem=problem,
        solution=SimpleNamespace(model=None, sse=count * (1.0 + energy), columns=np.ones((count, 1))),
    )
    after = SimpleNamespace(
        problem=problem,
        solution=SimpleNamespace(sse=float(count)),
        flexible=SimpleNamespace(residual=np.ones(count)),
    )
    search = SimpleNamespace(effects=(), rng=None)
    for level in (0.01, 1.0):
        assert Search.p_value(search, before, after, level) == (1 / 201 if is_tested else 0.0)
    assert tested == ([1, 199] if is_tested else [])  # 2 of 200 make a p-value of 0.01


def quick(hidden, rate_hz=1000.0, runs=5):
    return swings(1, hidden, rate_hz=rate_hz, runs=runs)


def test_coarse_search_has_one_sample_per_block_and_selects_candidates():
    names = ("bias", "joint_spring", "payload", "delay", "lag", "saturation", COULOMB, RIPPLE)
    data = quick(rippling)
    search = searched(data, *names)
    assert search.coarse.coarse is None
    assert len(search.coarse.data) == len(data) // 10
    assert searched(quick(rippling, 100.0), *names).coarse is None  # a sample is a block
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BlockedData, "can_hold_out", False)
        assert searched(data).coarse is None
    rough = {one.effect.name: one for one in search.coarse.screen(search.coarse.start)}
    found = {one.effect.name: one.search for one in search.screen(search.start)}
    for name in (COULOMB, RIPPLE):
        (start,) = (one.parameters for one in found[name].starts)
        best = rough[name].search.best.parameters
        assert all(start[f"{name}.{one.name}"] == best[f"{name}.{one.name}"] for one in EFFECTS[name].inner)
    step_s = 1e-3
    times = [one.parameters["delay.time"] for one in found["delay"].starts]
    proposed = [one["time"] for one in EFFECTS["delay"]().starts(data) if abs(one["time"]) < 40.0 * step_s]
    assert times[1:] == pytest.approx(proposed)  # within four blocks the sketch hardly tells times
    limits = [one.parameters["saturation.limit"] for one in found["saturation"].starts]
    assert limits[1:] == pytest.approx([one["limit"] for one in EFFECTS["saturation"]().starts(data)])


def test_only_effects_invisible_on_coarse_data_are_tried_beyond_a_shortlist(monkeypatch):
    monkeypatch.setattr("palpate.estimation.diagnosis.search.SHORTLIST", 1)
    search = searched(quick(rippling), "bias", "joint_spring", "delay", "lag", "saturation", COULOMB, RIPPLE)
    assert {one.effect.name for one in search.screen(search.start)} == {RIPPLE, "delay", "lag", "saturation"}
    for name, found in ((COULOMB, {RIPPLE, COULOMB}), ("delay", {RIPPLE, "delay", "lag"})):
        end = search.fitted(SWING.with_effect(EFFECTS[name]()), {})
        assert {one.effect.name for one in search.alternatives(end, name)} == found
