"""Couplings between leader and follower: transparency without delay, and passivity."""

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.teleop_couplings import (
    COUPLINGS,
    DIRECT,
    FOUR_CHANNEL,
    MODEL_MEDIATED,
    RESERVE_J,
    TIME_DOMAIN,
    WAVE_VARIABLES,
    DelayLine,
    DevicePort,
    HandArm,
    LatestPacketChannel,
    LinkFaults,
    PlayoutBuffer,
    SpringDamper,
    presses,
    returned_energy_j,
    run,
)
from palpate.robot_io.errors import InputError

DT_S = 1e-3
OBJECT = SpringDamper(1500.0, 10.0)
HOLD = presses(0.02, 0.02, ((1.0, 2.5), (8.0, 11.0)))
FAULTS = st.builds(LinkFaults, st.floats(0.0, 0.3), st.floats(0.0, 0.1), st.floats(0.0, 0.4))


@st.composite
def motions(draw, steps=800):
    """A smooth motion [m] that begins and ends at rest at 0."""
    amplitudes = np.array(draw(st.lists(st.floats(-0.02, 0.02), min_size=1, max_size=8)))
    s = np.linspace(0.0, 1.0, steps)
    waves = np.sin(np.pi * np.outer(np.arange(1, len(amplitudes) + 1), s))
    return (amplitudes @ waves) * np.minimum(1.0, np.minimum(s, 1.0 - s) / 0.1) ** 2


def energy_made_j(coupling, leader_m, follower_m, faults, seed):
    """What the coupling gave to both devices above what it got from them, at most so far [J]."""
    sides = coupling.leader(), coupling.follower()
    lines = [DelayLine(faults, np.random.default_rng([seed, way])) for way in (0, 1)]
    channels = coupling.channel(), coupling.channel()
    made = most = 0.0
    held_n = [0.0, 0.0]  # what hand and tool push back with, in the sign of `DevicePort`
    ways = np.column_stack([leader_m, follower_m])
    speeds = np.gradient(ways, DT_S, axis=0)
    for step, (place, speed) in enumerate(zip(ways[:-1], speeds[:-1], strict=True)):
        for line, channel in zip(lines, channels, strict=True):
            for number, packet in line.arrived(step * DT_S):
                channel.take(number, packet)
        for end, side in enumerate(sides):
            given = channels[end].packet()
            force_n, packet = side.step(DevicePort(place[end], speed[end], held_n[end]), given, DT_S)
            lines[1 - end].send(packet, step * DT_S)
            held_n[end] = force_n if end else -force_n
            made += force_n * (ways[step + 1, end] - place[end])
        most = max(most, made)
    return most


@pytest.mark.parametrize("coupling", [WAVE_VARIABLES, TIME_DOMAIN], ids=lambda c: c.name)
@settings(max_examples=25)
@given(leader=motions(), follower=motions(), faults=FAULTS, seed=st.integers(0, 99))
def test_passive_couplings_produce_no_energy(coupling, leader, follower, faults, seed):
    held_n = 8000.0 * np.abs(np.diff(leader)).max() ** 2 + 8000.0 * np.abs(np.diff(follower)).max() ** 2
    assert energy_made_j(coupling, leader, follower, faults, seed) <= 2.0 * RESERVE_J + held_n


@pytest.mark.parametrize("coupling", [DIRECT, FOUR_CHANNEL], ids=lambda c: c.name)
def test_direct_couplings_produce_energy_over_a_delay(coupling):
    """A hand that moves to and fro while the follower is clamped: the test above can fail."""
    s = np.linspace(0.0, 1.0, 2000)
    motion = 0.01 * np.sin(6.0 * np.pi * s) * np.minimum(1.0, np.minimum(s, 1.0 - s) / 0.1) ** 2
    assert energy_made_j(coupling, motion, 0.0 * motion, LinkFaults(0.1), 0) > 1.0


@pytest.mark.parametrize("coupling", COUPLINGS, ids=lambda c: c.name)
def test_object_is_rendered_without_delay(coupling):
    """All but four-channel and ours lose the follower's compliance, at most a third of the force here."""
    duration_s = 11.0 if coupling is MODEL_MEDIATED else 2.4  # until the touch after the probing
    trace = run(coupling, OBJECT, HandArm(HOLD), LinkFaults(), duration_s)
    felt_n, there_n = trace["felt_n"][-500:].mean(), 1500.0 * trace["hand_m"][-500:].mean()
    assert there_n * 0.67 < felt_n < there_n * 1.05
    assert returned_energy_j(trace).max() < 2.0 * RESERVE_J


def test_direct_coupling_is_unstable_where_passive_ones_are_not():
    made = {
        coupling.name: returned_energy_j(run(coupling, OBJECT, HandArm(HOLD), LinkFaults(0.1), 3.0)).max()
        for coupling in COUPLINGS
    }
    assert made["direct"] > 1.0
    for name in ("wave variables", "time-domain passivity", "model-mediated"):
        assert made[name] < 2.0 * RESERVE_J


def test_model_is_rendered_within_five_percent_over_a_bad_link():
    trace = run(MODEL_MEDIATED, OBJECT, HandArm(HOLD), LinkFaults(0.5, 0.1, 0.2), 11.0)
    assert trace["felt_n"][-500:].mean() == pytest.approx(1500.0 * trace["hand_m"][-500:].mean(), rel=0.05)
    first = trace["time_s"] < 8.0  # the follower presses by itself within its limit, and then rests
    assert 8.0 < trace["object_n"][first].max() < 9.0
    assert np.ptp(trace["follower_m"][first][-1000:]) < 1e-4
    assert trace["object_n"][first][-1000:].max() == 0.0


def received(channel, faults: LinkFaults, steps: int = 8_000) -> tuple[np.ndarray, np.ndarray]:
    """Ages of what a channel gives in each step, and the numbers; a packet holds the step it was sent in."""
    line, seen = DelayLine(faults, np.random.default_rng(3)), []
    for tick in range(steps):
        line.send((float(tick),), tick * DT_S)
        for number, packet in line.arrived(tick * DT_S):
            channel.take(number, packet)
        given = channel.packet()
        if given is not None:
            seen.append((tick - given[0], given[0]))
    ages, numbers = np.array(seen).T
    assert (np.diff(numbers) >= 0).all()
    return ages, numbers


def test_line_delays_and_loses_and_never_goes_back():
    ages, numbers = received(LatestPacketChannel(), LinkFaults(0.05, 0.02, 0.3))
    assert ages.min() >= 50
    assert ages.max() < 100
    assert len(set(numbers)) < 0.7 * 8_000  # the lost, and those that were overtaken


def test_buffered_jitter_equals_a_constant_delay():
    ages, numbers = received(PlayoutBuffer(), LinkFaults(0.05, 0.02))
    settled = ages[1000:]
    assert settled.min() == settled.max() == 70
    assert (np.diff(numbers[1000:]) == 1.0).all()  # each once: none was overtaken
    ages, _ = received(PlayoutBuffer(), LinkFaults(0.05, 0.02, 0.3))
    assert (ages[1000:] == 70).mean() == pytest.approx(0.7, abs=0.02)  # of the rest the one before stands


def test_waves_over_jitter_equal_waves_over_the_resulting_delay():
    felt = [
        run(WAVE_VARIABLES, OBJECT, HandArm(HOLD), faults, 11.0)["felt_n"][-500:].mean()
        for faults in (LinkFaults(0.05, 0.02), LinkFaults(0.07))
    ]
    assert felt[0] == pytest.approx(felt[1], rel=0.05)


@pytest.mark.parametrize("channel", [LatestPacketChannel, PlayoutBuffer])
def test_packet_with_nonfinite_values_is_ignored(channel):
    end = channel()
    for number, packet in enumerate([(1.0, 2.0), (nan, 2.0), (inf, -inf)]):
        end.take(number, packet)
    assert end.packet() == (1.0, 2.0)


@pytest.mark.parametrize("coupling", COUPLINGS, ids=lambda c: c.name)
@pytest.mark.parametrize(
    ("port", "packet", "dt_s"),
    [
        ((nan, 0.0, 0.0), None, DT_S),
        ((0.0, 0.0, 0.0), (nan, 0.0, 0.0, 0.0), DT_S),
        ((0.0, 0.0, 0.0), None, 0.0),
    ],
)
def test_nonfinite_values_are_refused_and_change_nothing(coupling, port, packet, dt_s):
    for make in (coupling.leader, coupling.follower):
        side, other = make(), make()
        with pytest.raises(InputError, match="finite"):
            side.step(DevicePort(*port), packet, dt_s)
        for place_m in (0.0, 0.001):
            good = DevicePort(place_m, 0.01, 0.1), None, DT_S
            assert side.step(*good) == other.step(*good)
