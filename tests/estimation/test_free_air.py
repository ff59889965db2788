"""A sensor's zero, from readings before and after the contact; a drift must hold there too."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.budget.laws import BaseColumns, flexible_laws
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data_quality import quality_warnings
from palpate.estimation.diagnosis.candidates import applicable_effects
from palpate.estimation.diagnosis.forms import error_of_kinds
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.free_air import zero_in_free_air
from palpate.estimation.signals.motion import is_monotonic, is_one_pass
from tests.estimation.fits import MODEL
from tests.estimation.presses import NOISE_N, channel, kelvin_voigt, session
from tests.estimation.swings import swings

RATE = 0.05  # N/s


def drifting(t, x, v, run):
    return kelvin_voigt(x, v) + RATE * (t - t[0])


def creeping(t, x, v, run):
    """A spring that weakens with the time of the session: it looks like a drift wherever it is pressed."""
    return kelvin_voigt(x, v) - np.where(x > 0.004, RATE * (t - t[0]), 0.0)


def test_bias_and_drift_are_recovered_and_a_steady_zero_is_reported():
    found = zero_in_free_air(session(1, lambda t, x, v, run: 0.4 + drifting(t, x, v, run)))
    assert found.rate == pytest.approx(RATE, abs=4.0 * found.rate_std_err)
    assert found.noise == pytest.approx(NOISE_N, rel=0.1)
    assert not found.is_zero
    assert not found.is_steady
    found = zero_in_free_air(session(1))
    assert found.is_zero
    assert found.is_steady
    assert zero_in_free_air(swings(1)) is None
    data = session(1)
    assert zero_in_free_air(data.select(data.position > 0.002)) is None


@pytest.mark.parametrize("rate", [0.0, 60.0 * RATE])
def test_drag_of_a_liquid_is_no_drift(rate):
    """Readings after a contact are lower than before it, because the motion has turned round."""
    found = zero_in_free_air(
        session(1, lambda t, x, v, run: kelvin_voigt(x, v) + rate * (t - t[0]) + 20.0 * v)
    )
    assert found.rate == pytest.approx(rate, abs=4.0 * found.rate_std_err)
    assert found.is_steady is (rate == 0.0)


def test_drift_during_a_steady_approach_is_that_between_the_ends_of_the_runs():
    """Before the contact, time and position are equivalent; after it, there are few readings."""
    t, run = np.tile(np.arange(100) * 0.01, 2), np.repeat([0, 1], 100)
    x = 0.01 * (t - 0.5)
    time_s, x = t + 2.0 * run, np.where(t > 0.93, -0.001, x)
    effort = 1e3 * np.maximum(x, 0.0) + RATE * time_s + np.random.default_rng(0).normal(0.0, 1e-4, len(t))
    found = zero_in_free_air(channel(effort, time_s, x, np.gradient(x, 0.01), run, 0.0 * x))
    assert found.rate == pytest.approx(RATE, rel=0.05)


def test_zero_of_runs_that_begin_in_contact_comes_from_readings_after_it():
    data = session(1, lambda t, x, v, run: 0.4 + kelvin_voigt(x, v))
    begun = np.concatenate([np.maximum.accumulate(data.engaged[data.run == run]) for run in data.runs])
    found = zero_in_free_air(data.select(begun))
    assert found.bias == pytest.approx(0.4, abs=0.2 * NOISE_N)
    assert found.noise == pytest.approx(NOISE_N, rel=0.1)
    assert found.rate is None


@pytest.mark.parametrize(("law", "misnamed"), [(drifting, False), (creeping, True)])
def test_drift_without_readings_in_free_air_is_none(law, misnamed):
    data = session(1, law)
    drift = EFFECTS["drift"]()
    fit = fit_model(data, MODEL.with_effect(drift), {})
    assert abs(fit.solution.parameters["drift.rate"]) > 0.3 * RATE
    assert drift.is_misnamed(data, fit.solution.parameters, dict, NOISE_N) is misnamed


@pytest.mark.parametrize(("bias_n", "there"), [(0.0, False), (0.3, True)])
def test_sensor_statics_law_has_a_bias_where_free_air_allows_one(bias_n, there):
    data = session(2)
    laws = error_of_kinds(fit_model(replace(data, effort=data.effort + bias_n), MODEL, {})).laws
    (statics,) = (law for law in laws if law.kinds == {Kind.SENSOR_STATICS})
    assert bool(np.any(np.all(statics.columns == 1.0, axis=0))) is there


@pytest.mark.parametrize("scaled", [False, True])
def test_sensor_statics_law_has_a_gain_unless_the_base_model_scales(scaled):
    fit = fit_model(session(2), MODEL, {})
    blocked = fit.problem.blocked
    effort = blocked.effort - fit.solution.residual
    column = (effort if scaled else np.sin(blocked.time_s))[:, None]
    base = BaseColumns(column, np.ones(1), np.zeros(1), np.ones(1, bool))
    slope = np.zeros(len(effort))
    laws = flexible_laws(
        blocked, base, effort, fit.solution.residual, fit.problem.used, slope=slope, has_weight=False
    )
    (statics,) = (law for law in laws if law.kinds == {Kind.SENSOR_STATICS})
    assert bool(np.any(np.all(effort == statics.columns.T, axis=1))) is not scaled


def test_drift_is_refused_for_monotonic_motion():
    data = session(1)
    ramp = replace(data, position=np.linspace(-0.01, 0.01, len(data)))
    assert [EFFECTS["drift"]().applies_to(one) for one in (data, ramp)] == [True, False]
    jitter = 1e-7 * np.random.default_rng(0).standard_normal(len(data))
    assert is_monotonic(ramp.position, data.run)
    assert is_monotonic(jitter - ramp.position, data.run)
    assert not is_monotonic(data.position, data.run)


def pulled(parts):
    """A spring's channel with all readings of one run after the other, given their times and depths."""
    time_s, x = (np.concatenate(values) for values in zip(*parts, strict=True))
    run = np.repeat(np.arange(len(parts)), [len(t) for t, _ in parts])
    zeros = np.zeros(len(x))
    velocity = np.gradient(x, time_s)
    return ChannelData("contact", ChannelKind.CONTACT, time_s, x, velocity, zeros, 1e3 * x, run, run * 0 - 1)


def tried_on(data, *names):
    return {effect.name for effect in applicable_effects(data, MODEL, [EFFECTS[name]() for name in names])}


@pytest.mark.parametrize(("hold_s", "hides_memory"), [(0.0, True), (5.0, False)])
def test_memory_of_a_single_run_without_a_hold_is_a_law_of_the_position(hold_s, hides_memory):
    t = np.arange(0.0, 20.0, 0.05)
    x = 1e-4 * np.where(t < 10.0, t, np.maximum(t - hold_s, 10.0)) ** 2  # the speed grows
    assert is_one_pass(t, x, np.zeros(len(t), dtype=int)) is hides_memory


@pytest.mark.parametrize(
    ("runs", "seen"),
    [
        ([(speed, 0.0, 0.0) for speed in (1e-3, 1.01e-3, 0.99e-3)], False),
        ([(1e-3, 0.0, 0.0), (1.1e-3, 0.0, 0.0)], False),
        ([(1e-3, 0.0, 0.0), (2e-3, 0.0, 0.0)], True),  # another speed
        ([(1e-3, 0.0, 0.0), (-1e-3, 0.0, 0.0)], True),  # another way
        ([(1e-3, 3.0, 0.0)] * 2, True),  # a hold
        ([(1e-3, 0.0, 2.0)] * 2, True),  # a return
    ],
)
def test_history_needs_a_hold_a_return_or_another_speed(runs, seen):
    """Runs of 10 s: speed [m/s], hold at the end [s], return [s]."""
    parts = []
    for number, (speed, hold_s, back_s) in enumerate(runs):
        t = np.arange(0.0, 10.0 + hold_s + back_s, 0.05)
        x = speed * np.minimum(t, 10.0) - speed * np.clip(t - 10.0 - hold_s, 0.0, None)
        parts.append((t + 100.0 * number, x))
    data = pulled(parts)
    assert is_one_pass(data.time_s, data.position, data.run) is not seen
    data = replace(data, velocity=data.acceleration)
    names = ("stress_relaxation", "power_law_stiffness", "hysteresis", "dry_friction", "hunt_crossley")
    tried = tried_on(data, *names, "deadband")
    assert ("stress_relaxation" in tried) is ("hunt_crossley" in tried) is ("deadband" in tried) is seen
    assert "power_law_stiffness" in tried
    returns = any(back_s for _, _, back_s in runs)
    assert ("hysteresis" in tried) is returns
    assert ("dry_friction" in tried) is (returns or min(speed for speed, _, _ in runs) < 0.0)
    warned = any("all runs go one way at one speed" in warning for warning in quality_warnings(data))
    assert warned is not seen


@pytest.mark.parametrize(("speeds", "seen"), [((1e-3, 1.1e-3), False), ((1e-3, 3e-3), True)])
def test_rate_dependence_needs_two_speeds(speeds, seen):
    """Triangles of 5 mm, so that friction is seen at any speed."""
    parts = []
    for number, speed in enumerate(speeds):
        t = np.arange(0.0, 10e-3 / speed, 0.01)
        parts.append((t + 100.0 * number, 5e-3 - np.abs(speed * t - 5e-3)))
    data = pulled(parts)
    tried = tried_on(data, "hunt_crossley", "dry_friction")
    assert tried == ({"hunt_crossley", "dry_friction"} if seen else {"dry_friction"})
    assert any("all motion is at one speed" in warning for warning in quality_warnings(data)) is not seen


def pressed(runs, depth_m=0.0):
    """Presses, from free air on, or always in contact, so that no reading tells the sensor's zero."""
    data = session(1)
    data = data.select(data.run < runs)
    return replace(data, position=data.position + depth_m)


def separately_timed(data):
    start_s = np.array([data.time_s[data.run == run][0] for run in data.runs])
    return replace(data, time_s=data.time_s - start_s[data.run])


@pytest.mark.parametrize(
    ("data", "seen"),
    [
        (pressed(1, 0.01), False),
        (pressed(2, 0.01), True),
        (separately_timed(pressed(2, 0.01)), False),
        (pressed(1), True),
        (separately_timed(pressed(2)), True),
    ],
    ids=["held", "two runs", "two clocks", "free air", "two clocks and free air"],
)
def test_drift_needs_a_second_run_on_its_clock_or_free_air_at_both_ends(data, seen):
    """Within one contact, slow relaxation changes the effort in the same way."""
    assert tried_on(data, "drift") == ({"drift"} if seen else set())


def test_two_sided_element_has_no_adhesion():
    data = session(1)
    touching = np.ones(len(data), dtype=np.bool_)
    assert EFFECTS["adhesion"]().applies_to(data)
    assert not EFFECTS["adhesion"]().applies_to(replace(data, touching=touching))


@pytest.mark.parametrize(("returning", "runs", "monotonic"), [(1, 1, False), (1, 2, True), (2, 30, False)])
def test_motion_returns_only_if_a_second_run_confirms_it(returning, runs, monotonic):
    there = np.linspace(0.0, 1.0, 50)
    back = 1.0 - np.abs(np.linspace(-1.0, 1.0, 50))
    position = np.concatenate([back] * returning + [there] * (runs - returning))
    assert is_monotonic(position, np.repeat(np.arange(runs), 50)) is monotonic
