"""Candidate effects: forms, places and order, and plausibility of the result."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.budget.laws import unseen_kinds
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.diagnosis.candidates import (
    _snaps,
    applicable_effects,
    cross_validated_error,
    determined_count,
    effect_library,
    extended_models,
    is_misnamed,
    is_possible,
    parameter_count,
    screen_effects,
)
from palpate.estimation.effect import AdditiveEffect, Kind, Parameter
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_problem import Solution, solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from tests.estimation.presses import NOISE_N, K, kelvin_voigt, maxwell, session
from tests.estimation.searches import PRESS, searched
from tests.estimation.swings import DAMPING, one_way_turns, swings

BASE = ("pendulum", "viscous_friction")


def model(*names):
    return Model("m", tuple(EFFECTS[name]() for name in names))


SWUNG = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.02) + 6.0 * q)
STOOD = fit_model(SWUNG, model(*BASE), {})


@pytest.mark.parametrize(
    ("data", "determined"),
    [(swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.3)), 2), (one_way_turns(lambda q, v: 0.3 + 0.0 * q), 1)],
    ids=["reverses", "never reverses"],
)
def test_friction_transition_is_a_parameter_only_with_reversals(data, determined):
    fit = fit_model(data, model(*BASE, "coulomb_friction"), {"coulomb_friction.transition": 0.1})
    friction = EFFECTS["coulomb_friction"]()
    assert parameter_count(friction) == 2
    assert determined_count(friction, fit.solution.without_blocks(), fit.problem) == determined


def test_base_effect_that_imitates_a_missing_one_is_fitted_anew_beside_it():
    """Coulomb friction with a wide transition imitates viscous friction."""
    data = swings(1, lambda q, v, a: 0.05 * np.tanh(v / 0.02))
    search = searched(
        data, "viscous_friction", "bouc_wen_hysteresis", base=model("pendulum", "coulomb_friction")
    )
    assert search.start.solution.parameters["coulomb_friction.transition"] > 1.0
    best = search.screen(search.start)[0]
    parameters = best.search.best.parameters
    assert best.effect.name == "viscous_friction"
    assert parameters["viscous_friction.d"] == pytest.approx(DAMPING, rel=0.02)
    assert parameters["coulomb_friction.force"] == pytest.approx(0.05, rel=0.1)


class Made(AdditiveEffect):
    """An effect whose columns are given."""

    name, signals, channels = "made", ("position",), frozenset()

    def __init__(self, *gains, inner=(), essential=()):
        self.gains, self.inner, self.essential = gains, inner, essential

    def columns(self, data, inner):
        raise NotImplementedError


def gain(name="g", lower=0.0, upper=10.0):
    return Parameter(name, "N", lower, upper, (1.0, 2.0))


class LinearProblem:
    """A problem that fits columns by least squares, on 101 blocks of one run at 128 Hz.

    The position covers 0.5, the speed is at most 2, and the effort at most 3.
    """

    blocked = SimpleNamespace(
        data=SimpleNamespace(
            time_s=np.arange(101) / 128,
            run=np.zeros(101, dtype=int),
            range_of_motion=0.5,
            velocity=np.array([1.0, -2.0]),
            largest_effort=3.0,
        )
    )

    def solve(self, columns, target):
        left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        return SimpleNamespace(sse=np.array([left @ left]))


def tried(effect, values, columns, noise=0.0, standard_errors=0.0, inner=()):
    """A trial of one effect alone, with these gains, a noise that no column has, and standard errors."""
    made = Model("m", (effect,))
    wave = np.tile([1.0, -1.0], 50)
    parameters = dict(zip((*made.gains, *made.inner), (*values, *inner), strict=True))
    columns = np.column_stack(columns)
    linear_fit = SimpleNamespace(
        standard_errors=np.full(len(values), standard_errors), sse=np.array([noise**2 * 100])
    )
    target = columns @ np.array(values) + noise * wave
    return Solution(made, parameters, columns, target, linear_fit)


ONES = np.ones(100)


@pytest.mark.parametrize(
    ("parameter", "value", "possible"),
    [
        (Parameter("w", "{position}", 1e-3, 99.0, (0.1, 1.0), log=True), 4.9, True),
        (Parameter("w", "{position}", 1e-3, 99.0, (0.1, 1.0), log=True), 5.1, False),  # ten times the range
        (Parameter("w", "{position}", -99.0, 99.0, (0.1, 1.0)), -5.1, False),
        (Parameter("w", "{position}/s", 1e-3, 99.0, (0.1, 1.0), log=True), 19.9, True),
        (Parameter("w", "{position}/s", 1e-3, 99.0, (0.1, 1.0), log=True), 20.1, False),
        (Parameter("w", "{effort}", 1e-3, 99.0, (0.1, 1.0), log=True), 29.9, True),
        (Parameter("w", "{effort}", 1e-3, 99.0, (0.1, 1.0), log=True), 30.1, False),
        (Parameter("w", "1", 1e-3, 99.0, (0.1, 1.0), log=True), 98.0, True),
        (Parameter("w", "1", 1e-3, 99.0, (0.1, 1.0), log=True), 98.1, False),  # the end of its range
        (Parameter("w", "1", 1e-3, 99.0, (0.1, 1.0)), 98.1, True),
        (Parameter("t", "s", 1e-3, 99.0, (0.1, 1.0), log=True), 7.8, True),
        (Parameter("t", "s", 1e-3, 99.0, (0.1, 1.0), log=True), 7.9, False),
        (Parameter("t", "s", -1.0, 1.0, (0.1, 1.0)), 1 / 256, True),
        (Parameter("t", "s", -1.0, 1.0, (0.1, 1.0)), 0.99 / 256, False),  # less than half a step
        (Parameter("t", "s", -1.0, 1.0, (0.1, 1.0)), -1 / 256, True),
        (Parameter("t", "s", -1.0, 1.0, (0.1, 1.0)), -0.99 / 256, False),
    ],
)
def test_inner_parameters_are_within_ten_times_the_scale_of_the_data(parameter, value, possible):
    effect = Made(gain(), inner=(parameter,))
    assert is_possible(effect, tried(effect, [5.0], [ONES], inner=[value]), LinearProblem()) is possible


@pytest.mark.parametrize(
    ("values", "possible"),
    [([29.9], True), ([30.1], False), ([300.0, -299.0], True), ([300.0, -200.0], False)],
)
def test_own_effort_is_within_ten_times_the_largest(values, possible):
    effect = Made(*(gain(f"g{number}") for number in range(len(values))))
    found = tried(effect, values, [ONES] * len(values))
    assert is_possible(effect, found, LinearProblem()) is possible


@pytest.mark.parametrize(
    ("torque", "possible"),
    [(lambda q: 3.0 * np.sin(q + 1.0), True), (lambda q: 10.0 * q - 20.0 * q**2 + 20.0 * q**3, False)],
    ids=["weight", "hardening spring"],
)
def test_weight_does_not_imitate_a_hardening_spring_over_a_small_angle(torque, possible):
    data, noise = swings(1), 0.02 * np.random.default_rng(0).standard_normal(len(SWUNG))
    q, v, a = (0.1 * signal for signal in (data.position, data.velocity, data.acceleration))
    data = replace(data, position=q, velocity=v, acceleration=a, effort=torque(q) + 0.3 * v + noise)
    fit = fit_model(data, model("stiffness", "damping", "weight", "bias"), {})
    for name in ("weight", "bias"):
        assert is_possible(EFFECTS[name](), fit.solution, fit.problem) is possible


@pytest.mark.parametrize(("share", "possible"), [(0.021, True), (0.019, False)])
def test_essential_parameter_explains_two_percent_of_the_squared_error(share, possible):
    effect, wave = (
        Made(gain("minor"), gain("major"), essential=("major",)),
        np.tile([1.0, 1.0, -1.0, -1.0], 25),
    )
    found = tried(effect, [5.0, np.sqrt(share)], [ONES, wave], noise=1.0)
    assert is_possible(effect, found, LinearProblem()) is possible


def test_misnamed_effect_is_judged_by_acting_motion_and_residual():
    seen = {}

    class MisnamedEffect(Made):
        def is_misnamed(self, data, parameters, errors, noise):
            seen.update(data=data, parameters=parameters, errors=errors(), noise=noise)
            return True

    effect = MisnamedEffect(gain())
    found = tried(effect, [5.0], [ONES], noise=0.5, standard_errors=0.25)
    moved = Model("m", (effect, EFFECTS["contact_offset"]()))
    found = replace(found, model=moved, parameters={**found.parameters, "contact_offset.offset": 2e-3})
    data = session(1)
    assert is_misnamed(effect, found, SimpleNamespace(blocked=SimpleNamespace(data=data)))
    assert seen["data"].position == pytest.approx(data.position - 2e-3)
    assert (seen["errors"], seen["noise"]) == ({"made.g": 0.25}, pytest.approx(0.5))


@pytest.mark.parametrize(
    ("data", "base", "tried", "not_tried"),
    [
        ("joint", ("inertia",), {"weight", "bias"}, {"gravity_tilt", "inertia", "pendulum"}),
        ("joint", BASE, {"gravity_tilt", "armature"}, {"weight", *BASE, "inertia", "stiffness", "damping"}),
        ("joint", ("inertia", "gravity_tilt"), set(), {"weight", "gravity_tilt"} - {"weight"}),
        ("slide", ("inertia",), {"bias"}, {"damping", "stiffness", "run_gain"}),
        ("press", ("stiffness",), {"damping", "cubic_stiffness"}, {"run_gain", "run_offset", "rigid_body"}),
        ("press", (), {"stiffness", "inertia"}, {"pendulum", "rigid_body_fitted", "weight"}),
    ],
)  # fmt: skip
def test_candidates_suit_channel_and_model(data, base, tried, not_tried):
    kinds = {"joint": swings(1, runs=2), "press": session(1)}
    made = kinds.get(data) or replace(kinds["joint"], kind=ChannelKind.PRISMATIC)
    names = {effect.name for effect in applicable_effects(made, model(*base), effect_library())}
    assert tried <= names
    assert not names & not_tried


def test_sensor_fault_is_tried_before_and_after_another_in_each_form():
    lag, delay, bias = (EFFECTS[name]() for name in ("lag", "delay", "bias"))
    orders = [[e.name for e in one.effects] for one in extended_models(Model("m", (bias, lag)), delay)]
    assert orders == [["bias", "lag", "delay"], ["delay", "bias", "lag"]]
    assert len(extended_models(Model("m", (bias,)), delay)) == 1
    assert len(extended_models(Model("m", (lag,)), bias)) == 1
    forms = EFFECTS["dry_friction"]().forms()
    tried = [[one.effects[-1] for one in extended_models(Model("m", (bias,)), forms[0])] for _ in range(2)]
    assert [form.form for form in tried[0]] == [0, 1]
    assert list(map(id, tried[0])) == list(map(id, tried[1]))  # otherwise their columns would be recomputed


NAMES = ("bias", "coulomb_friction", "joint_spring", "torque_ripple")


@pytest.fixture(scope="module")
def ranked():
    told = []
    found = screen_effects(STOOD, [EFFECTS[name]() for name in NAMES], lambda *what: told.append(what))
    return found, told


def test_candidates_are_ordered_by_held_out_error(ranked):
    found, told = ranked
    left = [one.held_out for one in found]
    assert left == sorted(left)
    assert found[0].effect.name == "joint_spring"
    assert found[0].held_out == pytest.approx(found[0].search.held_out.sum())
    assert told == [(share, name) for share, name in zip((0.0, 0.25, 0.5, 0.75), NAMES, strict=True)]
    assert all(one.search.best.columns.size == 0 for one in found)  # they would fill the memory
    assert all(one.possible for one in found if one.effect.name != "torque_ripple")


@pytest.mark.parametrize(
    ("refined", "ripple_nm", "names"),
    [
        (0, 0.03, set()),
        (1, 0.1, {"coulomb_friction"}),
        (2, 0.1, {"coulomb_friction", "torque_ripple"}),
        # More than three tenths of what the best takes away.
        (1, 0.15, {"coulomb_friction", "torque_ripple"}),
    ],
)
def test_midpoints_of_the_best_and_nearly_best_are_tried(refined, ripple_nm, names):
    data = swings(
        2, lambda q, v, a: 0.3 * np.tanh(v / 0.02) + ripple_nm * np.sin(15.0 * q), runs=4, seconds=1.5
    )
    stood = fit_model(data, model(*BASE), {})
    effects = [EFFECTS[name]() for name in ("torque_ripple", "coulomb_friction")]
    found = {one.effect.name: one.search for one in screen_effects(stood, effects, refined=refined)}
    assert {name for name, one in found.items() if len(one.solutions) > one.start_count} == names
    for effect in effects:
        assert found[effect.name].start_count == len(effect.starts(data))


def test_effects_are_tried_at_given_places():
    (found,) = screen_effects(
        STOOD, [EFFECTS["coulomb_friction"]()], starts=lambda effect: [{"transition": 0.3}], refined=0
    )
    assert [one.parameters["coulomb_friction.transition"] for one in found.search.solutions] == [0.3]
    assert screen_effects(STOOD, []) == []


def test_model_offset_has_zero_size_beside_another_effect():
    """What a bias does, an offset of the surface did before: found where that is taken back."""
    data = session(3)
    data = replace(
        data, effort=data.effort + 0.8 * (data.position > 0) * (data.position * 800 + 15 * data.velocity > 0)
    )
    stood = fit_model(data, model("stiffness", "damping", "contact_offset"), {})
    off = replace(
        stood, solution=solve_gains(stood.problem, stood.solution.model, {"contact_offset.offset": -0.002})
    )
    (found,) = screen_effects(off, [EFFECTS["bias"]()], refined=0)
    assert found.search.best.parameters["contact_offset.offset"] == 0.0


def test_inner_parameter_costs_as_much_as_a_gain_where_runs_differ():
    """One relaxing branch, written with a gain or with a share of the spring, of another size in each run."""
    gains = np.array([200.0, 900.0, 300.0, 800.0, 100.0, 700.0])
    data = session(4, lambda t, x, v, run: kelvin_voigt(x, v, gains[run] * maxwell(t, x, run, 0.3)))
    good = np.ones(len(data), dtype=np.bool_)
    branch = fit_model(
        data, PRESS.with_effect(EFFECTS["stress_relaxation"]()), {"stress_relaxation.tau": 0.3}, good
    )
    found = branch.solution.parameters
    sudden = found["stiffness.k"] + found["stress_relaxation.k1"]
    same = {
        "stiffness.k": sudden,
        "damping.c": found["damping.c"],
        "relaxation_spectrum.fast": found["stress_relaxation.k1"] / sudden,
        "relaxation_spectrum.slow": 0.0,
        "relaxation_spectrum.fast_time": found["stress_relaxation.tau"],
        "relaxation_spectrum.slow_time": 30.0,
    }
    spectrum = fit_model(data, PRESS.with_effect(EFFECTS["relaxation_spectrum"]()), same, good)
    assert spectrum.solution.sse == pytest.approx(branch.solution.sse, rel=1e-3)
    assert spectrum.solution.held_out < 0.97 * branch.solution.held_out
    by_all = [cross_validated_error(fit.problem, fit.solution) for fit in (branch, spectrum)]
    assert by_all[1] > by_all[0]


def snaps(data, compliance, edge, side):
    """Whether a tool snaps through an object that loses twice its stiffness at depths beyond an edge."""

    def predict(moved, _):
        beyond = moved.position - edge
        return np.where(side * beyond > 0.0, -2.0 / compliance * beyond, 0.0)

    model = SimpleNamespace(predict=predict, without=lambda _: model)
    solution = SimpleNamespace(parameters={"tool_compliance.compliance": compliance}, model=model)
    return _snaps(solution, SimpleNamespace(blocked=SimpleNamespace(data=data)))


@pytest.mark.parametrize(("share", "is_rejected"), [(0.002, False), (0.05, True), (0.5, True)])
def test_tool_that_snaps_through_in_over_one_percent_of_samples_is_rejected(share, is_rejected):
    """Where the object softens faster than the tool gives, the force is no function of the way."""
    data, compliance = session(1), 1e-6
    deepest = np.max(data.position - compliance * data.effort)
    edge = np.quantile(data.position[data.engaged & (data.position <= deepest)], share)
    assert snaps(data, compliance, edge, -1.0) is is_rejected


@pytest.mark.parametrize(("share", "is_rejected"), [(0.98, True), (1.05, False)])
def test_object_deeper_than_its_tip_came_cannot_snap_through(share, is_rejected):
    """The tool gives by a third of the way; it softens from a share of the tip's deepest position on."""
    data = session(1)
    compliance = float(np.max(data.position) / np.max(data.effort)) / 3.0
    edge = share * np.max(data.position - compliance * data.effort)
    assert snaps(data, compliance, edge, 1.0) is is_rejected


@pytest.mark.parametrize(
    ("data", "applies"), [(swings(1), True), (one_way_turns(lambda q, v: 0.0 * q), False)]
)
def test_friction_over_the_position_is_seen_only_if_the_motion_reverses(data, applies):
    effect = EFFECTS["position_dependent_friction"]()
    assert (applicable_effects(data, Model("m", ()), [effect]) != ()) is applies


def imported(path, columns, **units):
    """The only channel of a table without a time."""
    np.savetxt(
        path, np.column_stack([*columns.values()]), delimiter=",", header=",".join(columns), comments=""
    )
    (channel,) = import_file(path, ImportOptions(units=units)).channels
    return channel


def test_steady_states_get_no_law_of_motion_or_time(tmp_path):
    """A position that is integrated over rows is arbitrary, but a smooth law of it may fit any few rows."""
    rng = np.random.default_rng(1)
    speed, torque = np.repeat(np.linspace(-12.0, 12.0, 9), 8), rng.normal(0.0, 0.3, 72)
    steady = imported(tmp_path / "s.csv", {"speed": speed, "torque": torque}, velocity="rad_s", torque="Nm")
    tried = applicable_effects(steady, model("inertia", "viscous_friction"), effect_library())
    assert {"coulomb_friction", "quadratic_friction", "bias"} <= {effect.name for effect in tried}
    for effect in tried:
        assert {"position", "acceleration", "past motion", "time"}.isdisjoint(effect.signals), effect.name
    unseen = unseen_kinds(steady)  # for the flexible laws of the budget
    assert {Kind.ELASTIC_SHAPE, Kind.DRIFT} <= unseen
    assert Kind.RATE_DEPENDENCE not in unseen


def test_delay_needs_recorded_times(tmp_path):
    depth = np.tile(np.abs(np.sin(np.arange(400) * 0.02)), 2)
    columns = {"displacement_mm": depth, "force_N": 2.0 * depth + 0.01 * np.cos(np.arange(800))}
    names = [
        {e.name for e in applicable_effects(data, model("stiffness", "damping"), effect_library())}
        for data in (
            imported(tmp_path / "a.csv", columns),
            imported(tmp_path / "b.csv", columns, time="10ms"),
        )
    ]
    assert names[1] - names[0] >= {"delay", "lag", "inertia"}
    assert "power_law_stiffness" in names[0]


@pytest.mark.parametrize("change", [-0.2, 0.01])
def test_effort_that_depends_on_a_recorded_column_is_promising_before_its_refinement(change):
    data = swings(1)
    celsius = np.sqrt(2.0) * np.sin(data.time_s)
    scaled = replace(
        data,
        effort=5.0 * (1.0 + change * celsius) * data.effort,
        context={"temperature": celsius},
        recorded=frozenset({"temperature"}),
    )
    fit = fit_model(scaled, model(*BASE), {})
    (found,) = screen_effects(fit, [EFFECTS["recorded_dependence"]().suited_to(scaled)], refined=0)
    assert found.held_out < fit.solution.held_out


@pytest.mark.parametrize("number", [0, 1])
def test_each_form_is_tried_with_its_own_columns(number):
    """Runs begin pressed: suddenly, or after a rest."""
    air = session(1)
    data = replace(air, position=air.position + 0.006)
    relaxation = EFFECTS["stress_relaxation"]().suited_to(data)
    branch = relaxation.forms()[number].columns(data, {"tau": 0.3}) @ [600.0]
    noise = np.random.default_rng(0).normal(0.0, NOISE_N, len(data))
    fit = fit_model(replace(data, effort=K * data.position + branch + noise), PRESS, {})
    (candidate,) = screen_effects(fit, [relaxation])

    assert candidate.search.best.model.effects[-1].form == number
