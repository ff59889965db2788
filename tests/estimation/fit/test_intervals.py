"""Intervals against textbook formulas, and acceleration noise judged by positions."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import Determined, interval_text
from palpate.estimation.fit import fit_result
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import FitResult, final_solution, fit_model
from palpate.estimation.fit.intervals import _errors, _without_jumps, estimate_parameters
from palpate.estimation.fit.measurement_model import inflate_acceleration_noise
from palpate.estimation.model import Model
from palpate.estimation.statistics.noise import sum_covariance
from tests.estimation.presses import session
from tests.estimation.swings import DAMPING, INERTIA, WEIGHT, smoothed, swings, within

BASE = Model("pendulum", (EFFECTS["pendulum"](), EFFECTS["viscous_friction"]()))
RNG = np.random.default_rng(3)
COUNT = 4000
SLOPES = RNG.normal(size=(COUNT, 3)) * [1.0, 1e3, 1e-3]
RUN = np.repeat(np.arange(8), COUNT // 8)


def test_standard_errors_are_those_of_least_squares_for_white_noise():
    noise = 0.3 * RNG.normal(size=COUNT)
    textbook = 0.3 * np.sqrt(np.diag(np.linalg.inv(SLOPES.T @ SLOPES)))
    assert _errors(SLOPES, noise, RUN) == pytest.approx(textbook, rel=0.08)
    few = _errors(SLOPES[:8], noise[:8], RUN[:8])
    more = _errors(np.tile(SLOPES[:8], (100, 1)), np.tile(noise[:8], 100), np.arange(800))
    assert (few > 9.0 * more).all()  # freedom that eight samples for three parameters lack


def test_slow_noise_widens_errors_of_slow_parameters():
    """A mean of AR(1) noise: its variance is (1 + r) / (1 - r) times that of white noise as large."""
    noise = np.zeros(COUNT)
    for i in range(1, COUNT):
        noise[i] = 0.8 * noise[i - 1] + 0.6 * RNG.normal()
    ones = np.ones((COUNT, 1))
    assert _errors(ones, noise, RUN) == pytest.approx([np.sqrt(9.0 / COUNT)], rel=0.25)
    meat = sum_covariance(ones * noise[:, None], RUN).matrix[0, 0]
    assert _errors(ones, noise, RUN)[0] == pytest.approx(np.sqrt(meat) / COUNT, rel=1e-3)


@pytest.mark.parametrize(
    ("columns", "unknown"),
    [
        ([0, 1, 0], [True, False, True]),  # two make up for each other
        ([0, 1, 2], [False, False, False]),
    ],
)
def test_collinear_parameters_have_infinite_errors(columns, unknown):
    assert np.isnan(_errors(SLOPES[:, columns], RNG.normal(size=COUNT), RUN)).tolist() == unknown
    nothing = np.column_stack([SLOPES, np.zeros(COUNT)])
    assert np.isnan(_errors(nothing, RNG.normal(size=COUNT), RUN)).tolist() == [False] * 3 + [True]


@pytest.mark.parametrize(("size", "kept"), [(20.0, True), (20.1, False), (-20.1, False)])
def test_slope_jump_is_twenty_times_the_typical_slope(size, kept):
    slope = np.append(np.zeros(500), np.append(np.tile([1.0, -1.0], 200), size))
    assert (_without_jumps(slope)[-1] == size) == kept
    assert _without_jumps(slope)[:-1] == pytest.approx(slope[:-1])
    assert not _without_jumps(np.zeros(5)).any()


@pytest.fixture(scope="module")
def found():
    model = replace(BASE.with_effect(EFFECTS["coulomb_friction"]()), held={"viscous_friction.d": 0.15})
    fit = fit_model(
        swings(4, lambda q, v, a: 0.3 * np.tanh(v / 0.01)), model, {"coulomb_friction.transition": 0.02}
    )
    return estimate_parameters(*final_solution(fit)), fit


def test_each_parameter_has_its_unit_and_a_two_sigma_interval(found):
    known, fit = found
    assert list(known) == [*fit.solution.model.gains, *fit.solution.model.inner]
    units = [
        known[name].unit
        for name in ("pendulum.inertia", "coulomb_friction.force", "coulomb_friction.transition")
    ]
    assert units == ["kg m^2", "N m", "rad/s"]
    for name, one in known.items():
        assert one.interval == pytest.approx((one.value - 1.96 * one.std_err, one.value + 1.96 * one.std_err))
        assert one.name == name
    force = known["coulomb_friction.force"]
    assert abs(force.value - 0.3) < 4.0 * force.std_err < 0.02
    assert (known["viscous_friction.d"].value, known["viscous_friction.d"].std_err) == (0.15, 0.0)
    assert not any(one.at_bound for one in known.values())


def test_parameter_with_zero_in_its_interval_is_undetermined():
    model = BASE.with_effect(EFFECTS["coulomb_friction"]())
    known = fit_model(swings(4), model, {"coulomb_friction.transition": 0.02}).parameters
    lower, upper = known["coulomb_friction.force"].interval
    assert lower < 0.0 < upper
    assert known["coulomb_friction.force"].determined is Determined.NO
    assert interval_text(known["coulomb_friction.force"]) == f"{lower:.5g} to {upper:.5g} (not determined)"
    assert known["pendulum.inertia"].determined is Determined.YES
    held = fit_model(swings(4), replace(model, held={"coulomb_friction.force": 0.0}), {}).parameters
    assert held["coulomb_friction.force"].determined is Determined.YES
    unknown = replace(known["pendulum.inertia"], interval=(np.nan, np.nan), determined=Determined.NO)
    assert interval_text(unknown) == "not determined"


def test_gain_limited_by_its_bound_is_reported_at_the_bound():
    fit = fit_model(swings(4, lambda q, v, a: -2.0 * DAMPING * v), BASE, {})
    damping, inertia = (fit.parameters[name] for name in ("viscous_friction.d", "pendulum.inertia"))
    assert (damping.value, damping.std_err, damping.at_bound) == (0.0, 0.0, True)
    assert not inertia.at_bound
    assert [words.split()[:4] for words in fit.unphysical] == [["viscous_friction.d", "would", "be", "below"]]


def test_noise_is_whitened_only_where_nothing_is_missing(found):
    _, fit = found
    problem, solution = final_solution(fit)
    assert problem is fit.whitened_problem
    assert solution.parameters == pytest.approx(fit.solution.parameters, rel=0.05)
    missing = fit_model(swings(4, lambda q, v, a: 0.3 * np.tanh(v / 0.01)), BASE, {})
    assert final_solution(missing) == (missing.problem, missing.solution)


def test_gains_of_a_contact_are_not_corrected_for_smoothing(monkeypatch):
    model = Model("kelvin_voigt", (EFFECTS["stiffness"](), EFFECTS["damping"]()))
    fit = fit_model(session(4), model, {})
    monkeypatch.setattr(FitResult, "filters", (((5, 1),), ()))
    monkeypatch.setattr(fit_result, "fit_smoothing_bias", lambda *_: pytest.fail("it was corrected"))
    assert final_solution(fit)[0] is fit.whitened_problem


@pytest.mark.parametrize(("transition", "taken"), [(0.012, True), (0.3, False)])
def test_final_optimization_stays_near_the_model(found, transition, taken, monkeypatch):
    """A fit beside a badly known colour may end elsewhere: by a twentieth of the error and more."""
    _, fit = found
    there = {**fit.solution.parameters, "coulomb_friction.transition": transition}
    monkeypatch.setattr(
        fit_result, "optimize_inner", lambda problem, solution: solve_gains(problem, solution.model, there)
    )
    problem, solution = final_solution(fit)
    assert (solution.parameters["coulomb_friction.transition"] == transition) is taken
    assert problem is (fit.whitened_problem if taken else fit.problem)
    assert (solution is fit.solution) is not taken


def accelerated(error, *, run=None, uneven=False):
    """Swings whose acceleration is off by this share."""
    t = np.arange(0.0, 4.0, 2e-3)
    t = t + (1e-3 * np.random.default_rng(1).uniform(0, 1, len(t)) if uneven else 0.0)
    x, v, a = np.sin(3.0 * t), 3.0 * np.cos(3.0 * t), -9.0 * np.sin(3.0 * t)
    base = swings(1, runs=1).select(np.zeros(len(t), dtype=np.int64))
    run = np.zeros(len(t), dtype=np.int64) if run is None else run(t)
    return replace(base, time_s=t, position=x, velocity=v, acceleration=(1.0 + error) * a, run=run), a


@pytest.mark.parametrize("error", [0.0, 0.05, -0.3])
@pytest.mark.parametrize("how", [{}, {"uneven": True}, {"run": lambda t: (t > 2.0).astype(np.int64)}])
def test_positions_reveal_a_biased_acceleration(error, how):
    """On the average over 30 ms to either side, but for the ends of runs."""
    data, exact = accelerated(error, **how)
    told = inflate_acceleration_noise(data).acceleration
    inside = np.zeros(len(data), dtype=bool)
    for run in data.runs:
        inside[np.flatnonzero(data.run == run)[20:-20]] = True
    assert told[inside] == pytest.approx(exact[inside], abs=0.03)
    assert told[[0, 1, -2, -1]] == pytest.approx(data.acceleration[[0, 1, -2, -1]])
    assert inflate_acceleration_noise(data).position == pytest.approx(data.position)


@pytest.mark.parametrize("count", [1, 2, 6, 7])
def test_short_runs_are_left_unchanged(count):
    data, _ = accelerated(0.5)
    short = data.select(np.arange(0, 50 * count, 50))
    same = inflate_acceleration_noise(short).acceleration == short.acceleration
    assert same.all() == (count < 7)


@pytest.mark.parametrize("half", [28, 40])
def test_smoothing_window_of_a_joint_biases_no_gain(half):
    data = smoothed(swings(6), half)
    fit = fit_model(data, BASE, {}, within(data, half))
    assert fit.solution.parameters["pendulum.inertia"] > 1.04 * INERTIA
    found = {name: one.value for name, one in estimate_parameters(*final_solution(fit)).items()}
    truth = {"pendulum.inertia": INERTIA, "pendulum.gravity": WEIGHT, "viscous_friction.d": DAMPING}
    assert found == pytest.approx(truth, rel=0.02)
