"""Detection of a frozen force sensor, without false alarms for repeating ones."""

import numpy as np
import pytest

from palpate.robot_io.guard import Guard, SafeState
from palpate.robot_io.guard.plausibility import StuckForce
from tests.robot_io.guard.test_unresponsive_drive import LIMITS, measured

LIMIT_S = 0.02


MOVING_RAD_S = 0.3


def felt(k, force_n, *, at_s=None, position_rad=None):
    """Tick k of an arm that moves."""
    position_rad = MOVING_RAD_S * k * 1e-3 if position_rad is None else position_rad
    return measured(k * 1e-3, [0.0, 0.0])._replace(
        force_n=force_n,
        force_at_s=k * 1e-3 if at_s is None else at_s,
        joint_position_rad=np.array([0.0, position_rad]),
    )


def ticks_until_named(check, forces_n, *, every=1, first=0, speeds_rad_s=None):
    """The tick at which it is named and what is said, or None; a sample comes every so many ticks."""
    positions_rad = None if speeds_rad_s is None else 1e-3 * np.cumsum(speeds_rad_s)
    for k, force_n in enumerate(forces_n, first):
        at_s = (k - k % every) * 1e-3
        position_rad = None if positions_rad is None else positions_rad[k - first]
        said = check.problem(felt(k, force_n, at_s=at_s, position_rad=position_rad))
        if said:
            return k, said.text
    return None


def noise(count, *, seed=0, std=0.02, step=0.005, every=1, smooth=1):
    """Forces in steps; each drawn number stands for some ticks, and is a mean over some others."""
    drawn = np.random.default_rng(seed).normal(0.0, std, count // every + smooth)
    means = np.convolve(drawn, np.ones(smooth) / smooth, "valid")
    return np.round(np.repeat(means, every)[:count] / step) * step


def frozen(forces_n, at):
    return np.where(np.arange(len(forces_n)) < at, forces_n, forces_n[at])


@pytest.mark.parametrize("every", [1, 2], ids=["1 kHz", "500 Hz"])
@pytest.mark.parametrize(("at", "held_n"), [(300, 0.0), (2000, 0.0), (300, 5.0), (300, -5.0)])
def test_frozen_sensor_is_named_within_its_limit(every, at, held_n):
    forces_n = held_n + frozen(noise(4000, every=every), at)
    tick, said = ticks_until_named(StuckForce(LIMIT_S), forces_n, every=every)
    assert at < tick <= at + 22
    assert said.startswith("force sensor: stuck at ")
    assert said.endswith("equal samples while the arm moved")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "kind",
    [
        {},
        {"std": 0.002},  # below a step: most samples are equal
        {"std": 0.0},
        {"smooth": 30},
        {"smooth": 30, "step": 0.01},
        {"std": 0.2, "step": 3.5},
        {"every": 13},  # measures slower than it sends
    ],
    ids=str,
)
def test_healthy_sensor_is_not_reported(kind, seed):
    assert ticks_until_named(StuckForce(LIMIT_S), noise(20_000, seed=seed, **kind)) is None


def test_coarse_sensor_at_constant_load_is_not_reported():
    depth = np.concatenate([np.zeros(500), np.linspace(0, 10, 100), np.full(1000, 10.0), np.zeros(500)])
    forces_n = np.round((np.tile(depth, 3) + noise(6300, std=0.05, step=1e-6)) / 1.0) * 1.0
    assert ticks_until_named(StuckForce(LIMIT_S), forces_n) is None


AIR, PRESS, HOLD = 3000, 300, 5000  # ticks


def held(air_n, held_n, *, air_std, hold_std, step, seed=0):
    """Forces of a press with a hold; the noise of the way there and that of the hold differ."""
    clean = np.concatenate([np.full(AIR, air_n), np.linspace(air_n, held_n, PRESS), np.full(HOLD, held_n)])
    stds = np.concatenate([np.full(AIR + PRESS, air_std), np.full(HOLD, hold_std)])
    return np.round((clean + np.random.default_rng(seed).normal(0.0, 1.0, len(clean)) * stds) / step) * step


@pytest.mark.parametrize("share", [0.05, 0.2, 0.3, 0.5, 0.7, 1.0])
def test_coarse_sensor_that_alternates_on_an_edge_may_rest_within_a_step(share):
    forces_n = held(0.05, 5.0, air_std=share * 0.1, hold_std=share * 0.1, step=0.1)
    assert ticks_until_named(StuckForce(LIMIT_S), forces_n) is None


def test_resting_sensor_is_not_reported_as_stuck():
    forces_n = held(0.0, 5.0, air_std=0.1, hold_std=0.001, step=0.02)
    speeds = np.where(np.arange(len(forces_n)) < AIR + PRESS, MOVING_RAD_S, 0.0)
    assert ticks_until_named(StuckForce(LIMIT_S), forces_n, speeds_rad_s=speeds) is None
    speeds[-1000:] = MOVING_RAD_S  # and when it moves on, it is no longer excused
    tick, _ = ticks_until_named(StuckForce(LIMIT_S), forces_n, speeds_rad_s=speeds)
    assert tick <= len(forces_n) - 1000 + 10
    forces_n = held(0.0, 5.0, air_std=0.1, hold_std=0.001, step=0.02)
    trembles = np.where(np.arange(len(forces_n)) % 2, 1.5, -1.5)  # a step of 1.5 mrad, to and fro
    trembles[: AIR + PRESS] = MOVING_RAD_S
    assert ticks_until_named(StuckForce(LIMIT_S), forces_n, speeds_rad_s=trembles) is None


def test_deliberate_zero_and_a_ringing_blow_are_no_fault():
    """Indicators do: in a first short stretch of free air, and in a longer one after the press."""
    pressed = np.concatenate([np.linspace(0, 5, 300), np.full(500, 5.0), np.linspace(5, 0, 300)])
    forces_n = np.concatenate([np.zeros(300), pressed + noise(1100, step=0.01), np.zeros(6000)])
    assert ticks_until_named(StuckForce(LIMIT_S), forces_n) is None
    # In the air it alternates on the edge between two steps; held in the middle of one it stands still.
    blow, step = np.tile([3.0, 0.0], 40), 0.1
    forces_n = np.concatenate([np.full(AIR, 0.05), blow, np.full(HOLD, 3.0)])
    forces_n = np.round((forces_n + noise(len(forces_n), step=1e-6)) / step) * step
    assert ticks_until_named(StuckForce(LIMIT_S), forces_n) is None


def test_limit_is_the_robot_file_s_and_longer_for_a_repeating_sensor():
    tick, _ = ticks_until_named(StuckForce(0.1), frozen(noise(4000), 2000))
    assert tick == 2100
    forces_n = np.concatenate([noise(500), np.full(16, 1.0), noise(500, seed=1), np.full(200, 2.0)])
    tick, said = ticks_until_named(StuckForce(LIMIT_S), forces_n)
    assert tick == 1016 + 46  # three times its 15 that were equal to the one before, and one
    assert said == "force sensor: stuck at 2 N, 47 equal samples while the arm moved"
    lazy = noise(6000, every=4, std=0.05)
    tick, _ = ticks_until_named(StuckForce(LIMIT_S), frozen(lazy, 3000))
    assert 3000 + 60 < tick < 3000 + 100


@pytest.mark.parametrize("seed", range(2))
def test_short_time_limit_alone_reports_no_fault(seed):
    assert ticks_until_named(StuckForce(1e-3), noise(20_000, seed=seed)) is None


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("row", "accused"), [(14, False), (28, True)])
def test_chance_repetitions_of_a_coarse_sensor_are_not_reported(seed, row, accused):
    """A fourth of its samples are equal to the one before: so many in a row come by chance once in 1e9."""
    forces_n = np.concatenate([noise(150, seed=seed, std=0.008), np.full(row + 1, 1.0), noise(10)])
    assert (ticks_until_named(StuckForce(5e-3), forces_n) is not None) is accused


EDGE = [0.0, 1.0]  # on the edge between two steps of 1 N, which is no noise
IMPROBABLE = [  # repeated forces, how often, and the number of equal samples after them that is improbable
    ("noise of many steps: one in twenty repeats by chance", [1.0, *EDGE, *[30.0, 60.0] * 99], 1, 8),
    ("a blow counts as eight steps", [*EDGE * 19, 0.0, 99.0], 5, 63),
    ("too little noise to know", [*EDGE * 4, 0.0, 2.0], 20, None),
    ("just too little", [*EDGE * 3, 0.0, 2.0], 25, None),
    ("a push in small steps is no noise", [*(0.1, 0.0) * 60, *np.arange(0.2, 10.0, 0.2)], 1, None),
]


@pytest.mark.parametrize(
    ("forces_n", "times", "count"), [row[1:] for row in IMPROBABLE], ids=[row[0] for row in IMPROBABLE]
)
def test_improbable_number_of_equal_samples_follows_from_the_noise(forces_n, times, count):
    forces_n = np.concatenate([np.tile(forces_n, times)[1:], np.full(500, 0.5)])
    tick, said = ticks_until_named(StuckForce(5e-3), forces_n) or (None, "")
    assert tick == (count and len(forces_n) - 501 + count)
    assert not count or f"{count} equal samples" in said


@pytest.mark.parametrize(("moved_mrad", "named"), [(2.0, False), (2.5, True)])
def test_arm_that_moved_by_two_milliradians_may_stand(moved_mrad, named):
    forces_n = np.concatenate([np.tile([0.0, 1.0, 0.0, 2.0], 100), np.full(200, 3.0)])
    speeds = np.zeros(600)
    speeds[500] = moved_mrad
    assert bool(ticks_until_named(StuckForce(LIMIT_S), forces_n, speeds_rad_s=speeds)) is named


def test_old_and_initial_equal_samples_are_not_stuck():
    forces_n = np.concatenate([noise(150), np.full(5, 1.0), noise(10)])
    assert ticks_until_named(StuckForce(1e-3), forces_n) is None
    forces_n = np.concatenate([noise(150), np.full(300, 1.0)])
    tick, _ = ticks_until_named(StuckForce(1e-3), forces_n)
    assert 156 <= tick <= 175
    check = StuckForce(LIMIT_S)
    assert ticks_until_named(check, noise(1000)) is None
    old = measured(1.0, [0.0, 0.0])._replace(force_n=0.1, force_at_s=1.0)
    assert all(check.problem(old._replace(time_s=1.0 + 1e-3 * k)) is None for k in range(200))
    wave = np.tile([0.0, 1.0, 0.0, 2.0], 100)
    first_99, first_100 = (ticks_until_named(StuckForce(LIMIT_S), frozen(wave, at)) for at in (98, 99))
    assert first_99 is None
    assert first_100 is not None


def test_fault_stops_the_arm_and_is_cleared_by_rearming():
    guard = Guard(LIMITS, SafeState(damping_nms_rad=(1.0, 1.0), stop_time_s=0.05), 2)
    for k, force_n in enumerate(frozen(noise(1000), 500)):
        guard.watch(felt(k, force_n))
    assert "force sensor: stuck at" in guard.tripped.cause
    assert 0.5 < guard.tripped.time_s <= 0.522
    for k in range(100):
        again = felt(1100 + k, force_n)
        if k == 0:
            guard.rearm(again)
        guard.watch(again)
    assert guard.tripped is None  # whoever goes on with it has looked at it
