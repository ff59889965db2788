"""Forms of effects beside flexible laws of other kinds: which is named, and with what certainty."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.diagnosis import Verdict, acceptance, diagnose, forms
from palpate.estimation.diagnosis.acceptance import (
    FormCriteria,
    accept_forms,
    most_parsimonious,
    similar_forms,
)
from palpate.estimation.diagnosis.extension import fit_extended
from palpate.estimation.diagnosis.forms import (
    Form,
    FormTest,
    analyze_kinds,
    closest_forms,
    form_tests,
    named_forms,
)
from palpate.estimation.diagnosis.verdict import Evidence
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.kinds import Kind
from tests.estimation.contact_data import channel
from tests.estimation.searches import PRESS, ROTOR, SWING, measured, reached, searched
from tests.estimation.swings import NOISE_NM, one_way_turns
from tests.estimation.swings import coarse_swings as swings

TISSUE_NOISE_N = 5e-3
RUB, RIPPLE, DRAG, SPRING = "coulomb_friction", "torque_ripple", "quadratic_friction", "joint_spring"


def rubbing(q, v, a):
    return 0.4 * np.tanh(v / 0.02)


def strange(q, v, a):
    """A torque over the position that no effect here draws."""
    return 0.12 * np.sin(11.0 * q) * np.sign(np.sin(3.1 * q))


@pytest.fixture(scope="module")
def incomplete():
    """Friction beside something unknown, and a search that knows friction and two others."""
    search = searched(swings(1, lambda q, v, a: rubbing(q, v, a) + strange(q, v, a)), RUB, DRAG, SPRING)
    return search, analyze_kinds(search)


def test_form_is_named_beside_unexplained_error_unless_its_law_exceeds_it(incomplete):
    search, partial = incomplete
    assert partial.kinds >= {Kind.FRICTION}
    end, tests = accept_forms(search, partial, reached(search, RUB), measured(search))
    assert search.added_effects(end) == [RUB]
    (test,) = tests
    assert (test.effect, test.kind, test.is_known) == (RUB, Kind.FRICTION, True)
    share = test.explained_by_effect / (search.start.held_out_mean_square - end.held_out_mean_square)
    assert share == pytest.approx(1.0, abs=0.2)  # what it takes beside laws and beside the base model
    # Drag by the square of the speed is there nowhere.
    search, partial = incomplete
    end, tests = accept_forms(search, partial, reached(search, DRAG), measured(search))
    assert (end, tests) == (search.start, [])


def test_model_that_may_not_shrink_is_rejected_at_its_weakest_effect(incomplete, monkeypatch):
    search, partial = incomplete
    failed_by, examined = FormCriteria.failed_by, []
    monkeypatch.setattr(
        FormCriteria, "failed_by", lambda self, test: examined.append(test.effect) or failed_by(self, test)
    )
    both = accept_forms(search, partial, reached(search, RUB, DRAG), measured(search), fewest=2)
    assert both == (search.start, [])
    assert examined == [DRAG]


def test_best_form_of_each_kind_is_identified():
    law = lambda q, v, a: rubbing(q, v, a) + 0.3 * np.sin(15.0 * q)  # noqa: E731
    search = searched(swings(1, law), RUB, RIPPLE, DRAG, SPRING)
    found = named_forms(analyze_kinds(search))
    assert set(search.added_effects(found)) == {RUB, RIPPLE}
    assert found.solution.parameters["coulomb_friction.force"] == pytest.approx(0.4, rel=0.05)
    assert found.solution.parameters["torque_ripple.cycles"] == pytest.approx(15.0, rel=0.02)


@pytest.mark.parametrize(
    ("smaller", "is_sensible", "is_named"), [(1.019, True, True), (1.021, True, False), (1.0, False, False)]
)
def test_smallest_of_about_equally_good_sets_of_forms_is_named(monkeypatch, smaller, is_sensible, is_named):
    drag, both = frozenset({Kind.FRICTION}), frozenset({Kind.FRICTION, Kind.PERIODIC})

    def fit(partial, kinds):
        return SimpleNamespace(
            kinds=kinds, solution=SimpleNamespace(held_out=smaller if kinds == drag else 1.0)
        )

    monkeypatch.setattr(forms, "_forms_of", fit)
    budget = SimpleNamespace(entries=[], sufficient_kinds=drag, alternatives=[])
    search = SimpleNamespace(size=lambda one: len(one.kinds))
    search.is_sensible = lambda one: is_sensible or one.kinds == both
    found = named_forms(SimpleNamespace(kinds=both, budget=budget, search=search))
    assert found.kinds == (drag if is_named else both)


def test_slope_by_position_is_that_of_the_model_even_over_a_short_way():
    data = swings(1)
    data, cycles = replace(data, position=1e-3 * data.position), 5000.0
    parameters = {"torque_ripple.cycles": cycles, "torque_ripple.sine": 0.3, "torque_ripple.cosine": 0.0}
    model = SWING.with_effect(EFFECTS[RIPPLE]())
    parameters = dict.fromkeys(model.gains, 0.0) | parameters
    fit = SimpleNamespace(data=data, model=model, solution=SimpleNamespace(parameters=parameters))
    expected = 0.3 * cycles * np.cos(cycles * data.position)
    np.testing.assert_allclose(forms._slope_by_position(fit), expected, atol=1e-3 * cycles)


def tissue():
    """Slow presses and holds of five specimens whose elastic force stiffens and relaxes in two steps."""
    rng, dt = np.random.default_rng(1), 0.2
    depths, forces = [], []
    for _ in range(5):
        speed, deepest = rng.uniform(0.5e-3, 1.5e-3), rng.uniform(5e-3, 9e-3)
        ramp = np.linspace(0.0, deepest, int(deepest / speed / dt))
        depth = np.concatenate([ramp, np.full(50, deepest), ramp[::-1]])
        steps, left = np.diff(9e3 * depth**1.9, prepend=0.0), np.array([0.2, 0.5, 0.3])
        decay, force = np.exp(-dt / np.array([np.inf, 1.2, 15.0])), np.zeros((len(depth), 3))
        for i, step in enumerate(steps):
            force[i] = force[i - 1] * decay + step if i else step
        depths.append(depth)
        force = rng.uniform(0.6, 1.4) * np.maximum(force @ left, 0.0)
        forces.append(force + rng.normal(0.0, TISSUE_NOISE_N, len(depth)))
    run = np.repeat(np.arange(5), list(map(len, depths)))
    time_s = dt * np.arange(len(run)) + 1000.0 * run
    velocity = np.concatenate([np.gradient(depth, dt) for depth in depths])
    return channel(np.concatenate(forces), np.concatenate(depths), velocity, time_s, run=run)


def test_elastic_shape_and_relaxation_are_identified_as_a_product():
    """One branch of memory without a shape fits better than each factor alone, and hides the other factor."""
    names = {"power_law_stiffness", "relaxation_spectrum", "run_gain"}
    search = searched(tissue(), *sorted(names), "stress_relaxation", base=PRESS)
    partial = analyze_kinds(search)
    found = named_forms(partial)
    assert set(search.added_effects(found)) == names
    assert found.solution.parameters["power_law_stiffness.n"] == pytest.approx(1.9, abs=0.05)
    accepted, _ = accept_forms(search, partial, found, measured(search))
    assert set(search.added_effects(accepted)) == names
    flat = found.solution.model.without("power_law_stiffness")
    hidden = fit_model(search.data, flat, found.solution.parameters)
    extended = fit_extended(search.data, hidden, EFFECTS["power_law_stiffness"]())
    assert extended.rmse == pytest.approx(TISSUE_NOISE_N, rel=0.1)
    assert hidden.rmse > 5.0 * extended.rmse


def test_kind_without_a_form_gets_only_its_closest_forms():
    """Friction that also falls with the speed, where the library has Coulomb's alone."""
    law = lambda q, v, a: (0.2 + 0.3 * np.exp(-((v / 0.6) ** 2))) * np.tanh(v / 0.01)  # noqa: E731
    partial = analyze_kinds(searched(swings(1, law), RUB, DRAG, SPRING))
    assert partial.budget.kinds[0] is Kind.FRICTION
    assert closest_forms(partial, Kind.FRICTION, partial.kinds) == [RUB]
    assert closest_forms(partial, Kind.INERTIA, partial.kinds) == []


@pytest.mark.parametrize(
    ("explained_by_effect", "explained_by_law", "added", "left", "known", "closed"),
    [
        (8.0, 10.0, 0.09, 1.0, True, False),
        (7.9, 10.0, 0.0, 1.0, False, True),
        (8.0, 8.0, 0.04, 1.0, True, True),  # less than a twentieth of what is left
        (8.0, 8.0, 0.07, 0.1, True, True),  # less than a hundredth of what it takes
        (0.0, 0.0, 0.0, 1.0, False, True),
    ],
)
def test_form_is_known_if_it_explains_most_of_its_law(
    explained_by_effect, explained_by_law, added, left, known, closed
):
    test = FormTest(RUB, Kind.FRICTION, explained_by_effect, explained_by_law, added, left)
    assert (test.is_known, test.is_closed) == (known, closed)


@pytest.mark.parametrize(
    ("complete", "added", "rivals", "kinds", "form"),
    [
        (True, 0.0, {}, {}, Form.EXACT),
        (True, 0.5, {}, {}, Form.APPROXIMATE),  # a law of its kind takes half as much again
        (True, 0.0, {DRAG: None}, {}, Form.APPROXIMATE),  # the data cannot tell the two laws apart
        (True, 0.0, {}, {Kind.RATE_DEPENDENCE: 0.0}, Form.APPROXIMATE),  # or this and an unknown law
        (False, 0.0, {}, {}, Form.APPROXIMATE),
    ],
)
def test_form_is_exact_if_only_noise_is_left_and_no_law_replaces_it(
    monkeypatch, complete, added, rivals, kinds, form
):
    test = FormTest(RUB, Kind.FRICTION, 1.0, 1.0, added_by_law=added, unexplained=0.1)
    evidence = Evidence(None, None, None, complete, None, [test])
    vars(evidence).update(leaves_only_noise=complete, rivals={RUB: rivals}, replacing_kinds={RUB: kinds})
    monkeypatch.setattr(Evidence, "_is_resolved", lambda *_: True)
    assert evidence.form(RUB) is form


def test_form_is_exact_only_if_a_deviation_of_five_percent_would_exceed_the_noise():
    """The true effect is Coulomb friction of 6 times the noise; test_diagnose has the exact one."""
    friction = swings(1, lambda q, v, a: 6.0 * NOISE_NM * np.tanh(v / 0.02))
    found = decide(friction, SWING, RUB, SPRING, DRAG)
    assert {entry.effect: entry.form for entry in found.accepted} == {RUB: Form.APPROXIMATE}


def test_law_of_its_kind_adds_nothing_to_a_true_form():
    stribeck = lambda q, v, a: (0.2 + 0.3 * np.exp(-((v / 0.6) ** 2))) * np.tanh(v / 0.01)  # noqa: E731
    search = searched(swings(1, stribeck, runs=5), RUB, "stribeck_friction")
    partial = analyze_kinds(search)
    (true,), (rough,) = (form_tests(partial, reached(search, name)) for name in ("stribeck_friction", RUB))
    assert true.is_known
    assert true.is_closed
    assert rough.added_by_law > 3.0 * true.added_by_law
    assert not rough.is_closed
    assert search.added_effects(named_forms(partial)) == ["stribeck_friction"]


def test_kind_without_a_law_explains_nothing_even_beside_a_gain_at_its_bound():
    fit = fit_model(swings(1, lambda q, v, a: -0.3 * v), SWING, {})
    assert fit.solution.parameters["viscous_friction.d"] == 0.0
    none = np.empty((len(fit.problem.blocked), 0))
    assert forms._with_law(fit.problem, fit.solution, none) == fit.solution.held_out


@pytest.mark.parametrize(("own", "removed"), [(Kind.SENSOR_STATICS, True), (Kind.FRICTION, False)])
def test_sensor_effects_are_compared_without_the_smoothing_bias(monkeypatch, own, removed):
    """A base model without the effect may hide this bias, which the laws of a sensor could imitate."""
    search = searched(swings(1), "bias")
    partial, problem = analyze_kinds(search), search.start.problem
    wave = np.sin(problem.blocked.time_s)
    monkeypatch.setattr(forms, "fit_smoothing_bias", lambda *_: (wave[:, None], None))
    adjusted = partial._adjust_problem(frozenset({own}), partial.kinds, problem, search.start.solution)
    assert (np.abs(adjusted.nuisance.remove(wave)[problem.used]).max() < 1e-6) == removed


def test_form_of_the_kind_that_explains_as_much_is_its_like():
    """What draws nearly the same, with as few parameters; a spring is of another kind."""
    search = searched(swings(1, rubbing), RUB, "stribeck_friction", SPRING)
    likes = similar_forms(search, reached(search, "stribeck_friction"), "stribeck_friction")
    assert set(likes) == {RUB}
    assert similar_forms(search, reached(search, RUB), RUB) == {}  # Stribeck's law has more parameters


def decide(data, base, *names):
    effects = [EFFECTS[name]() for name in names]
    return diagnose(data, base, effects, rng=np.random.default_rng(1)).channels[0]


def test_form_with_an_unknown_law_is_approximate():
    """Alone it is exact: see test_diagnose."""
    both = decide(swings(1, lambda q, v, a: rubbing(q, v, a) + strange(q, v, a)), SWING, RUB, SPRING, DRAG)
    assert (both.verdict, both.complete) == (Verdict.MISSING, False)
    assert {entry.effect: entry.form for entry in both.accepted} == {RUB: Form.APPROXIMATE}
    (share,) = (share for share in both.budget if share.kind is Kind.FRICTION)
    assert (share.form, share.effects) == (Form.APPROXIMATE, [RUB])


def test_most_parsimonious_form_of_replaceable_kinds_is_named():
    """A spring that the displacement's zero is not at, and whose first loading beds it in."""
    rng, depth, run = np.random.default_rng(0), np.linspace(2.1e-3, 9.5e-3, 150), np.repeat(np.arange(5), 150)
    x, bedded = np.tile(depth, 5), np.repeat([2e-4, 2e-5, -6e-5, -7e-5, -8e-5], 150)
    force = np.maximum(1.4e5 * (x - 2e-3 + bedded), 0.0) + rng.normal(0.0, 0.7, len(x))
    time_s, v = 0.05 * np.arange(len(x)) + 100.0 * run, np.full(len(x), 1e-3)
    search = searched(
        channel(force, x, v, time_s, run=run), "layered_stiffness", "contact_offset", base=PRESS
    )
    partial = analyze_kinds(search)
    end, (test,) = accept_forms(search, partial, named_forms(partial), measured(search))
    assert search.added_effects(end) == ["contact_offset"]
    assert end.solution.parameters["contact_offset.offset"] == pytest.approx(2e-3, abs=2e-4)
    budget = partial.budget_with(frozenset({test.kind}))
    assert budget.kinds[0] is Kind.CONTACT_GEOMETRY
    assert Kind.ELASTIC_SHAPE in budget.entries[0].replaceable_by


def test_forms_that_jointly_leave_as_little_as_their_laws_are_named(monkeypatch):
    """Though one of them takes less of the error than its own kind's law, which draws a part of the other."""
    law = lambda q, v, a: rubbing(q, v, a) + 0.3 * np.sin(15.0 * q) * (1 + 0.1 * np.sin(4.0 * q))  # noqa: E731
    search = searched(swings(1, law), RUB, RIPPLE)
    partial, end = analyze_kinds(search), reached(search, RIPPLE, RUB)
    monkeypatch.setattr(FormTest, "share", 0.5)
    left, base = end.held_out_mean_square, partial.budget.base
    shares = ((1.1, base, [RIPPLE, RUB]), (0.8, base, []), (1.1, 2.0 * np.sqrt(left), []))
    for of_laws, all_error, names in shares:  # names take most of the error, or a share that is no kind's
        budget = replace(partial.budget, unexplained=of_laws * left / all_error**2, base=all_error)
        known, _ = accept_forms(search, replace(partial, budget=budget), end, measured(search))
        assert search.added_effects(known) == names


def deep_presses(curvature=0.0):
    """Presses of a spring whose displacement is zero 16 mm above its surface."""
    x, run = np.tile(np.linspace(12e-3, 38e-3, 600), 3), np.repeat(np.arange(3), 600)
    v, noise = np.array([1e-3, 2e-3, 4e-3])[run], np.random.default_rng(0).normal(0.0, 0.3, 1800)
    force = 3e4 * (x - 16e-3).clip(0.0) + curvature * (x - 18e-3).clip(0.0) ** 2 + noise
    return channel(force, x, v, (x - 12e-3) / v + 100.0 * run, run=run)


def test_ambiguous_effect_is_attributed_to_the_object(whole_budget):
    """A dead band of the sensor describes nearly the same curve."""
    search = searched(deep_presses(1e5), "deadband", "contact_offset", base=PRESS)
    end, _ = accept_forms(search, analyze_kinds(search), reached(search, "deadband"), measured(search))
    assert search.added_effects(end) == ["contact_offset"]


def test_object_effect_is_preferred_over_an_equivalent_sensor_effect(monkeypatch):
    """The surface was read well: a dead band of the reader draws the same line."""
    search = searched(deep_presses(), "deadband", "contact_offset", base=PRESS)
    for found, is_better in (("deadband", type(search).is_better), ("contact_offset", lambda *fits: True)):
        monkeypatch.setattr(type(search), "is_better", is_better)
        end = most_parsimonious(search, reached(search, found), measured(search), lambda _: True)
        assert search.added_effects(end) == ["contact_offset"]


@pytest.mark.parametrize(
    ("imitating", "names"),
    [
        ("contact_offset", ["quadratic_damping", "deadband"]),
        ("quadratic_damping", ["quadratic_damping", "contact_offset"]),
    ],
)
def test_an_effect_is_replaced_unless_the_new_one_imitates_another_kind(monkeypatch, imitating, names):
    """An offset that only imitated the dead band would be dropped later, and nothing would be named."""
    search = searched(deep_presses(), "deadband", "contact_offset", "quadratic_damping", base=PRESS)
    found = reached(search, "quadratic_damping", "deadband")
    monkeypatch.setattr(
        acceptance, "imitating_effect", lambda search, end, new: imitating if imitating in new else None
    )
    end = most_parsimonious(search, found, measured(search), lambda _: True)
    assert search.added_effects(end) == names


@pytest.mark.parametrize("rest", [0.0, 0.4])  # of another kind, so that the model stays incomplete
def test_friction_and_bias_are_indistinguishable_in_monotonic_motion(rest):
    data = one_way_turns(lambda q, v: 0.8 + rest * np.sin(3.0 * q + v))
    told = decide(data, ROTOR, "bias", "coulomb_friction", "joint_spring")
    assert told.verdict is Verdict.MISSING
    ((name, others),) = ((entry.effect, entry.confused_with) for entry in told.accepted)
    assert (name, others) == ("coulomb_friction", ["bias"])
    assert told.next_experiment.instruction.startswith("repeat the motion in the other direction")


def test_weight_and_spring_are_both_reported_over_a_short_way():
    """Beside the weight acts a torque whose law the library lacks."""
    wide = swings(3)
    q, v, a = 0.7 * wide.position, 0.7 * wide.velocity, 0.7 * wide.acceleration
    noise = np.random.default_rng(5).normal(0.0, 0.02, len(q))
    torque = 0.05 * a + 0.15 * v + 2.0 * np.sin(q) + 2.0 * strange(q, v, a) + noise
    data = replace(wide, position=q, velocity=v, acceleration=a, effort=torque)
    told = decide(data, ROTOR, "joint_spring", "weight", "bias")
    (entry,) = told.accepted
    assert {entry.effect, *entry.confused_with} == {"joint_spring", "weight"}
    assert set(told.next_experiment.separates) == {"joint_spring", "weight"}


def slow_swings(torque_of_angle, scale):
    """Swings of a rotor over part of a turn, beside dry friction, which the library lacks."""
    wide = swings(3)
    q, v, a = scale * wide.position, scale * wide.velocity, scale * wide.acceleration
    noise = np.random.default_rng(5).normal(0.0, 0.02, len(q))
    torque = 0.05 * a + 0.15 * v + torque_of_angle(q) + 0.3 * np.tanh(v / 0.02) + noise
    return replace(wide, position=q, velocity=v, acceleration=a, effort=torque)


@pytest.mark.parametrize("torque_of_angle", [lambda q: 2.0 * np.sin(q), lambda q: 1.95 * q])
def test_weight_is_likelier_than_a_spring_over_a_short_way(torque_of_angle):
    told = decide(slow_swings(torque_of_angle, 0.7), ROTOR, "joint_spring", "weight", "bias")
    (entry,) = told.accepted
    assert (entry.effect, entry.confused_with) == ("weight", ["joint_spring"])
    assert set(told.next_experiment.separates) == {"joint_spring", "weight"}


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("weight", lambda q: 2.0 * np.sin(q)),
        ("joint_spring", lambda q: 2.0 * q),
        ("joint_spring", lambda q: -2.0 * q),
    ],
)
def test_wide_motion_distinguishes_weight_and_spring(name, law):
    """A negative stiffness is described as not passive."""
    (entry,) = decide(slow_swings(law, 2.5), ROTOR, "joint_spring", "weight", "bias").accepted
    assert entry.effect == name
    spring = EFFECTS["joint_spring"]()
    described = spring.describe_physics({"k": law(1.0), "preload": 0.1})
    assert entry.physics == (EFFECTS["weight"].physics if name == "weight" else described)
    assert all((part in described) == (law(1.0) < 0.0) for part in ("not a passive spring", "opposite sign"))


@pytest.mark.parametrize("returns", [False, True])
def test_constant_force_is_yielding_in_a_pull_and_saturation_after_a_return(returns):
    pull = np.linspace(0.0, 4e-3, 300) ** 1.2 / 4e-3**0.2
    x = np.tile(np.concatenate([pull, pull[::-1]]) if returns else pull, 3)
    run, time_s = np.repeat(np.arange(3), len(x) // 3), 0.01 * np.arange(len(x))
    v = np.concatenate([np.gradient(x[run == number], 0.01) for number in range(3)])
    force = np.minimum(2e4 * x, 30.0) + np.random.default_rng(2).normal(0.0, 0.2, len(x))
    told = decide(channel(force, x, v, time_s, run=run), PRESS, "saturation", "layered_stiffness")
    (entry,) = told.accepted
    assert entry.effect == ("saturation" if returns else "layered_stiffness")


@pytest.mark.parametrize(("without", "limit"), [(101.0, 2.05), (1001.0, 2.25)])
def test_law_that_leaves_hardly_more_may_replace_an_effect(monkeypatch, without, limit):
    """1 is left. Little is a hundredth of what the effect explains and a 20th of 1, at most 1.5^2 - 1."""
    laws = {Kind.GRAVITY_LOAD: limit - 0.01, Kind.ELASTIC_SHAPE: limit + 0.01, Kind.SENSOR_STATICS: 0.9}
    laws |= dict.fromkeys((Kind.FRICTION, Kind.RUN_DIFFERENCES), 1.0)  # its own, and of no form
    end = SimpleNamespace(solution=SimpleNamespace(model=SWING.with_effect(EFFECTS[RUB]())))

    def error_of_kinds(fit, with_laws=True):
        alone = 1.0 if fit is end else without
        return SimpleNamespace(
            kinds=frozenset(laws), mean_square=lambda kinds=(): sum(laws[kind] for kind in kinds) or alone
        )

    monkeypatch.setattr(forms, "error_of_kinds", error_of_kinds)
    search = SimpleNamespace(added_effects=lambda _: [RUB], without=lambda *_: None)
    more = {Kind.GRAVITY_LOAD: pytest.approx(limit - 1.01), Kind.SENSOR_STATICS: 0.0}
    assert forms.replacing_kinds(search, end) == {RUB: more}


def dragging(q, v, a):
    return 0.1 * v * np.abs(v)


def drifting(torque, run):
    return torque + 0.05 * (np.arange(len(run)) / 250.0 + 3.0 * run)


def shifted(torque, run):
    return torque + np.array([0.3, -0.2, 0.4])[run]


@pytest.mark.parametrize(
    ("law", "sensor", "names", "imitating"),
    [
        (rubbing, None, [RUB], None),
        (rubbing, None, [DRAG], DRAG),  # dry friction, of which the library knows no form
        (lambda q, v, a: rubbing(q, v, a) + dragging(q, v, a), None, [RUB, DRAG], None),
        (lambda q, v, a: dragging(q, v, a) + strange(q, v, a), None, [DRAG], None),
        (dragging, drifting, ["run_offset", DRAG], "run_offset"),
        (dragging, shifted, ["run_offset", DRAG], None),
    ],
)
def test_effect_that_a_law_of_another_kind_exceeds_imitates_this_kind(law, sensor, names, imitating):
    data = swings(1, law, sensor=sensor) if sensor else swings(1, law)
    search = searched(data, RUB, DRAG, "run_offset")
    model = SWING
    for name in names:
        model = model.with_effect(EFFECTS[name]())
    end = search.fitted(model, {"run_offset.share": 1.0})
    assert forms.imitating_effect(search, end) == imitating


@pytest.mark.parametrize(("left", "imitating"), [(0.9, RUB), (0.4, None)])
def test_effect_whose_model_leaves_less_than_the_law_of_another_kind_does_not_imitate_it(
    monkeypatch, left, imitating
):
    """Laws are compared by linear models, which leave more than a model whose force ends with the contact."""
    end = SimpleNamespace(
        solution=SimpleNamespace(model=SWING.with_effect(EFFECTS[RUB]())), held_out_mean_square=left
    )
    error = SimpleNamespace(kinds=[Kind.INERTIA], mean_square=lambda kinds=None: 0.5 if kinds else 1.0)
    monkeypatch.setattr(forms, "error_of_kinds", lambda fit, with_laws=True: error)
    search = SimpleNamespace(added_effects=lambda _: [RUB], without=lambda *_: object())
    assert forms.imitating_effect(search, end) == imitating


@pytest.mark.parametrize(
    ("kind", "replaced"), [(Kind.SENSOR_STATICS, {RUB, SPRING}), (Kind.FRICTION, {SPRING})]
)
def test_law_that_describes_what_two_effects_do_together_may_replace_both(monkeypatch, kind, replaced):
    """Without one of the effects the law leaves too much, without both as little as they.

    The law of an effect's own kind is no alternative to it.
    """
    model = SWING.with_effect(EFFECTS[RUB]()).with_effect(EFFECTS[SPRING]())
    end = SimpleNamespace(solution=SimpleNamespace(model=model))
    base = SimpleNamespace(name="base")
    with_law = {id(base): 1.02}

    def error_of_kinds(fit, with_laws=True):
        alone, beside = (1.0, 1.0) if fit is end else (100.0, with_law.get(id(fit), 50.0))
        return SimpleNamespace(kinds=[kind], mean_square=lambda kinds=(): beside if kinds else alone)

    monkeypatch.setattr(forms, "error_of_kinds", error_of_kinds)
    search = SimpleNamespace(start=base, added_effects=lambda _: [RUB, SPRING], without=lambda *_: object())
    replacing = {kind: pytest.approx(0.02)}
    expected = {name: replacing if name in replaced else {} for name in (RUB, SPRING)}
    assert forms.replacing_kinds(search, end) == expected
    with_law[id(base)] = 50.0
    assert forms.replacing_kinds(search, end) == {RUB: {}, SPRING: {}}


@pytest.mark.parametrize(
    ("offsets_nm", "is_known"), [((0.5, -0.3, 0.1, -0.5, 0.2), True), ((0.0, 0.0, 0.0, 0.0, 0.0), False)]
)
def test_variation_between_runs_is_known_if_runs_differ(offsets_nm, is_known):
    """Beside a friction, and a torque that nobody knows."""
    data = swings(
        1,
        lambda q, v, a: rubbing(q, v, a) + strange(q, v, a),
        sensor=lambda torque, run: torque + np.array(offsets_nm)[run],
        runs=5,
    )
    search = searched(data, RUB, "run_offset")
    model = SWING.with_effect(EFFECTS[RUB]()).with_effect(EFFECTS["run_offset"]())
    end = search.fitted(model, {"run_offset.share": 1.0})
    tests = {test.effect: test for test in form_tests(analyze_kinds(search), end)}
    assert tests[RUB].is_known
    varied = tests["run_offset"]
    assert (varied.kind, varied.is_known) == (Kind.RUN_DIFFERENCES, is_known)
    if is_known:
        assert 0.6 * np.var(offsets_nm) < varied.explained_by_effect < np.var(offsets_nm)
        assert varied.unexplained < 0.1 * varied.explained_by_effect
        (alone,) = form_tests(analyze_kinds(search), reached(search, RUB))  # beside the law of differences
        assert alone.unexplained_by_all < 0.1 * varied.explained_by_effect
