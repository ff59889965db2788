"""What a stop does to an arm that weighs something, on both simulated arms."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from control.loop import run_loop
from control.phases import Phase
from control.probing import ProbingTask
from control.probing_plan import ProbingPlan
from control.rigid_body import RigidBody
from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.guard import Guard
from robot_io.robot import build_robot
from robot_io.robot_file import load_robot_file
from tests.control.loop_parts import MemoryLog

ARMS = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"
NAMES = ["follower", "leader"]
PLAN = ProbingPlan(speeds_m_s=(0.15,), hold_s=0.4)
SURFACE_M = 0.05


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


def stop_in(name: str, phase: Phase, ticks: int, *, gravity=True, stiffness=500.0) -> Stop:
    """Probe, and ask for a stop `ticks` after the arm was first seen in a phase."""
    robot_file = load_robot_file(ARMS / name / f"{name}.yaml")
    clock, log, rows = SimulatedClock(), MemoryLog(), []
    robot = build_robot(robot_file, DriverCatalogue("sim_backend.drivers"), clock)
    bus = robot.buses["world"]
    law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness, "damping_n_s_m": 20.0}
    bus.use_scenario(bus.scenario.model_validate({"object": {"law": law}}))
    body = RigidBody.from_urdf(robot_file.urdf_path, robot_file.tip_frame)
    model = body.gravity if gravity else None
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count, model)
    task = ProbingTask.from_robot_file(robot_file, PLAN)
    left = ticks

    def keep(_time_s: float) -> None:
        truth = bus.world.truth()
        speed = np.abs(truth.joint_velocity_rad_s).max()
        rows.append((truth.time_s, truth.tip_position_world_m[2], truth.force_n, speed))

    def stop() -> bool:
        nonlocal left
        left -= bool(log.records) and log.records[-1]["phase"] == phase
        return left <= 0

    with robot:
        clock.subscribe(keep)
        result = run_loop(robot, guard, task, clock, log, rate_hz=1000.0, stop=stop)
        assert result.cause == "stopped on request"
        ended = len(rows)
        for _ in range(400):
            clock.sleep_until(clock.now_s() + 1e-3)
    table = np.array(rows)
    tripped_s = next(record["time_s"] for record in log.records if record["phase"] == Phase.STOPPED)
    stopping = table[:ended][table[:ended, 0] >= tripped_s - 1e-9]
    time_s, height_m, force_n, speed = stopping.T
    return Stop(time_s, height_m, force_n, speed, time_s[-1] - time_s[0], table[ended:, 2].max())


@pytest.mark.parametrize("name", NAMES)
def test_at_home_the_weight_is_held_up_and_then_sinks_slowly(name):
    stop = stop_in(name, Phase.FREE_AIR, 100)
    assert stop.falls_m(within_s=0.3) < 0.001
    assert 0.05 < stop.falls_m(within_s=2.5) < 0.15  # it does come down, by itself
    still_supported = stop.time_s[1:] < stop.time_s[0] + 2.5
    assert np.abs(stop.tip_speed_m_s[still_supported]).max() < 0.2
    assert stop.joint_speed_rad_s.max() < 2.0
    assert stop.force_n.max() < 10.0
    assert stop.finished_s == pytest.approx(0.3 + 3.0, abs=0.003)


@pytest.mark.parametrize("name", NAMES)
def test_without_a_model_of_its_weight_the_arm_falls(name):
    """The reason for the model; and the stop then ends with the braking."""
    stop = stop_in(name, Phase.FREE_AIR, 100, gravity=False)
    assert stop.falls_m(within_s=0.3) > 0.1
    assert stop.force_n.max() > 10.0
    assert stop.finished_s == pytest.approx(0.3, abs=0.003)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("phase", [Phase.LOADING, Phase.HOLD])
@pytest.mark.parametrize("stiffness", [500.0, 7100.0])
def test_in_contact_the_object_pushes_the_arm_out_and_carries_it_softly_later(name, phase, stiffness):
    stop = stop_in(name, phase, 10, stiffness=stiffness)
    at_trip_n = stop.force_n[0]
    braking = stop.time_s < stop.time_s[0] + 0.3
    assert stop.force_n[braking].max() < 1.1 * at_trip_n + 4.0  # the way that is left of 150 mm/s
    assert stop.force_n[braking][-1] < at_trip_n
    assert stop.force_n.max() < 30.0  # in the end the object carries the arm's own weight, about 20 N
    assert stop.height_m[braking].max() < SURFACE_M + 0.05
    assert stop.finished_s == pytest.approx(3.3, abs=0.003)


@pytest.mark.parametrize("name", NAMES)
def test_torque_off_comes_softer_than_without_lowering(name):
    plain = stop_in(name, Phase.HOLD, 10, gravity=False)
    lowered = stop_in(name, Phase.HOLD, 10)
    assert lowered.force_after_n < 0.7 * plain.force_after_n
