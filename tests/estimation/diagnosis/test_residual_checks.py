"""Residual checks: objections to a model whose residual is unexplained, and plain noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from palpate.estimation.base_model import ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis import residual_checks
from palpate.estimation.diagnosis.bootstrap import BootstrapTest
from palpate.estimation.diagnosis.residual_checks import (
    ExcessVariance,
    _without_outliers,
    check_residuals,
    differing_parameter,
    exceeds_noise,
    find_rare_events,
)
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import FitProblem, solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.fit.measurement_noise import RunHeterogeneity, free_air_noise, run_heterogeneity
from palpate.estimation.fit.normal_equations import WHITE
from palpate.estimation.models import MODELS
from tests.estimation.presses import NOISE_N, colored_noise, kelvin_voigt, session
from tests.estimation.presses import channel as press_channel
from tests.estimation.searches import SWING
from tests.estimation.swings import NOISE_NM, read, swings

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def louder_with_load(seed):
    data = session(seed)
    noise = np.random.default_rng(seed).normal(0.0, 0.05, len(data)) * np.abs(data.effort)
    return replace(data, effort=data.effort + noise)


def coarsely_read(seed, step_m=3e-4):
    data = session(seed)
    return replace(data, position=step_m * np.round(data.position / step_m))


def derived_from_steps(seed):
    """The speed's error is slow where two encoders step, and damping makes a force of it."""
    data = session(seed)
    x, v = 0.02 * data.position, 0.02 * data.velocity
    noise = np.random.default_rng(seed).normal(0.0, 0.02, len(data))
    read = sum(share * step * np.round(share * x / step) for share, step in ((0.8, 4e-6), (0.6, 7e-6)))
    motion = differentiate(data.time_s, read, data.run)
    force = np.where(x > 0.0, np.maximum(15e3 * x + 4e3 * v, 0.0), 0.0) + noise
    return replace(
        data, position=read, velocity=motion.velocity, acceleration=motion.acceleration, effort=force
    )


NOISE = {
    "white": session,
    "slow": lambda seed: session(seed, correlation=0.9),
    "very slow": lambda seed: session(seed, correlation=0.97),
    "growing with the load": louder_with_load,
    "steps of the depth": coarsely_read,
    "a speed derived from steps": derived_from_steps,
}


def objection(data, fit=None):
    measurement, rng = identify_measurement_model(data), np.random.default_rng(0)
    return check_residuals(fit or fit_model(data, MODEL, {}), measurement, rng, complete=True)


def excess(data, fit=None):
    measurement = identify_measurement_model(data)
    return exceeds_noise(fit or fit_model(data, MODEL, {}), measurement, np.random.default_rng(0))


def humming(hum_n=0.4, runs=3):
    return session(2, lambda t, x, v, run: kelvin_voigt(x, v, hum_n * np.sin(2 * np.pi * 7.3 * t)), runs=runs)


def creaking(q, v, a, creak_nm, where=1.0):
    """A joint of a known inertia and friction that may creak, and its fit."""
    rng, t = np.random.default_rng(3), 0.005 * np.arange(len(q))
    creak = gaussian_filter1d(rng.standard_normal(len(t)), 20.0) * 8.0 * where
    effort = 0.05 * a + 0.5 * v + creak_nm * creak + 0.01 * rng.standard_normal(len(t))
    run = np.zeros(len(t), dtype=np.int64)
    data = ChannelData("joint_1", ChannelKind.REVOLUTE, t, q, v, a, effort, run, run - 1)
    return data, fit_model(data, MODELS["inertia"]().build(ModelContext(joint=0)), {})


@pytest.mark.parametrize("name", NOISE)
def test_noise_is_no_objection(name):
    assert [objection(NOISE[name](seed)) for seed in range(4)] == [None] * 4


@pytest.mark.parametrize("length", [None, 60])
def test_run_with_another_scale_is_detected_next_to_a_short_run(length):
    def scaled(t, x, v, run):
        return kelvin_voigt(x, v) * np.where(run == 2, 1.2, 1.0)

    data = session(6, scaled, runs=4)
    if length:
        last = data.run == data.runs[-1]
        data = data.select(~last | (np.cumsum(last) <= length))
    assert "run 2 has an error of" in objection(data).reason
    fitted = fit_model(data, MODEL, {})
    found = run_heterogeneity(fitted.problem.blocked, fitted.solution)
    assert found.run == 2
    assert found.run_alone < 1.2 * NOISE_N < found.run_predicted


def test_report_states_a_per_run_oscillation_and_the_remaining_error():
    data, size_n = session(7), 0.05
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, int(data.run.max()) + 1)
    swung = data.effort + size_n * np.sin(2.0 * np.pi * 7.0 * data.time_s + phase[data.run])
    found = objection(replace(data, effort=np.where(data.effort > 5 * NOISE_N, swung, data.effort)))
    frequency_hz, told_n = (float(found.reason.split(word)[0].split()[-1]) for word in (" Hz", " N rms,"))
    assert frequency_hz == pytest.approx(7.0, rel=0.02)
    assert told_n == pytest.approx(size_n / np.sqrt(2.0), rel=0.15)
    assert found.depends_on == "time"


def contact(depth, force, run=None):
    """A channel with a sample each 5 ms, which is a block."""
    t, nothing = np.arange(len(depth)) * 0.005, np.zeros(len(depth))
    run = np.zeros(len(depth), dtype=np.int64) if run is None else run
    depth, force = np.asarray(depth, dtype=float), np.asarray(force, dtype=float)
    return ChannelData("c", ChannelKind.CONTACT, t, depth, nothing, nothing, force, run, np.full(len(t), -1))


WAVE = np.tile([1.0, -1.0], 200)


@pytest.mark.parametrize(
    ("before", "zero", "noise", "told"),
    [
        (60, 0.0, 0.1, 0.1),
        (60, 3.0, 0.1, 0.1),  # about the mean of that run
        (56, 0.0, 0.1, 0.1),  # of nine tenths, fifty are enough
        (54, 0.0, 0.1, None),
        (400, 0.0, 0.1, 0.1),  # nothing was touched
        (0, 0.0, 0.1, None),
    ],
)
def test_free_air_noise_is_that_before_the_first_touch(before, zero, noise, told):
    at = np.arange(400)
    depth = np.where((at < before) | (at > 390), -0.01, 0.01)
    force = zero + noise * WAVE + np.where((at >= 0.9 * before) & (before < 400), 50.0, 0.0)
    found = free_air_noise(contact(depth, force))
    assert found is None if told is None else found == pytest.approx(told)
    assert free_air_noise(swings(1)) is None


def test_short_stretches_of_free_air_in_several_runs_show_the_noise_together():
    run, at = np.repeat(np.arange(4), 100), np.tile(np.arange(100), 4)
    depth = np.where(at < 30, -0.01, 0.01)
    force = 0.1 * WAVE + np.where(at >= 30, 50.0, 0.0) + run
    assert free_air_noise(contact(depth, force, run)) == pytest.approx(0.1, rel=2e-3)
    assert free_air_noise(contact(depth[:100], force[:100])) is None


def test_runs_with_their_own_zero_have_one_free_air_noise():
    run = np.repeat([0, 1, 2], [200, 150, 50])
    force = np.array([0.1, 0.3, 9.0])[run] * WAVE + np.array([0.0, 5.0, 0.0])[run]
    depth = np.where(run < 2, -0.01, 0.01)
    expected = np.sqrt((180 * 0.1**2 + 135 * 0.3**2) / 315)
    assert free_air_noise(contact(depth, force, run)) == pytest.approx(expected, rel=1e-3)


def of_runs(gains, lengths, noise=0.1):
    """A spring of another stiffness in each run, and the fit to all; with a block a sample."""
    run = np.repeat(np.arange(len(gains)), lengths)
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.0, 1.0, len(run))
    data = contact(depth, np.array(gains)[run] * depth + noise * rng.normal(size=len(run)), run)
    blocked = BlockedData(data, np.arange(len(run))[:, None], run, run, np.ones(len(run), dtype=bool))
    return blocked, solve_gains(FitProblem(blocked, WHITE), MODEL.without("damping"), {})


def test_each_run_is_compared_with_the_others_and_itself():
    blocked, solution = of_runs([10.0, 10.0, 12.0, 10.0], 200)
    data, found = blocked.data, run_heterogeneity(blocked, solution)
    predicted, alone = np.empty(800), np.empty(800)
    for run in range(4):
        mine = data.run == run
        x, y = data.position, data.effort
        gain = np.sum((x * y)[~mine]) / np.sum((x * x)[~mine])
        predicted[mine] = y[mine] - gain * x[mine]
        design = np.column_stack([x[mine], np.ones(200)])  # a run may have a zero of its own
        left = y[mine] - design @ np.linalg.lstsq(design, y[mine], rcond=None)[0]
        alone[mine] = left * np.sqrt(200 / 198)

    def size(error):
        return np.sqrt(np.mean(error**2))

    assert found.run == 2
    assert (found.predicted, found.alone) == pytest.approx((size(predicted), size(alone)), rel=1e-6)
    mine = data.run == 2
    assert (found.run_predicted, found.run_alone) == pytest.approx(
        (size(predicted[mine]), size(alone[mine])), rel=1e-6
    )
    assert found.own_residual == pytest.approx(alone * np.sqrt(198 / 200), abs=1e-6)
    held = replace(blocked, data=replace(data, effort=1.0 * data.run))  # each zero fits a constant
    assert run_heterogeneity(held, solve_gains(FitProblem(held, WHITE), solution.model, {})) is None


def test_noise_of_short_runs_has_as_much_variance_in_what_their_fits_removed():
    blocked, solution = of_runs([10.0, 10.0, 10.0], 12)
    found, rng = run_heterogeneity(blocked, solution, least=0.0), np.random.default_rng(2)
    noise = np.array([found.noise(rng) for _ in range(2000)])
    removed = np.column_stack([blocked.data.position, np.ones(36)])
    for rows in (blocked.run == run for run in range(3)):
        basis = np.linalg.qr(removed[rows])[0]
        variance = np.sum(found.own_residual[rows] ** 2) / 10
        assert np.var(noise[:, rows] @ basis, axis=0) == pytest.approx([variance, variance], rel=0.1)


@pytest.mark.parametrize(
    ("gains", "lengths", "disagree"),
    [
        ([10.0, 10.0, 10.0], 200, False),
        ([10.0, 11.2, 10.0], 200, True),
        ([10.0, 10.2, 10.0], 200, False),  # less than a quarter more than by themselves
        ([10.0, 10.0, 11.5], [200, 200, 3], False),  # too short to be fitted by itself
        ([10.0, 10.0, 11.5], [200, 200, 40], True),
        ([10.0, 13.0], 200, True),
        ([10.0, 13.0], [200, 3], False),  # a single run is left
    ],
)
def test_runs_disagree_where_separate_fits_leave_clearly_less(gains, lengths, disagree):
    blocked, solution = of_runs(gains, lengths, noise=0.3)
    assert (run_heterogeneity(blocked, solution) is not None) is disagree


@pytest.mark.parametrize(
    ("stiffness", "damping", "told"),
    [
        ([800.0, 800.0, 800.0], [20.0, 20.0, 20.0], None),
        ([800.0, 800.0, 800.0], [20.0, 50.0, 35.0], ("damping.c", 20.0, 50.0, "N s/m")),
        ([800.0, 1000.0, 900.0], [20.0, 20.0, 20.0], ("stiffness.k", 800.0, 1000.0, "N/m")),
        ([800.0, 1000.0, 900.0], [20.0, 50.0, 35.0], None),  # both differ
    ],
)
def test_parameter_that_differs_between_runs_is_named_with_its_range(stiffness, damping, told):
    def law(t, x, v, run):
        force = np.array(stiffness)[run] * x + np.array(damping)[run] * v
        return np.where(x > 0.0, np.maximum(force, 0.0), 0.0)

    named = differing_parameter(fit_model(session(6, law, runs=3), MODEL, {}))
    if told is None:
        assert named is None
    else:
        name, least, _, largest, unit = named.replace("(", "").removesuffix(")").split(maxsplit=4)
        assert (name, unit) == (told[0], told[3])
        assert (float(least), float(largest)) == pytest.approx(told[1:3], rel=0.05)


@pytest.mark.parametrize("cause", ["surface", "cubic term"])
def test_cause_outside_the_model_is_attributed_to_no_parameter(cause):
    def law(t, x, v, run):
        if cause == "surface":
            return kelvin_voigt(x - np.array([0.0, 2e-3, 1e-3])[run], v)
        return kelvin_voigt(x, v, np.array([0.0, 4e6, 2e6])[run] * np.maximum(x, 0.0) ** 3)

    assert differing_parameter(fit_model(session(6, law, runs=3), MODEL, {})) is None


@pytest.mark.parametrize(("memory", "chosen", "share"), [(0.0, 1.0, 0.0), (0.8, 1.0, 0.8), (0.8, 0.5, 0.8)])
def test_covariance_of_adjacent_blocks_is_estimated(memory, chosen, share):
    rng, noise = np.random.default_rng(1), np.zeros(20_000)
    for i in range(1, len(noise)):
        noise[i] = memory * noise[i - 1] + rng.normal()
    some = np.arange(len(noise)) % 100 < 100 * chosen
    found = residual_checks._shared_by_neighbors(noise, np.zeros(len(noise), dtype=int), some)
    assert found**2 / np.var(noise) == pytest.approx(share, abs=0.05)


def test_noise_is_about_the_mean_of_each_run_and_between_its_neighbors():
    noise, every = np.ones(50), np.ones(50, dtype=bool)
    shared = residual_checks._shared_by_neighbors
    assert shared(noise, np.arange(50), every) == 0.0
    assert shared(noise, np.zeros(50), np.arange(50) % 2 == 0) == 0.0
    assert shared(-noise, np.zeros(50), every) == 1.0
    assert shared(noise, np.zeros(50), np.arange(50) < 21) == 1.0
    assert shared(noise, np.zeros(50), np.arange(50) < 20) == 0.0  # too few pairs
    residual, run = np.array([1.0, 3.0, 99.0, 10.0, 14.0]), np.array([0, 0, 0, 1, 1])
    found = residual_checks._about_means(residual, run, residual < 50.0)
    assert found.tolist() == [-1.0, 1.0, -2.0, 2.0]


def test_residual_in_contact_is_compared_with_free_air():
    hum = humming()
    fit = fit_model(hum, MODEL, {})
    found = excess(hum, fit)
    assert found.frequency_hz == pytest.approx(7.3, abs=0.05)
    assert found.acting == pytest.approx(0.4 / np.sqrt(2.0), rel=0.15)
    block = fit.problem.blocked.rows.shape[1]
    assert found.expected == pytest.approx(NOISE_N / np.sqrt(block), rel=0.3)
    assert f"{found.acting:.3g} N, is {found.acting / found.expected:.0f} times" in objection(hum, fit).reason
    assert excess(session(2)) is None


@pytest.mark.parametrize("reading_n", [0.0, 0.1])
def test_sensor_that_reads_the_same_in_free_air_does_not_show_its_noise_there(reading_n):
    hum = humming()
    silent = replace(hum, effort=np.where(hum.engaged, hum.effort, reading_n))
    found = excess(silent, fit_model(silent, MODEL, {}))
    assert found.reference == "of neighboring readings"
    assert found.expected > 0.0


def test_rounded_readings_that_a_model_reproduces_after_contact_are_no_excess():
    step_n = 1.0
    data = presses_with_long_air(white, before_s=0.3, after_s=0.3)
    data = replace(data, effort=step_n * np.round(data.effort / step_n))
    rounded = MODEL.with_effect(EFFECTS["quantisation"]())
    fit = fit_model(data, rounded, {"quantisation.step": step_n, "quantisation.noise": 0.05 * step_n})
    assert excess(data, fit) is None


@pytest.mark.parametrize(("pull_n", "is_noise"), [(0.0, True), (0.4, False)])
def test_pull_after_contact_is_compared_with_the_air_before_it(pull_n, is_noise):
    def adhesive(t, x, v, run):
        pulls = (x < 0.0) & (x > -3e-3) & (v < 0.0)  # a neck that breaks on the way out
        return kelvin_voigt(x, v) - pull_n * pulls

    found = excess(session(2, adhesive))
    assert (found is None) is is_noise
    assert is_noise or found.where == "after contact"


def test_blocks_at_run_starts_do_not_hide_the_noise_in_free_air():
    """Blocks in which a sensor may settle are not used; the noise of their readings is known all the same."""
    hum = humming()
    fit = fit_model(hum, MODEL, {})
    blocked = fit.problem.blocked
    only = replace(blocked, trusted=blocked.trusted & hum.engaged[blocked.rows].any(axis=1))
    found = excess(hum, replace(fit, problem=replace(fit.problem, blocked=only)))
    assert found.reference == "in free air"
    assert found.expected == pytest.approx(NOISE_N / np.sqrt(blocked.rows.shape[1]), rel=0.3)


def presses_with_long_air(added, pulls=lambda x, v: 0.0 * x, before_s=0.5, after_s=3.0):
    """Presses with little air before them and much after; `added(time in the run, run)` is noise."""
    dt, parts = 1.0 / 500.0, []
    for number in range(4):
        t = np.arange(0.0, before_s + 1.0 + after_s, dt)
        x = gaussian_filter1d(0.014 * np.sin(np.pi * np.clip(t - before_s, 0.0, 1.0)) - 0.004, 8.0)
        v = np.gradient(x, dt)
        parts.append((t + 10.0 * number, x, v, kelvin_voigt(x, v) + pulls(x, v) + added(t, number)))
    t, x, v, force = (np.concatenate(column) for column in zip(*parts, strict=True))
    return press_channel(force, t, x, v, np.repeat(np.arange(4), len(parts[0][0])))


def white(t, number):
    return np.random.default_rng(number).normal(0.0, NOISE_N, len(t))


@pytest.mark.parametrize(
    ("added", "pulls", "is_noise"),
    [
        (lambda t, n: white(t, n) + np.cumsum(0.2 * white(t, n + 9)), lambda x, v: 0.0 * x, True),
        (lambda t, n: white(t, n) + 0.1 * t, lambda x, v: 0.0 * x, True),
        (lambda t, n: white(t, n) + 0.5 * (t > 1.0), lambda x, v: 0.0 * x, True),
        (white, lambda x, v: -0.8 * ((x < 0.0) & (x > -0.003) & (v > 0.0)), True),
        (white, lambda x, v: -0.8 * ((x < 0.0) & (x > -0.003) & (v < 0.0)), False),
    ],
    ids=["random walk", "drift", "zero moved by a contact", "pull on the approach", "pull on the return"],
)
def test_adhesion_applies_only_to_a_pull_after_contact(added, pulls, is_noise):
    found = excess(presses_with_long_air(added, pulls))
    assert (found is None or found.where != "after contact") is is_noise


def test_late_force_is_no_reference_for_the_noise():
    def late_and_humming(t, number):
        late = 10.0 * ((t > 1.41) & (t < 1.43))  # the contact has just ended
        return white(t, number) + 0.2 * np.sin(2 * np.pi * 7.3 * t) * ((t > 0.6) & (t < 1.4)) + late

    data = presses_with_long_air(late_and_humming, after_s=0.5)
    fit = fit_model(data, MODEL, {})
    found = excess(data, fit)
    assert found.where == "in contact"
    assert found.expected == pytest.approx(NOISE_N / np.sqrt(fit.problem.blocked.rows.shape[1]), rel=0.3)


def test_steps_of_a_mostly_resting_effort_are_noise():
    run = np.repeat([0, 1], 50)
    steps = np.where(np.arange(100) % 5 == 0, 0.1, 0.0) + run  # most blocks show the median
    noise = _without_outliers(steps, run, np.ones(100, dtype=bool))
    assert np.count_nonzero(noise) == 20
    assert noise.max() == pytest.approx(0.1)


@pytest.mark.parametrize(("times", "is_noise"), [(2.2, True), (2.8, False)])
def test_excess_is_two_and_a_half_times_the_noise(times, is_noise):
    block_noise = NOISE_N / np.sqrt(2.0)  # blocks of two samples
    assert (excess(humming(times * block_noise * np.sqrt(2.0), runs=4)) is None) is is_noise


@pytest.mark.parametrize(("share", "is_noise"), [(0.7, False), (1.5, True)])
def test_hum_below_louder_contact_noise_is_no_objection(share, is_noise):
    """The noise on blocks is so many times the hum; draws know that of free air alone."""
    hum = humming()
    block = fit_model(hum, MODEL, {}).problem.blocked.rows.shape[1]
    loud_n = share * 0.4 / np.sqrt(2.0) * np.sqrt(block) * hum.engaged
    noise = np.random.default_rng(1).normal(size=len(hum))
    assert (excess(replace(hum, effort=hum.effort + loud_n * noise)) is None) is is_noise


@pytest.mark.parametrize(("creak_nm", "is_noise"), [(0.1, False), (0.0, True)])
def test_residual_in_motion_is_compared_with_rest(creak_nm, is_noise):
    speed = np.repeat(np.tile([0.0, 2.0 * np.pi], 6), 1000)  # every other five seconds
    q = np.sin(np.cumsum(0.005 * gaussian_filter1d(speed, 40.0)))
    v = np.gradient(q, 0.005)
    data, fit = creaking(q, v, np.gradient(v, 0.005), creak_nm, speed > 0.0)
    found, told = excess(data, fit), objection(data, fit)
    assert (found is None) is is_noise
    assert (told is None) is is_noise
    assert is_noise or (f"in motion, {found.acting:#.3g} N m" in told.reason and "at rest" in told.reason)


@pytest.mark.parametrize(
    ("shape", "is_noise"), [("bump", False), ("slow noise", True), ("filtered noise", True)]
)
def test_without_free_air_only_slow_residuals_are_no_noise(shape, is_noise):
    rng, count = np.random.default_rng(5), 3000
    t = 0.01 * np.arange(count)
    way, run = 1e-3 + 1e-4 * t, np.zeros(count, dtype=np.int64)
    added = {
        "bump": 0.5 * np.sin(2.0 * np.pi * t / 9.0),
        "slow noise": 20.0 * colored_noise(rng, count, 0.99),
        "filtered noise": 3.0 * gaussian_filter1d(rng.standard_normal(count), 8.0),
    }[shape]
    force = kelvin_voigt(way, 1e-4) + added
    assert (excess(press_channel(force, t, way, np.full(count, 1e-4), run)) is None) is is_noise


# The smallest is less than three times the white noise, beside which slower noise may be.
@pytest.mark.parametrize(("creak_nm", "is_noise"), [(0.1, False), (0.02, True), (0.0, True)])
def test_without_rest_the_residual_is_compared_with_neighboring_readings(creak_nm, is_noise):
    t = np.arange(0.0, 60.0, 0.005)
    q, v, a = 6.0 * t + np.sin(3.0 * t), 6.0 + 3.0 * np.cos(3.0 * t), -9.0 * np.sin(3.0 * t)
    told = objection(*creaking(q, v, a, creak_nm))
    assert (told is None) is is_noise
    assert is_noise or "times the noise of neighboring readings" in told.reason


APART = RunHeterogeneity(2, 1.0, 0.4, np.zeros(3), (), 2.0, 0.4)
EXCESS = ExcessVariance(1.0, 0.1, None, "in motion", "at rest")


@pytest.mark.parametrize(
    ("complete", "floor", "apart", "chance", "excess", "depends_on"),
    [
        (True, 0.1, None, False, None, None),
        (True, 0.1, APART, False, None, "run"),
        (True, 0.1, APART, True, None, None),  # draws disagree as much
        (True, 0.1, APART, True, EXCESS, "time"),
        (True, 0.1, None, False, EXCESS, "time"),
        (False, 0.1, None, False, EXCESS, None),  # a smooth law explains some of it: that is told
        (False, 0.8, APART, False, EXCESS, None),
        (False, 0.81, APART, False, EXCESS, "run"),  # runs by themselves leave less than half of its rest
    ],
)
def test_runs_are_checked_before_the_residual_in_contact(
    complete, floor, apart, chance, excess, depends_on, monkeypatch
):
    monkeypatch.setattr(residual_checks, "run_heterogeneity", lambda *_: apart)
    monkeypatch.setattr(residual_checks, "_is_heterogeneous", lambda *_: not chance)
    monkeypatch.setattr(residual_checks, "exceeds_noise", lambda *_: excess)
    for check in ("_oscillation", "_error_with_own_waves"):
        monkeypatch.setattr(residual_checks, check, lambda _: None)
    end = SimpleNamespace(
        data=swings(1), problem=SimpleNamespace(blocked=None), solution=None, floor=lambda: floor
    )
    found = check_residuals(end, None, None, complete=complete)
    assert (found and found.depends_on) == depends_on
    if depends_on == "run":
        assert found.reason.startswith("the runs do not follow one law: run 2 has an error of 2.00 N m when")
    if depends_on == "time":
        assert (
            "1.00 N m, is 10 times the noise at rest and does not look like noise; no signal" in found.reason
        )


@pytest.mark.parametrize(
    ("drawn", "no_chance"),
    [((1.0, 0.0), True), ((2.44, 1.0), True), ((2.46, 1.0), False), ((3.0, 9.0), False)],
)
def test_runs_of_one_law_disagree_by_chance_like_the_samples(drawn, no_chance, monkeypatch):
    """These do by 2.5; draws that agree count as none."""
    figures = iter(drawn * 20)

    def disagree(*_):
        figure = next(figures)
        return replace(APART, predicted=figure, alone=1.0) if figure else None

    monkeypatch.setattr(residual_checks, "run_heterogeneity", disagree)
    problem = SimpleNamespace(blocked=None)
    monkeypatch.setattr(residual_checks, "bootstrap_samples", lambda *_: iter([(problem, None)] * 40))
    end = SimpleNamespace(problem=SimpleNamespace(blocked=SimpleNamespace(reduce=lambda signal: signal)))
    assert residual_checks._is_heterogeneous(APART, end, None, None) is no_chance
    assert BootstrapTest(2.5, np.array(drawn)).is_significant is no_chance


@pytest.mark.parametrize(
    ("air", "share", "times", "told"),
    [
        *((None, share, 40.0, told) for share, told in ((0.36, True), (0.2, True), (0.199, False))),
        (None, 0.36, 39.9, False),
        (None, None, None, False),
        (0.99, 0.5, 100.0, True),
        (1.0, 0.5, 100.0, False),  # as much in free air: noise
        (2.0, 0.88, 100.0, False),
        (2.0, 0.89, 100.0, True),  # the error is three times what is left beside it
    ],
)
def test_dominant_oscillation_is_named_unless_it_is_noise(air, share, times, told, monkeypatch):
    found = share and (7.0, share, times)
    monkeypatch.setattr(residual_checks, "strongest_frequency", lambda *_: found)
    monkeypatch.setattr(residual_checks, "free_air_noise", lambda _: air)
    end = fit_model(session(7), MODEL, {})
    monkeypatch.setattr(type(end), "rmse", 1.0 + SMALL)
    swung = residual_checks._oscillation(end)
    assert (swung is not None) is told
    if told:
        assert f"7 Hz with {share**0.5 * end.rmse:#.3g} N" in swung.reason


@pytest.mark.parametrize(
    ("large", "noise", "is_bound", "told"),
    [
        (9.5, 2.3, True, True),
        (7.5, 2.3, True, False),  # the five hold 75 % of the squares
        (9.5, 1.0, False, False),  # the error is 2.3 times the measured noise
        (9.5, 0.9, False, True),
    ],
)
def test_few_large_errors_are_not_noise_unless_it_was_measured(large, noise, is_bound, told):
    """Of 100 samples, 95 have an error of 1 and five a larger one, 9.5 for 83 % of the squares."""
    residual = np.where(np.arange(100) % 20 == 7, large, 1.0)
    end = SimpleNamespace(
        solution=SimpleNamespace(residual=residual),
        problem=SimpleNamespace(used=np.ones(100, np.bool_)),
        rmse=float(np.sqrt(np.mean(residual**2))),
    )
    finding = find_rare_events(end, SimpleNamespace(value=noise, is_bound=is_bound))
    assert (finding is not None) is told
    if told:
        assert finding.reason.startswith("5 % of the samples hold 83 %")


@pytest.mark.parametrize(("ripple", "runs", "is_found"), [(10.0, 4, True), (0.9, 4, False), (10.0, 1, False)])
def test_ripple_with_a_phase_in_each_run_must_explain_much(ripple, runs, is_found):
    """In a single run, its phase differs from no other."""
    quiet = swings(2, lambda q, v, a: 0.0 * q, runs=runs)
    waves = ripple * NOISE_NM * np.sin(15.0 * quiet.position + 2.0 * quiet.run)
    end = fit_model(replace(quiet, effort=quiet.effort + waves), SWING, {})
    left = residual_checks._error_with_own_waves(end)
    assert left == (pytest.approx(NOISE_NM, rel=0.2) if is_found else None)
    if is_found:
        assert f"run, the error would be {left:.3g} N m; start each run" in objection(end.data, end).reason


def test_a_zero_of_each_run_is_no_ripple():
    quiet = swings(2, lambda q, v, a: 0.0 * q, runs=4)
    zeros = 10.0 * NOISE_NM * np.array([1.0, -1.0, 0.5, -0.5])
    end = fit_model(replace(quiet, effort=quiet.effort + zeros[quiet.run]), SWING, {})
    assert residual_checks._error_with_own_waves(end) is None


def fractional_noise(exponent, count=3000):
    """Noise whose differences grow by 2^exponent if their distance doubles; a random walk has 0.5."""
    spectrum, frequency = np.fft.rfft(np.random.default_rng(0).normal(size=count)), np.fft.rfftfreq(count)
    return np.fft.irfft(spectrum * np.append(0.0, frequency[1:] ** -(exponent + 0.5)), count)


SLOW = np.sin(np.arange(3000) / 100.0)
WHITE_NOISE = np.random.default_rng(0).normal(size=3000)


@pytest.mark.parametrize(
    ("residual", "motion", "low", "high"),
    [
        (SLOW + 0.1 * WHITE_NOISE, 0.0, 0.09, 0.11),
        (fractional_noise(0.9), 0.0, 0.0, np.inf),
        (fractional_noise(0.4), 0.0, None, None),
        (gaussian_filter1d(WHITE_NOISE, 16.0), 0.0, None, None),  # over a small part of the run only
        (gaussian_filter1d(WHITE_NOISE, 30.0), 0.0, 0.0, np.inf),
        (WHITE_NOISE[:52], 0.0, None, None),
        (WHITE_NOISE[:53], 0.0, None, None),
        # Readings that a window of the motion smoothed show their noise beyond it, if the motion matters.
        (SLOW + 0.3 * gaussian_filter1d(WHITE_NOISE, 4.0), 0.09, 0.0, 0.01),
        (SLOW + 0.3 * gaussian_filter1d(WHITE_NOISE, 4.0), 0.11, 0.08, 0.13),
    ],
)
def test_white_part_is_known_if_the_rest_grows_faster_than_noise(monkeypatch, residual, motion, low, high):
    size = motion * np.sqrt(np.mean(residual**2))
    monkeypatch.setattr(residual_checks, "fast_noise", lambda data: None)
    monkeypatch.setattr(residual_checks, "_motion_noise", lambda *_: size)
    blocked = SimpleNamespace(run=np.zeros(len(residual), dtype=int), rows=np.zeros((len(residual), 1)))
    filters = ((20, 1),) if motion else (), ()
    fit = SimpleNamespace(data=None, problem=SimpleNamespace(blocked=blocked), filters=filters)
    found = residual_checks._white_noise(fit, residual, None, None)
    assert found is None if low is None else low < found < high


def test_motion_noise_is_the_effort_of_position_errors():
    data, rng = session(4), np.random.default_rng(3)
    data = replace(data, position=data.position + rng.normal(0.0, 1e-4, len(data)))
    fit = fit_model(data, MODEL, {})
    found = residual_checks._motion_noise(fit, identify_measurement_model(data), rng)
    pressed = np.mean(fit.problem.blocked.reduce(1.0 * data.engaged)[fit.problem.used])
    in_contact = fit.solution.parameters["stiffness.k"] * 1e-4 / np.sqrt(fit.problem.blocked.rows.shape[1])
    assert found == pytest.approx(in_contact * np.sqrt(pressed), rel=0.15)


def test_noise_of_friction_that_grows_with_the_load_is_estimated(monkeypatch):
    """The load is derived in the fit, so a simulated motion does not have it by itself."""
    monkeypatch.setattr(residual_checks, "fast_noise", lambda data: None)
    data = read(
        swings(5, lambda q, v, a: 0.2 * np.abs(0.05 * a + 2.0 * np.sin(q)) * np.tanh(v / 0.02)), noise=1e-5
    )
    friction = EFFECTS["load_dependent_friction"]()
    fit = fit_model(data, SWING.with_effect(friction), {"load_dependent_friction.transition": 0.02})
    slow = 0.3 * np.sin(2.0 * np.pi * data.time_s)
    disturbed = fit_model(
        replace(data, effort=data.effort + slow), fit.solution.model, fit.solution.parameters
    )
    excess = exceeds_noise(disturbed, identify_measurement_model(data), np.random.default_rng(0))
    assert excess is not None
    assert excess.acting == pytest.approx(0.3 / np.sqrt(2.0), rel=0.3)
