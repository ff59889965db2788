"""Safe stop of an arm with weight, on both simulated arms."""

from contextlib import closing
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from palpate.control.loop.task import Phase
from palpate.control.probing.plan import ProbingPlan
from tests.control.simulated_arms import NAMES, SimulatedArm, kelvin_voigt

SURFACE_M = 0.05
PLAN = ProbingPlan(speeds_m_s=(0.15,), hold_s=0.4)


@dataclass
class Stop:
    """From the tick of the trip until torque off, one row a tick, and a while after it."""

    time_s: np.ndarray
    height_m: np.ndarray
    force_n: np.ndarray
    joint_speed_rad_s: np.ndarray
    finished_s: float
    force_after_n: float

    def falls_m(self, within_s: float) -> float:
        """How far the tip falls within a time from the trip on."""
        return float(self.height_m[0] - self.height_m[self.time_s <= self.time_s[0] + within_s].min())

    @property
    def tip_speed_m_s(self) -> np.ndarray:
        return np.diff(self.height_m) / np.diff(self.time_s)


@cache
def stop_in(name: str, phase: Phase, ticks: int, *, gravity=True, stiffness=500.0) -> Stop:
    """Probe, and ask for a stop `ticks` after the arm was first seen in a phase."""
    arm, left = SimulatedArm(name, PLAN, kelvin_voigt(stiffness, surface_m=SURFACE_M), gravity), ticks

    def stop() -> str:
        nonlocal left
        records = arm.log.records
        left -= bool(records) and records[-1]["phase"] == phase
        return "it is time" if left <= 0 else ""

    with closing(arm.robot):
        assert arm.run(stop).cause == "stopped: it is time"
        ended = len(arm.rows)
        arm.wait(0.4)
    table = arm.truth
    stopped_s = next(record["time_s"] for record in arm.log.records if record["phase"] == Phase.STOPPED)
    time_s, height_m, force_n, speed = table[:ended][table[:ended, 0] >= stopped_s - 1e-9].T
    return Stop(time_s, height_m, force_n, speed, time_s[-1] - time_s[0], table[ended:, 2].max())


@pytest.mark.parametrize("name", NAMES)
def test_arm_at_home_is_held_up_and_then_sinks_slowly(name):
    stop = stop_in(name, Phase.FREE_AIR, 100)
    assert stop.falls_m(within_s=0.3) < 0.001
    assert 0.05 < stop.falls_m(within_s=2.5) < 0.15  # it does come down, by itself
    still_supported = stop.time_s[1:] < stop.time_s[0] + 2.5
    assert np.abs(stop.tip_speed_m_s[still_supported]).max() < 0.2
    assert stop.joint_speed_rad_s.max() < 2.0
    assert stop.force_n.max() < 10.0
    assert stop.finished_s == pytest.approx(0.3 + 3.0, abs=0.003)


def test_arm_falls_without_a_gravity_model():
    """The reason for the model; and the stop then ends with the braking."""
    stop = stop_in("follower", Phase.FREE_AIR, 100, gravity=False)
    assert stop.falls_m(within_s=0.3) > 0.1
    assert stop.force_n.max() > 10.0
    assert stop.finished_s == pytest.approx(0.3, abs=0.003)


@pytest.mark.parametrize(
    ("name", "phase", "stiffness"), [("follower", Phase.LOADING, 7100.0), ("leader", Phase.HOLD, 500.0)]
)
def test_object_in_contact_pushes_the_arm_out_and_carries_it_softly(name, phase, stiffness):
    stop = stop_in(name, phase, 10, stiffness=stiffness)
    at_trip_n = stop.force_n[0]
    braking = stop.time_s < stop.time_s[0] + 0.3
    assert stop.force_n[braking].max() < 1.1 * at_trip_n + 4.0  # the way that is left of 150 mm/s
    assert stop.force_n[braking][-1] < at_trip_n
    assert stop.force_n.max() < 30.0  # in the end the object carries the arm's own weight, about 20 N
    assert stop.height_m[braking].max() < SURFACE_M + 0.05
    assert stop.finished_s == pytest.approx(3.3, abs=0.003)


def test_torque_off_is_softer_than_without_lowering():
    plain = stop_in("leader", Phase.HOLD, 10, gravity=False, stiffness=500.0)
    lowered = stop_in("leader", Phase.HOLD, 10, stiffness=500.0)
    assert lowered.force_after_n < 0.7 * plain.force_after_n
