"""An effort with few values is either a command that really steps or a continuous effort that is rounded."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data_quality import reject_reason
from palpate.estimation.diagnosis import acceptance
from palpate.estimation.diagnosis.candidates import applicable_effects, effect_library
from palpate.estimation.diagnosis.diagnose import diagnose_channel
from palpate.estimation.diagnosis.forms import error_of_kinds
from palpate.estimation.diagnosis.result import Verdict
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.blocks import block_average, decimate
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.motion import is_stepwise_command
from tests.estimation.searches import ROTOR, searched

RATE_HZ, FINE = 200.0, 20  # samples per second, and integration steps per sample
INERTIA, DAMPING, COULOMB = 0.02, 0.05, 0.25
RNG_SEED = 3
# Friction, what is confused with it, and what could explain an error by its sensor or by its runs instead.
TRIED = ("coulomb_friction", "quadratic_friction", "bias", "saturation", "delay", "run_offset", "run_gain")
SOME = tuple(EFFECTS[name]() for name in TRIED)


@cache
def motor(torque_levels, switched_every_s, runs=3, coulomb=COULOMB, speed_noise=0.02):
    """A motor under torques that switch between levels, integrated from rest with Coulomb friction."""
    rng = np.random.default_rng(RNG_SEED)
    count, step_s = 1200, 1.0 / (RATE_HZ * FINE)
    time_s, position, velocity, acceleration, effort = (np.zeros((runs, count)) for _ in range(5))
    for run in range(runs):
        angle, speed = 0.0, 0.0
        for sample in range(count):
            at_s = sample / RATE_HZ
            torque = torque_levels[int(at_s / switched_every_s + run) % len(torque_levels)]
            for _ in range(FINE):
                friction = coulomb * math.tanh(speed / 0.01) + DAMPING * speed
                rate = (torque - friction) / INERTIA
                angle, speed = angle + step_s * speed, speed + step_s * rate
            time_s[run, sample], effort[run, sample] = at_s, torque
            position[run, sample], velocity[run, sample], acceleration[run, sample] = angle, speed, rate
    velocity += rng.normal(0.0, speed_noise, velocity.shape)
    number = np.repeat(np.arange(runs), count)
    signals = (each.ravel() for each in (time_s, position, velocity, acceleration, effort))
    return ChannelData("motor", ChannelKind.REVOLUTE, *signals, number, np.full(runs * count, -1))


def test_a_stepwise_command_is_diagnosed_and_no_sensor_is_blamed():
    data = motor((0.8, -0.8), 0.75, runs=2)
    assert len(np.unique(data.effort)) == 2
    assert reject_reason(data) is None
    library = effect_library()
    model = ROTOR
    assert all(e.kind is not Kind.SENSOR_STATICS for e in applicable_effects(data, model, library))
    result = diagnose_channel(data, model, SOME, np.random.default_rng(0))
    assert result.verdict is Verdict.MISSING
    assert result.accepted[0].effect in {"coulomb_friction", *result.accepted[0].confused_with}
    assert max(result.budget, key=lambda entry: entry.share or 0.0).kind is Kind.FRICTION


@pytest.mark.parametrize("levels", [(0.5, 1.0), (0.0, 0.4, 0.9, 0.6)])
def test_real_steps_are_recognized(levels):
    data = motor(levels, 0.9, runs=2, coulomb=0.1)
    assert is_stepwise_command(data)


def test_levels_on_no_common_grid_are_a_command_that_the_motion_may_follow_late():
    data = motor((0.0, 0.4, 0.9), 0.9, runs=2, coulomb=0.1)
    late = replace(data, effort=np.roll(data.effort, -20))
    assert is_stepwise_command(late)
    even = {0.0: 0.0, 0.4: 0.45, 0.9: 0.9}  # as a sensor rounds
    assert not is_stepwise_command(replace(late, effort=np.vectorize(even.get)(late.effort)))


def test_an_averaged_command_stays_a_command():
    data = motor((0.0, 0.4, 0.9), 0.935, runs=2, coulomb=0.1)
    averaged = decimate(block_average(data))
    assert len(averaged) < len(data)
    assert len(np.unique(averaged.effort)) > 3
    assert is_stepwise_command(averaged)
    assert is_stepwise_command(averaged.of_runs(np.array([1])))


@pytest.mark.parametrize("count", [1, 9, 10, 12, 17, 18])
def test_runs_of_any_length_are_accepted(count):
    data = motor((0.8, -0.8), 0.75, runs=2)
    rows = (data.run == 0) | (np.arange(len(data)) % 1200 < count)
    assert is_stepwise_command(data.select(rows))
    assert not is_stepwise_command(data.select(np.arange(count)))


@pytest.mark.parametrize("levels", [np.arange(3.0, 13.0), np.arange(3.0, 30.0), (1.5, -0.7)])
def test_an_effort_that_is_constant_in_each_run_is_a_command(levels):
    """A motor starts from rest at several voltages, one run for each."""
    t = np.tile(np.arange(100) * 0.02, len(levels))
    run = np.repeat(np.arange(len(levels)), 100)
    voltage = np.asarray(levels)[run]
    velocity = 5.0 * voltage * (1.0 - np.exp(-t / 0.3))
    signals = t, 0.0 * t, velocity, np.gradient(velocity, 0.02), voltage
    data = ChannelData("motor", ChannelKind.REVOLUTE, *signals, run, run)
    assert is_stepwise_command(data)
    assert not is_stepwise_command(data.of_runs(np.array([1])))  # a single level shows nothing
    steady = replace(data, velocity=5.0 * voltage)  # a constant torque at a constant speed may be a reading
    assert not is_stepwise_command(steady)
    assert not is_stepwise_command(replace(data, velocity=np.zeros(len(data))))


def test_friction_is_named_if_the_command_is_constant_in_each_run():
    """An offset of each run would fit such a command without any law of the motion."""
    volts = np.array([3.0, 8.0, 13.0, 18.0])
    t, run = np.tile(np.arange(300) * 0.005, 4), np.repeat(np.arange(4), 300)
    torque = volts[run] - 0.9  # after Coulomb friction
    speed = torque / 0.05 * (1.0 - np.exp(-0.05 * t / INERTIA))
    speed += np.random.default_rng(1).normal(0.0, 0.02, len(t))
    acceleration = torque / INERTIA * np.exp(-0.05 * t / INERTIA)
    signals = t, np.cumsum(speed) * 0.005, speed, acceleration, volts[run]
    data = ChannelData("motor", ChannelKind.REVOLUTE, *signals, run, np.full(len(t), -1))
    result = diagnose_channel(data, ROTOR, SOME, np.random.default_rng(0))
    assert result.verdict is Verdict.MISSING
    assert "coulomb_friction" in {result.accepted[0].effect, *result.accepted[0].confused_with}
    assert all(entry.kind is not Kind.RUN_DIFFERENCES for entry in result.budget)
    assert Kind.RUN_DIFFERENCES not in error_of_kinds(searched(data, base=ROTOR).start).kinds


def test_a_motion_that_follows_its_command_late_has_a_delay():
    data = motor((0.8, -0.8, -0.8, 0.8, -0.8), 0.24, runs=2, coulomb=0.0)
    late = 13
    rows = np.arange(len(data)) % 1200 < 1200 - late
    early = replace(data, effort=np.roll(data.effort, -late)).select(rows)
    result = diagnose_channel(early, ROTOR, SOME, np.random.default_rng(0))
    assert [step.effect for step in result.accepted] == ["delay"]
    assert result.final.parameters["delay.time"].value == pytest.approx(-late / RATE_HZ, abs=0.2 / RATE_HZ)


def test_an_effect_below_the_steps_of_a_command_is_not_their_rounding():
    whole = SimpleNamespace(data=motor((0.8, -0.8), 0.75), rmse=0.05)
    search = SimpleNamespace(without=lambda *_: SimpleNamespace(rmse=0.06))
    assert not acceptance._is_rounding(search, whole, "delay")


@pytest.mark.parametrize(
    ("low", "high", "is_command"), [(-0.3, 0.3, True), (0.0, 0.6, False), (-0.3, 0.2, False)]
)
def test_a_sensor_with_steps_as_large_as_two_opposite_values_would_read_zero(low, high, is_command):
    """The motion alone does not show that the effort steps: its velocity is far too smooth."""
    time_s = np.arange(2000) / RATE_HZ
    effort = np.where(np.sin(5.0 * time_s) > 0.0, high, low)
    signals = time_s, np.sin(5.0 * time_s), np.cos(5.0 * time_s), -np.sin(5.0 * time_s), effort
    run = np.zeros(len(time_s), dtype=np.int64)
    data = ChannelData("joint", ChannelKind.REVOLUTE, *signals, run, run - 1)
    assert is_stepwise_command(data) == is_command


def test_a_contact_has_a_force_sensor():
    data = replace(motor((0.8, -0.8), 0.75), kind=ChannelKind.CONTACT)
    assert not is_stepwise_command(data)


@pytest.mark.parametrize(("coulomb", "step"), [(0.05, 0.4), (0.1, 0.3)])
def test_rounded_measurement_of_a_torque_that_steps_is_no_command(coulomb, step):
    """A servo moves with a trapezoidal speed, and a coarse sensor measures its torque."""
    time_s = np.arange(2400) / RATE_HZ
    corners_s, speeds = [0.0, 0.6, 1.4, 2.0, 2.6, 3.4, 4.0], [0.0, 30.0, 30.0, 0.0, -30.0, -30.0, 0.0]
    velocity = np.interp(time_s % 4.0, corners_s, speeds)
    acceleration = np.gradient(velocity, time_s)
    torque = INERTIA * acceleration + coulomb * np.sign(velocity) + 0.02 * velocity
    signals = time_s, np.cumsum(velocity) / RATE_HZ, velocity, acceleration, step * np.round(torque / step)
    run = np.repeat(np.arange(3), 800)
    data = ChannelData("servo", ChannelKind.REVOLUTE, *signals, run, np.full(len(run), -1))
    assert 3 < len(np.unique(data.effort)) <= 12
    assert not is_stepwise_command(data)


@given(
    frequency_hz=st.floats(0.2, 2.0),
    levels=st.integers(2, 11),
    phase=st.floats(0.0, 6.0),
    noise=st.floats(0.0, 0.05),
)
def test_a_rounded_torque_is_no_command(frequency_hz, levels, phase, noise):
    time_s = np.arange(2000) / RATE_HZ
    angle = 2.0 * np.pi * frequency_hz * time_s + phase
    torque, velocity = np.sin(angle), -np.cos(angle) / (2.0 * np.pi * frequency_hz * INERTIA)
    velocity += noise * np.ptp(velocity) * np.random.default_rng(RNG_SEED).normal(size=len(velocity))
    rounded = np.round(0.5 * (levels - 1) * (torque + 1.0))
    signals = time_s, np.cumsum(velocity) / RATE_HZ, velocity, torque / INERTIA, rounded
    run = np.zeros(len(time_s), dtype=np.int64)
    assert not is_stepwise_command(ChannelData("joint", ChannelKind.REVOLUTE, *signals, run, run - 1))
