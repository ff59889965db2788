"""Acceptance criteria: an effect is needed, no part of another, and no stand-in for a law."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.signal import lfilter

from palpate.estimation.budget import BudgetEntry
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.diagnosis import acceptance as module
from palpate.estimation.diagnosis.acceptance import (
    FormCriteria,
    _effects_by_importance,
    accept_effects,
    accept_forms,
    as_good_effects,
    indistinguishable_models,
    is_outperformed,
    models_by_importance,
    smallest_sufficient_model,
)
from palpate.estimation.diagnosis.bootstrap import BootstrapTest
from palpate.estimation.diagnosis.candidates import Candidate
from palpate.estimation.diagnosis.completeness import Completeness
from palpate.estimation.diagnosis.forms import analyze_kinds, form_tests
from palpate.estimation.effects import EFFECTS
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.exponential_memory import low_pass
from tests.estimation.searches import ROTOR, measured, reached, searched
from tests.estimation.swings import coarse_swings as swings
from tests.estimation.swings import one_way_turns

SPRING, RUB, BIAS, SQUARE = "joint_spring", "coulomb_friction", "bias", "quadratic_friction"


def strange(q, v, a):
    """A torque that no effect here draws."""
    return 0.05 * np.sin(8.0 * q) * q


def rubbing(size):
    return lambda q, v, a: size * np.tanh(v / 0.02)


LAWS = {
    "a spring and a friction": lambda q, v, a: 6.0 * q + rubbing(0.1)(q, v, a),
    "a spring, a friction and what nobody knows": lambda q, v, a: (
        6.0 * q + rubbing(0.1)(q, v, a) + 4.0 * strange(q, v, a)
    ),
    "a friction": rubbing(0.3),
    "a friction and what nobody knows": lambda q, v, a: rubbing(0.5)(q, v, a) + strange(q, v, a),
    "a large friction and a small zero": lambda q, v, a: rubbing(2.0)(q, v, a) + 0.015,
    "a large spring and a friction above the noise": lambda q, v, a: 60.0 * q + rubbing(0.1)(q, v, a),
}


@cache
def searched_law(law):
    return searched(swings(1, LAWS[law]), SPRING, RUB, BIAS, SQUARE)


@cache
def kinds_of(law):
    return analyze_kinds(searched_law(law))


@cache
def reached_in(law, *names):
    return reached(searched_law(law), *names)


@pytest.mark.parametrize(
    ("law", "found", "kept"),
    [
        ("a spring and a friction", (SPRING, RUB), {SPRING, RUB}),
        ("a spring and a friction", (), set()),
        ("a friction", (RUB, BIAS), {RUB}),  # what is not there is needless
        ("a large friction and a small zero", (RUB, BIAS), {RUB, BIAS}),  # below the noise, but not within it
        ("a large spring and a friction above the noise", (SPRING, RUB), {SPRING, RUB}),  # also less
    ],
)
def test_complete_model_keeps_its_needed_effects(law, found, kept):
    search = searched_law(law)
    checks = Completeness(search.start, search.rng)
    end = accept_effects(search, reached_in(law, *found), measured(search), checks.is_complete)
    assert set(search.added_effects(end)) == kept


@pytest.mark.parametrize("without_it_complete", [True, False])
def test_effect_below_the_noise_is_kept_only_if_the_model_is_incomplete_without_it(without_it_complete):
    search = searched_law("a large friction and a small zero")
    fit = reached_in("a large friction and a small zero", RUB, BIAS)
    end = accept_effects(search, fit, measured(search), lambda reduced: without_it_complete)
    assert (BIAS in search.added_effects(end)) is not without_it_complete


@pytest.mark.parametrize("without_it_complete", [True, False])
def test_effect_that_may_be_zero_is_dropped_only_if_the_model_is_complete_without_it(
    without_it_complete, monkeypatch
):
    monkeypatch.setattr(module, "_has_zero_size", lambda *_: True)
    search, fit = searched_law("a friction"), reached_in("a friction", RUB)
    end = accept_effects(search, fit, measured(search), lambda reduced: without_it_complete)
    assert (RUB in search.added_effects(end)) is not without_it_complete


@pytest.mark.parametrize(
    ("law", "found", "kept"),
    [
        # The friction explains less than a twentieth of the error, which counts only if more is left.
        ("a spring and a friction", (RUB, SPRING), {RUB, SPRING}),
        ("a spring, a friction and what nobody knows", (RUB, SPRING), {SPRING}),
        ("a friction", (SPRING,), set()),
        ("a friction", (RUB, SQUARE), {RUB}),  # a needless effect, beside which nothing is left either
        ("a friction", (SQUARE,), set()),  # another kind's law does not stand for it
        ("a friction and what nobody knows", (RUB,), {RUB}),  # it is found, whatever remains
        ("a friction and what nobody knows", (RUB, BIAS), {RUB}),
    ],
)
def test_incomplete_model_keeps_effects_of_known_form(law, found, kept):
    search = searched_law(law)
    end, tests = accept_forms(search, kinds_of(law), reached_in(law, *found), measured(search))
    assert set(search.added_effects(end)) == kept
    assert {test.effect for test in tests} == kept


@pytest.mark.parametrize(
    ("law", "found", "failed", "reason"),
    [
        ("a spring, a friction and what nobody knows", (RUB, SPRING), RUB, "explains too little"),
        ("a friction", (SPRING,), SPRING, "its form explains only"),
        ("a friction", (RUB, BIAS), BIAS, "explains too little"),
        ("a friction and what nobody knows", (RUB,), RUB, ""),
    ],
)
def test_failed_criterion_is_stated(law, found, failed, reason):
    search = searched_law(law)
    criteria = FormCriteria(search, kinds_of(law), reached_in(law, *found))
    stated = criteria.failed_by(next(test for test in criteria.tests if test.effect == failed))
    assert reason in stated if reason else stated == ""


@pytest.mark.parametrize(
    ("taken", "repeated"),
    [
        # Two forms of a kind draw almost any third; effects of two kinds may each have a name.
        ({RUB: 3.0, "position_dependent_friction": 2.0, SQUARE: 1.0}, "position_dependent_friction"),
        # Of two curves over one signal the better one is named.
        ({"cubic_stiffness": 1.0, "exponential_stiffness": 2.0, "damping": 0.1}, "cubic_stiffness"),
    ],
)
def test_each_kind_has_one_name_while_error_remains(taken, repeated):
    effects = [EFFECTS[name]() for name in taken]
    criteria = object.__new__(FormCriteria)
    vars(criteria).update(
        explained=taken.__getitem__, _least=0.0, tests=[Mock(effect=name) for name in taken]
    )
    criteria._fit = SimpleNamespace(solution=SimpleNamespace(model=SimpleNamespace(effects=effects)))
    criteria._impossible, criteria._is_clear = lambda _: "", lambda _: False
    criteria._accounts_for_error = lambda _: True
    failed = [effect.name for effect in effects if criteria.failed_by(Mock(effect=effect.name))]
    assert failed == [repeated]


def test_sensor_fault_needs_a_size_even_if_it_explains_all_clearly(monkeypatch):
    criteria = object.__new__(FormCriteria)
    vars(criteria).update(explained=lambda name: 1.0, _least=0.0, _search=Mock(), tests=[])
    effects = [EFFECTS[name]() for name in (BIAS, RUB)]
    criteria._fit = SimpleNamespace(solution=SimpleNamespace(model=SimpleNamespace(effects=effects)))
    criteria._impossible, criteria._is_clear = lambda _: "", lambda _: True
    monkeypatch.setattr(module, "_has_zero_size", lambda *_: True)
    failed = [criteria.failed_by(Mock(effect=effect.name, kind=effect.kind)) for effect in effects]
    assert failed == ["the interval of its size contains zero", ""]


@pytest.mark.parametrize(("wander", "kept"), [(0.01, {BIAS}), (0.06, set())])
def test_sensor_fault_that_explains_nearly_all_needs_no_law_that_accounts_for_it(wander, kept, monkeypatch):
    """The rest is a slow error of which no law explains anything."""
    data = swings(1)
    slow = wander * lfilter([1.0], [1.0, -0.95], np.random.default_rng(0).normal(size=len(data)))
    search = searched(replace(data, effort=data.effort + 0.5 + slow), BIAS)
    monkeypatch.setattr(FormCriteria, "_accounts_for_error", lambda *_: False)
    end, _ = accept_forms(search, analyze_kinds(search), reached(search, BIAS), measured(search))
    assert set(search.added_effects(end)) == kept


@pytest.mark.parametrize(
    ("name", "left", "noise", "replaced"),
    [
        (SPRING, 1.4, 0.1, True),
        (SPRING, 1.5, 0.1, False),
        (SPRING, 1.4, 0.7, False),  # an error of up to 1.05 is noise
        (SPRING, 1.4, 1.0, True),
        (BIAS, 1.1, 0.1, False),
        (BIAS, 0.9, 0.1, True),
    ],
)
def test_weight_replaces_a_bias_only_if_it_fits_better(monkeypatch, name, left, noise, replaced):
    """A spring is replaced if the weight explains 95 % as much, unless only the spring leaves only noise."""
    start, fit, end = (
        SimpleNamespace(
            solution=SimpleNamespace(held_out=error, model=SimpleNamespace(effect=EFFECTS.get)),
            rmse=error**0.5,
        )
        for error in (10.0, 1.0, left)
    )
    monkeypatch.setattr(module, "measurement_noise", lambda _: SimpleNamespace(value=noise))
    weight = SimpleNamespace(effect=EFFECTS["weight"]())
    search = SimpleNamespace(start=start, with_candidate=lambda candidate: end)
    search.added_effects = lambda model: ["weight"] if model is end else [name]
    monkeypatch.setattr(module, "_alternatives", lambda *_: (0.0, [weight]))
    monkeypatch.setattr(module, "_is_missing_weight", lambda *_: True)
    monkeypatch.setattr(module, "accept_forms", lambda *_: (end, []))
    assert (module._with_weight(search, None, fit, None) is not None) is replaced


def test_effect_that_drives_a_base_gain_out_of_bounds_is_not_accepted(monkeypatch):
    search = searched_law("a friction")
    end = reached_in("a friction", RUB)
    monkeypatch.setattr(type(search), "is_sensible", lambda self, one: one is not end)
    assert accept_effects(search, end, measured(search), lambda _: True) is search.start


def test_effects_are_ordered_by_improvement():
    search = searched_law("a spring and a friction")
    end = reached_in("a spring and a friction", RUB, SPRING)
    assert _effects_by_importance(search, end) == [SPRING, RUB]
    assert [set(search.added_effects(one)) for one in models_by_importance(search, end)] == [
        {SPRING},
        {RUB, SPRING},
    ]
    assert models_by_importance(search, search.start) == []
    assert _effects_by_importance(search, search.start) == []


def test_flexible_law_outperforms_effects_only_if_it_explains_what_they_do_not():
    """Beside a base model that lacks a friction, such a law finds it; beside the friction, nothing."""
    search = searched_law("a friction")
    end = reached_in("a friction", RUB)
    assert not is_outperformed(search.start, end)
    assert search.start.flexible.held_out.sum() < 3.0 * end.flexible.before.sum()


@pytest.mark.parametrize(
    ("base", "flexible", "outperformed"),
    [(20.0, 8.9, True), (20.0, 9.1, False), (120.0, 8.9, True), (123.0, 8.9, False), (8.0, 9.1, False)],
)
def test_flexible_base_model_outperforms_by_a_tenth_and_a_hundredth_of_the_effects(
    base, flexible, outperformed
):
    fits = (
        SimpleNamespace(
            flexible=SimpleNamespace(before=np.array([before]), held_out=np.array([held_out])),
            problem=SimpleNamespace(used=np.ones(1)),
        )
        for before, held_out in ((base, flexible), (12.0, 10.0))
    )
    assert is_outperformed(*fits) is outperformed


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


def test_smallest_sufficient_part_of_a_model_is_selected(refused):
    search = searched_law("a spring and a friction")
    end = reached_in("a spring and a friction", SPRING, RUB)
    asked = refused(lambda before, after: not names(before))  # only the base model is refused
    assert names(smallest_sufficient_model(search, end, measured(search))) == {SPRING}
    assert [names(before) for before, after, _ in asked if after is end] == [set(), {SPRING}]


def test_effect_of_smoothing_does_not_hide_another(refused, monkeypatch):
    """The bootstrap samples also contain errors of smoothing, which such an effect explains."""
    law = "a spring and a friction"
    search, end = searched_law(law), reached_in(law, SPRING, RUB)
    monkeypatch.setattr(module, "is_smoothing", lambda before, fit: names(fit) - names(before) == {RUB})
    refused(lambda before, after: RUB not in names(after))
    assert names(accept_effects(search, end, measured(search), lambda fit: True)) == {SPRING}


def test_no_form_is_named_if_noise_around_the_base_model_improves_as_much(refused):
    law = "a friction and what nobody knows"
    refused()
    found = accept_forms(searched_law(law), kinds_of(law), reached_in(law, RUB), measured(searched_law(law)))
    assert found == (searched_law(law).start, [])


@pytest.mark.parametrize("others_refused", [False, True])
def test_rival_explains_half_of_the_effect_and_is_not_rejected(refused, others_refused):
    """Of friction: a spring explains nothing of it."""
    search = searched_law("a friction")
    end = reached_in("a friction", RUB)
    asked = refused(lambda before, after: others_refused)
    found = indistinguishable_models(search, end, RUB, measured(search))
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
def test_model_with_more_parameters_is_no_rival(refused, same, found, monkeypatch):
    """Friction that falls with the speed: with the load it has one parameter more.

    What creeps no way at all before it slides is another's name for the same, and no rival either.
    """
    refused()
    monkeypatch.setattr(module, "_is_same_curve", lambda *_: same)
    data = swings(1, lambda q, v, a: (0.2 + 0.15 * np.exp(-((v / 0.6) ** 2))) * np.tanh(v / 0.01), runs=4)
    others = ("stribeck_friction", "presliding_friction", "load_dependent_friction", SPRING)
    search = searched(data, RUB, *others)
    rivals = indistinguishable_models(search, reached(search, RUB), RUB, measured(search))
    assert rivals.keys() == found


def curve(values):
    return SimpleNamespace(solution=SimpleNamespace(residual=np.asarray(values)))


@pytest.mark.parametrize(
    ("one", "other", "without", "same"),
    [
        ([0.0, 0.0], [0.03, 0.0], [1.0, 0.0], True),  # by a thousandth of the energy of what both add
        ([0.0, 0.0], [0.04, 0.0], [1.0, 0.0], False),
        ([0.0, 0.0], [0.3, 0.0], [10.0, 0.0], True),
        ([5.0, 0.0], [5.04, 0.0], [6.04, 0.0], False),  # what all three leave, such as noise, adds nothing
        ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], False),  # nothing is added
        ([0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], False),  # the contact begins elsewhere
        ([0.0, 0.0], [0.0, 0.0], [1.0, 0.0, 0.0], False),
    ],
)
def test_curves_are_equal_up_to_a_small_share(one, other, without, same):
    assert module._is_same_curve(*map(curve, (one, other, without))) is same


def test_effect_that_removes_more_than_remains_is_not_negligible():
    """Though nobody looked at its interval."""
    search = searched_law("a friction")
    end = reached_in("a friction", RUB, BIAS)
    assert not module._has_zero_size(search.start, end, RUB)
    assert module._has_zero_size(search.without(end, BIAS), end, BIAS)
    half, whole = (
        SimpleNamespace(flexible=SimpleNamespace(before=np.array([one])), solution=end.solution)
        for one in (1.0, 2.0)
    )
    assert not module._has_zero_size(whole, half, RUB)


@pytest.mark.parametrize("fault", [BIAS, "drift"])
def test_sensor_fault_needs_a_size_even_if_it_removes_most_error(fault):
    end = reached(searched(swings(1, LAWS["a friction"]), RUB, fault), RUB, fault)
    large = SimpleNamespace(flexible=SimpleNamespace(before=1e9 * end.flexible.before))
    assert module._has_zero_size(large, end, fault)
    unknown = {
        name: replace(value, interval=(-np.inf, np.inf)) if name.startswith(fault) else value
        for name, value in end.parameters.items()
    }
    vars(end)["parameters"] = unknown  # the prediction does not change near the fitted value
    assert not module._has_zero_size(large, end, fault)
    assert module._has_zero_size(end, end, fault)


def test_friction_that_never_reverses_is_as_good_as_a_bias(monkeypatch):
    search = searched(one_way_turns(lambda q, v: 0.5), RUB, BIAS)
    end = reached(search, RUB)
    assert set(as_good_effects(search, end, RUB)) == {BIAS}
    both = searched(swings(1, LAWS["a friction"]), RUB, BIAS)
    assert as_good_effects(both, reached(both, RUB), RUB) == {}
    monkeypatch.setattr(type(search), "is_sensible", lambda *_: False)  # such as a negative damping
    assert as_good_effects(search, end, RUB) == {}


def test_whole_effect_is_reported_even_with_a_rival_of_its_part():
    """In a small swing a tilt of gravity is a bias, and that with friction is friction by direction."""
    wide = swings(2)
    q, v, a = 0.1 * wide.position, 0.1 * wide.velocity, 0.1 * wide.acceleration
    rubbed = np.where(v > 0.0, 0.1, -0.5)
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(q))
    torque = 0.05 * a + 2.0 * np.sin(q) + 0.15 * v + rubbed + noise
    small = replace(wide, position=q, velocity=v, acceleration=a, effort=torque)
    search = searched(small, "coulomb_friction", "gravity_tilt", "bias", "asymmetric_friction")
    fit = reached(search, "coulomb_friction", "gravity_tilt")
    rivals = indistinguishable_models(search, fit, "gravity_tilt", measured(search))
    assert {"bias", "asymmetric_friction"} <= set(rivals)


def test_parts_with_fewer_parameters_are_compared_with_their_whole():
    """Friction and a bias, where one effect has both; a whole of which a part is missing is no rival."""
    data = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.01) + 0.1, rate_hz=250.0)
    search = searched(data, RUB, BIAS, "asymmetric_friction")
    end = reached(search, RUB, BIAS)
    other = Candidate(EFFECTS["asymmetric_friction"](), None)
    assert [module._has_at_most(count, other, end) for count in (1, 9)] == [False, True]
    ((name, whole),) = module._composites(search, end, RUB)
    assert [name] == search.added_effects(whole) == ["asymmetric_friction"]
    assert whole.rmse == pytest.approx(end.rmse, rel=0.02)
    assert not [*module._composites(search, reached(search, RUB), RUB)]
    assert not [*module._composites(search, end, "pendulum")]
    assert not [*module._composites(search, reached(search, "asymmetric_friction"), RUB)]


@pytest.mark.parametrize(
    ("share", "necessary", "others", "unexplained", "by_other", "by_all", "told"),
    [
        (0.5, 0.02, (), 1.0, 0.5, 0.0, True),
        (0.5, 0.02, (Kind.TIME_MEMORY,), 1.0, 0.5, 0.0, True),  # nothing else takes all of it
        (0.02, 0.0, (), 1.0, 0.5, 0.0, True),
        # What is left may be why relaxation takes as much.
        (0.5, 0.0, (Kind.TIME_MEMORY,), 1.0, 0.5, 0.0, False),
        # A law of relaxation leaves as much as the form does.
        (0.5, 0.0, (Kind.TIME_MEMORY,), 1.0, 1.0, 0.0, True),
        (0.5, 0.0, (Kind.TIME_MEMORY,), 0.05, 0.5, 0.0, True),  # of two kinds, the one with a simple form
        (0.019, 0.019, (), 1.0, 0.5, 0.0, False),
        (0.0, 0.0, (), 1.0, 0.5, 0.9, True),  # all laws together leave more than the form
        (None, None, (), 1.0, 0.5, 0.0, True),  # its kind has no law
    ],
)
def test_form_is_named_where_its_kind_explains_some_error(
    share, necessary, others, unexplained, by_other, by_all, told
):
    law = "a friction and what nobody knows"
    search, end, partial = searched_law(law), reached_in(law, RUB), kinds_of(law)
    (test,) = form_tests(partial, end)
    entry = share is not None and BudgetEntry(
        Kind.FRICTION, share, (share, share), necessary, share, tuple(others)
    )
    laws = SimpleNamespace(mean_square=lambda kinds=None: by_other * test.unexplained_by_all)
    criteria = FormCriteria(search, partial, end)
    criteria._partial = replace(
        partial, budget=replace(partial.budget, unexplained_by_all=by_all), error=laws
    )
    criteria._entries = {Kind.FRICTION: entry} if entry else {}
    criteria.explained, criteria._unexplained = lambda name: 1.0, unexplained
    assert criteria._accounts_for_error(test) is told


@pytest.mark.parametrize(("kind", "least"), [(Kind.FRICTION, 0.8), (Kind.DRIFT, 0.95), (Kind.PERIODIC, None)])
def test_replacement_explains_most_of_a_law(kind, least):
    """Relaxation leaves a tenth of the error; friction and drift have laws that would do as well."""
    left = {frozenset[Kind](): 1.0, frozenset({Kind.TIME_MEMORY}): 0.1}
    partial = SimpleNamespace(
        kinds=frozenset({Kind.TIME_MEMORY}),
        error=SimpleNamespace(mean_square=left.__getitem__),
        budget=SimpleNamespace(entries=[SimpleNamespace(kind=Kind.TIME_MEMORY)]),
        replacements=lambda entry: frozenset({Kind.FRICTION, Kind.DRIFT}),
    )
    criteria = SimpleNamespace(_partial=partial)
    needed = list(FormCriteria._replacement_thresholds(criteria, SimpleNamespace(kind=kind)))
    assert needed == ([] if least is None else [pytest.approx(0.9 * least)])


def test_alternative_explains_nineteen_twentieths_of_an_effect():
    """An effect that lowers the error from 10 to 2 is matched by an error of 2.4."""
    without, fit = (SimpleNamespace(solution=SimpleNamespace(held_out=error)) for error in (10.0, 2.0))
    search = SimpleNamespace(without=lambda *_: without, alternatives=lambda *_: [])
    assert module._alternatives(search, fit, "bias", 1) == (pytest.approx(2.4), [])


def torque_pulses(limit_nm, least, lag_s=1e-9):
    """A joint with pulses of acceleration, from `least` to 6 rad/s^2, and a sensor with a limit and a lag."""
    rng, fine, step_s, runs = np.random.default_rng(0), 8, 5e-4, []
    for _ in range(3):
        pairs = zip(rng.uniform(0.2, 0.3, 8), rng.uniform(least, 6.0, 8), strict=True)
        pulses = [np.repeat([a, -a], int(s / step_s)) for s, a in pairs]
        a = np.convolve(np.concatenate([np.zeros(400), *pulses])[:6400], np.full(100, 0.01), "same")
        runs.append(np.stack([a, v := np.cumsum(a) * step_s, np.cumsum(v) * step_s])[:, ::fine])
    a, v, q = np.concatenate(runs, axis=1)
    run, time_s = np.repeat(np.arange(3), len(q) // 3), step_s * fine * np.arange(len(q))
    torque = low_pass(np.clip(0.05 * a + 0.01 * v, -limit_nm, limit_nm), time_s, run, lag_s)
    torque = torque + rng.normal(0.0, 0.005, len(q))
    q = q + rng.normal(0.0, 1e-3, len(q))
    made = differentiate(time_s, q, run)
    motion = q, made.velocity, made.acceleration
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, *motion, torque, run, np.full(len(q), -1))


@pytest.mark.parametrize(
    ("limit_nm", "least", "smoothing"), [(np.inf, 6.0, True), (np.inf, 3.0, True), (0.2, 3.0, False)]
)
def test_plateau_of_the_acceleration_is_no_saturation(limit_nm, least, smoothing):
    search = searched(torque_pulses(limit_nm, least), "saturation", base=ROTOR)
    assert module.is_smoothing(search.start, reached(search, "saturation")) is smoothing


def test_lag_shorter_than_the_filter_of_the_motion_is_a_rival_of_a_delay():
    search = searched(torque_pulses(np.inf, 3.0, 0.02), "lag", "delay", base=ROTOR)
    delayed = reached(search, "delay")
    assert search.is_better(delayed, reached(search, "lag"))
    assert indistinguishable_models(search, delayed, "delay", measured(search)).keys() == {"lag"}


@pytest.mark.parametrize(("name", "smoothing"), [("saturation", True), ("coulomb_friction", False)])
def test_only_a_fault_of_the_sensor_must_be_in_the_smoothed_effort(monkeypatch, name, smoothing):
    for test, told in (
        ("is_in_smoothed_effort", False),
        ("looks_like_smoothing", False),
        ("is_below_cutoff", True),
    ):
        monkeypatch.setattr(module, test, lambda *_, told=told: told)
    search = searched(torque_pulses(0.2, 3.0), name, base=ROTOR)
    assert module.is_smoothing(search.start, reached(search, name)) is smoothing
