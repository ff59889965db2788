"""Hidden sensor effects act on their own channel alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from palpate.sim_backend.world import World
from tests.sim_backend.hidden_parts import QUIET, hidden, hidden_slider, let_go, quiet_scenario
from tests.sim_backend.parts import make_world, scenario, shipped_arm, slider

TICK_S = 1e-3
T = TICK_S * np.arange(2000)
SWING = 3.0 * np.sin(2 * np.pi * 1.5 * T) + 0.4 * np.sin(2 * np.pi * 9.0 * T)
signals = st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=30)


def through(signal, effect, **parameters):
    """The signal, a sample each millisecond, as the sensor shows it."""
    transducer = hidden(effect, channel="contact", **parameters).transducer()
    return np.array([transducer(time_s, value) for time_s, value in zip(T, signal, strict=False)])


def test_bias_shifts_and_a_drift_grows_from_the_first_sample_on():
    assert through(SWING, "bias", bias=-0.7) == pytest.approx(SWING - 0.7)
    transducer = hidden("drift", channel="contact", rate_1_s=0.5).transducer()
    assert [transducer(100.0 + t, 2.0) for t in (0.0, 1.0, 4.0)] == pytest.approx([2.0, 2.5, 4.0])


def test_lag_follows_its_equation_and_a_ramp_by_rate_times_time():
    def follow(time_s, output):
        return (np.interp(time_s, T, SWING) - output) / 0.02

    expected = solve_ivp(follow, (0, T[-1]), [SWING[0]], t_eval=T, max_step=TICK_S / 2, rtol=1e-8).y[0]
    assert through(SWING, "lag", time_s=0.02) == pytest.approx(expected, abs=1e-4)
    assert through(2.0 * T, "lag", time_s=0.05)[-1] == pytest.approx(2.0 * (T[-1] - 0.05))


@pytest.mark.parametrize("delay_s", [0.0, 0.0004, 0.001, 0.0123])
def test_delay_shows_the_past_under_the_current_time(delay_s):
    expected = np.interp(T - delay_s, T, SWING)
    assert through(SWING, "delay", delay_s=delay_s) == pytest.approx(expected, abs=1e-12)


def test_saturation_clips_and_a_deadband_removes_small_values():
    shown = through(SWING, "saturation", limit=2.0)
    assert (shown.min(), shown.max()) == (-2.0, 2.0)
    assert np.array_equal(shown[np.abs(SWING) < 2], SWING[np.abs(SWING) < 2])
    shown = through(SWING, "deadband", half_width=0.5)
    assert not shown[np.abs(SWING) < 0.5].any()
    assert shown.max() == pytest.approx(SWING.max() - 0.5)
    assert shown.min() == pytest.approx(SWING.min() + 0.5)
    assert np.abs(np.diff(shown)).max() <= np.abs(np.diff(SWING)).max()


def test_hysteresis_reads_less_while_rising_and_more_while_falling():
    slow = 3.0 * np.sin(2 * np.pi * T)
    shown = through(slow, "hysteresis", half_width=0.3)
    rising, settled = np.gradient(slow) > 0, np.abs(slow) < 2
    assert (slow - shown)[rising & settled & (T > 0.5)] == pytest.approx(0.3)
    assert (slow - shown)[~rising & settled] == pytest.approx(-0.3)
    sparse = through(slow[::3], "hysteresis", half_width=0.3)
    assert shown[::3] == pytest.approx(sparse, abs=1e-3)  # it knows no time


@given(signals, st.floats(0.0, 5.0))
def test_hysteresis_never_exceeds_its_half_width(signal, half_width):
    shown = through(signal, "hysteresis", half_width=half_width)
    assert np.abs(shown - signal).max() <= half_width + 1e-12


@given(signals, st.floats(1e-3, 5.0))
def test_coarse_converter_shows_the_nearest_step(signal, step):
    shown = through(signal, "quantisation", step=step)
    assert np.abs(shown - signal).max() <= 0.5 * step + 1e-9
    assert shown / step == pytest.approx(np.round(shown / step), abs=1e-6)


def test_mechanical_faults_precede_noise_and_electrical_faults_follow():
    noisy = {**QUIET, "force": {"noise_std_n": 0.5, "resolution_n": 0.0}}

    def force_samples(entry):
        settings = scenario(rate_hz=1000.0, **noisy).with_hidden([entry])
        world = make_world(slider(5.0), settings)
        world.held = True
        values = []
        for tick in range(400):
            world.advance_to(tick * TICK_S)
            values.append(world.force_sensor.read(world.time_s).value[0])
        world.close()
        return np.array(values)

    mechanical = [
        hidden("lag", channel="contact", time_s=0.05),
        hidden("delay", channel="contact", delay_s=0.05),
        hidden("deadband", channel="contact", half_width=1.0),
        hidden("hysteresis", channel="contact", half_width=1.0),
    ]
    for entry in mechanical:
        noise = force_samples(entry)
        assert noise.std() == pytest.approx(0.5, rel=0.15)
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.15
    cut = force_samples(hidden("saturation", channel="contact", limit=0.2))
    assert (np.abs(cut) == 0.2).mean() > 0.5


@pytest.mark.parametrize(
    ("channel", "sensor", "index"),
    [("contact", "force", 0), ("joint_2", "torque", 1), ("encoder_3", "encoder", 2)],
)
def test_effect_reaches_its_own_channel_only(channel, sensor, index):
    arm = shipped_arm("follower")
    worlds = [
        World(arm, quiet_scenario(*entries)) for entries in ([], [hidden("bias", channel=channel, bias=0.25)])
    ]
    found = {}
    for name in ("force", "torque", "encoder"):
        plain, biased = (getattr(w, {"encoder": name}.get(name, f"{name}_sensor")).read(0.0) for w in worlds)
        found[name] = np.subtract(biased.value, plain.value)
    assert found[sensor][index] == pytest.approx(0.25)
    found[sensor][index] = 0.0
    assert not np.concatenate(list(found.values())).any()
    assert np.array_equal(*(world.truth().joint_position_rad for world in worlds))


def test_velocity_by_difference_inherits_encoder_effects():
    world = hidden_slider(hidden("lag", channel="encoder_1", time_s=0.1), gravity=0.0)
    let_go(world, 0.03, speed=1.0)
    measured = world.encoder.read(world.time_s).value[1]
    assert 0.1 < measured < 0.35  # 1 - exp(-0.03 / 0.1) = 0.26, and the low-pass behind it
