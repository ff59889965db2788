"""A whole probing run through the Dynamixel drivers byte by byte, and what faults on the way do to it."""

import numpy as np
import pytest

from control.loop.result import Outcome
from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.robot import build_robot
from robot_io.robot_file import parse_robot_file
from robot_io.session import Session
from robot_io.types import Command, Status
from sim_backend.emulators import Fault, FaultKind
from sim_backend.imperfections.coulomb_friction import CoulombFriction
from tests.wire.parts import ROOT
from tests.wire.test_probing import probe, stiffness_and_damping

pytestmark = pytest.mark.slow

ROBOT = ROOT / "robots" / "dynamixel_3dof.yaml"
SIMULATED = """buses:
  world: {driver: pybullet, scenario: default}
encoder: {driver: sim_encoder, bus: world}
torque: {driver: sim_torque, bus: world}
force: {driver: sim_force, bus: world}
"""


def tick(arm):
    """Read, waiting as long as the control loop does, and command nothing."""
    arm.clock.sleep_until(arm.clock.now_s() + 1e-3)
    measurement = arm.robot.read(arm.clock.now_s() + 0.6e-3)
    arm.robot.write(Command(np.zeros(3)), arm.clock.now_s())
    return measurement


@pytest.fixture(scope="module")
def direct(tmp_path_factory):
    """The same arm with the simulation's own drivers."""
    text = ROBOT.read_text(encoding="utf-8")
    text = text[: text.index("buses:")] + SIMULATED + text[text.index("home_rad:") :]
    path = tmp_path_factory.mktemp("direct") / "direct.mcap"
    robot_file, clock = parse_robot_file(text, ROBOT), SimulatedClock()
    robot = build_robot(robot_file, DriverCatalogue("sim_backend.drivers"), clock)
    assert probe(robot, robot_file, clock, path).outcome is Outcome.FINISHED
    return stiffness_and_damping(path)


@pytest.mark.parametrize(
    "changes",
    [[], [("velocity: servo", "velocity: difference"), ("fast_sync_read: true", "fast_sync_read: false")]],
    ids=["fast, servo's velocity", "plain, difference"],
)
def test_the_object_is_the_same_over_the_wire(bench, direct, tmp_path, changes):
    """Within what steps of 0.4 mm and 6 mm/s at the tip leave uncertain."""
    arm = bench(ROBOT, changes)
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, tmp_path / "wire.mcap")
    assert result.outcome is Outcome.FINISHED, result.cause
    wired = stiffness_and_damping(tmp_path / "wire.mcap")
    for name, (value, _) in direct.items():
        assert wired[name][0] == pytest.approx(value, rel=0.02)
        assert abs(wired[name][0] - value) < 4 * wired[name][1]


@pytest.mark.parametrize(
    ("kind", "details", "cause"),
    [
        (FaultKind.DROP, {"device": 2}, "servo 2 did not answer in time"),
        (FaultKind.CORRUPT, {"device": 3}, "CRC mismatch"),
        (FaultKind.WRONG_ID, {"device": 1}, "servo 101 answered in place of servo 1"),
        (FaultKind.DELAY, {"delay_s": 5e-3}, "did not answer in time"),
        (FaultKind.ALERT, {"device": 2, "times": 1}, r"servo 2 (joint 2): has switched its torque off"),
        (
            FaultKind.REBOOT,
            {"device": 3, "times": 1, "delay_s": 1e-3},
            "servo 3 (joint 3): has lost its settings",
        ),
        (FaultKind.UNPLUG, {}, "unplugged?"),
        (FaultKind.STUCK, {"device": 1}, "encoder of joint 1: stuck at"),
    ],
)
def test_a_fault_on_the_way_ends_without_torque_and_with_its_name(bench, tmp_path, kind, details, cause):
    arm = bench(ROBOT)
    fault_s = 0.5
    arm.faults["motors"].add(Fault(kind=kind, from_s=fault_s, **details))
    path = tmp_path / "wire.mcap"
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, path)
    assert result.outcome is Outcome.TRIPPED
    assert cause in result.cause
    arm.clock.sleep_until(arm.clock.now_s() + 0.1)
    assert np.abs(arm.drive_torque_nm).max() == 0
    session = Session.open(path)
    assert session.samples("tick")["time_s"][-1] >= fault_s
    assert any(cause in event.text for event in session.events)


def test_joints_that_friction_holds_are_no_stuck_encoders(bench, tmp_path):
    """Encoders of twelve bits, and the friction of gears of this size."""
    rubbing = [
        CoulombFriction(joint=joint, coulomb_nm=torque_nm)
        for joint, torque_nm in ((1, 0.5), (2, 0.3), (3, 0.05))
    ]
    arm = bench(ROBOT, hidden=rubbing)
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, tmp_path / "wire.mcap")
    assert result.outcome is Outcome.FINISHED, result.cause


@pytest.mark.parametrize("kind", [FaultKind.DUPLICATE, FaultKind.REORDER])
def test_a_fault_that_harms_nothing_stops_nothing(bench, kind):
    arm = bench(ROBOT, [("fast_sync_read: true", "fast_sync_read: false")]).start()
    arm.strike("motors", kind)
    for _ in range(20):
        assert tick(arm).encoder_status is Status.OK


def test_a_servo_lost_for_a_tick_leaves_one_stale_sample_and_its_name(bench):
    arm = bench(ROBOT).start()
    arm.strike("motors", FaultKind.DROP, device=2, times=1)
    measurement = tick(arm)
    assert measurement.encoder_status is measurement.torque_status is Status.STALE
    assert arm.robot.bus_delays == {"motors": "servo 2 did not answer in time"}
    assert tick(arm).encoder_status is Status.OK
    assert arm.robot.bus_delays == {}
