"""First samples of devices, and torque off without commands."""

import numpy as np
import pytest

from palpate.control.loop.loop import FIRST_SAMPLE_S, run_loop
from palpate.control.loop.result import Outcome
from palpate.robot_io.errors import DeviceTimeoutError
from palpate.robot_io.guard import Guard
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from tests.control.loop_parts import MemoryLog, SwingTask
from tests.wire.parts import CUBEMARS, DAMIAO, DYNAMIXEL, MOTEUS, ODRIVE, ROBSTRIDE, SO101


class Start(SwingTask):
    """Keeps what it was started from, and how old that was."""

    def __init__(self, clock) -> None:
        super().__init__(done_at=20, torque_nm=0.0)
        self._clock = clock

    def start(self, measurement) -> None:
        super().start(measurement)
        self.started_s = self._clock.now_s()


def begin(arm, **options):
    limits = arm.arm.robot_file.limits
    guard = Guard(limits, arm.arm.robot_file.safe_state, arm.robot.joint_count, lambda _: [0.0] * 3)
    task, rate_hz = Start(arm.clock), 1.0 / arm.period_s
    return run_loop(arm.robot, guard, task, arm.clock, MemoryLog(), rate_hz=rate_hz, **options), task, limits


@pytest.mark.parametrize("robot_file", [ODRIVE, CUBEMARS], ids=["odrive", "cubemars"])
@pytest.mark.parametrize("pause_s", [0.0, 0.5])
def test_loop_starts_with_new_samples_after_any_pause(make_robot, robot_file, pause_s):
    arm = make_robot(robot_file)
    arm.robot.configure()
    arm.clock.sleep_until(arm.clock.now_s() + pause_s)  # a session is opened, a plan is checked
    result, task, limits = begin(arm)
    assert result.outcome is Outcome.FINISHED, result.cause
    measurement = task.started_from
    assert task.started_s - measurement.encoder_at_s <= limits.encoder_age_s
    assert task.started_s - measurement.torque_at_s <= limits.torque_age_s
    assert task.started_s - measurement.force_at_s <= limits.force_age_s


@pytest.mark.parametrize(
    "robot_file", [ODRIVE, CUBEMARS, DAMIAO, ROBSTRIDE, MOTEUS, DYNAMIXEL, SO101], ids=lambda path: path.stem
)
def test_stall_after_the_activation_stops_the_arm(make_robot, robot_file):
    """Feetech servos held their position meanwhile, and the task began."""
    arm = make_robot(robot_file)
    arm.robot.configure()
    held_s = iter((0.0, 0.15))  # before and after the activation
    result, task, _ = begin(arm, stop=lambda: arm.clock.sleep_until(arm.clock.now_s() + next(held_s, 0.0)))
    assert result.cause.startswith("the program was held up for 0.15")
    assert not task.steps
    assert not arm.drive_torque_nm.any()


@pytest.mark.parametrize(
    ("robot_file", "switch_on", "label"),
    [
        (ODRIVE, lambda arm: setattr(arm.motors[1], "state", 8), "joint 2 (node 1): is armed"),
        (DYNAMIXEL, lambda arm: arm.servos[2].memory.put(64, 1), "servo 2 (joint 2): its torque is on"),
        (SO101, lambda arm: arm.servos[2].put(40, 1, 1), "servo 2 (joint 1): its torque is on"),
    ],
    ids=["odrive", "dynamixel", "feetech"],
)
def test_drive_with_torque_that_should_have_none_is_a_fault(make_robot, robot_file, switch_on, label):
    """After a restart, or by another program: its samples were served as those of an arm without power."""
    arm = make_robot(robot_file)
    arm.robot.configure()
    assert arm.ticks(20, None).torque_status is Status.OK
    switch_on(arm)
    assert arm.ticks(20, None).torque_status is Status.FAULT
    assert f"{label}, although it was switched off" in arm.problem
    arm.robot.deactivate()
    assert arm.ticks(20, None).torque_status is Status.OK


@pytest.mark.parametrize("robot_file", [ODRIVE, CUBEMARS], ids=["odrive", "cubemars"])
def test_motor_silent_before_the_loop_is_named_and_power_stays_off(make_robot, robot_file, monkeypatch):
    assert FIRST_SAMPLE_S == 1.0
    monkeypatch.setattr("palpate.control.loop.loop.FIRST_SAMPLE_S", 0.3)
    arm = make_robot(robot_file)
    arm.robot.configure()
    arm.inject_fault("motors", FaultKind.DROP, device=2)
    arm.clock.sleep_until(arm.clock.now_s() + 0.2)
    begun_s = arm.clock.now_s()
    with pytest.raises(DeviceTimeoutError, match=r"encoder: newest sample is .* s old.*joint [23]"):
        begin(arm)
    assert arm.clock.now_s() - begun_s == pytest.approx(0.3, abs=0.05)
    assert not arm.drive_torque_nm.any()


def test_sensor_with_unparsable_lines_is_distinguished_from_a_silent_one(make_robot):
    as_other = (
        r"{driver: force_lines, bus: load_cell, capacity_n: 100.0, pattern: 'X(?P<value>\d+)', unit: N}"
    )
    arm = make_robot(ODRIVE, (("{driver: loadstar, bus: load_cell, capacity_n: 100.0}", as_other),))
    arm.robot.configure()
    with pytest.raises(DeviceTimeoutError, match=r"\d+ lines or .* arrived, but no reading yet: .* pattern"):
        begin(arm)


PUSH_NM = (3.0, -2.0, 1.0)


@pytest.mark.parametrize(
    ("robot", "step_nm", "attribute", "shown", "problem"),
    [
        (DAMIAO, 0.03, "error", 13, "lost communication: its CAN timeout has fired"),
        (ROBSTRIDE, 0.01, "enabled", False, "joint 1 (motor 1): has left motor mode"),
        (MOTEUS, 1e-6, "mode", 11, "joint 1 (motor 1): its watchdog has expired"),
    ],
    ids=["damiao", "robstride", "moteus"],
)
def test_motor_without_commands_disables_its_torque(make_robot, robot, step_nm, attribute, shown, problem):
    arm = make_robot(robot).start()
    arm.ticks(3, PUSH_NM)
    np.testing.assert_allclose(arm.drive_torque_nm, PUSH_NM, atol=step_nm)
    arm.clock.sleep_until(arm.clock.now_s() + 0.11)
    assert not arm.drive_torque_nm.any()
    assert [getattr(node, attribute) for node in arm.motors] == [shown] * 3
    arm.ticks(2)
    assert problem in arm.problem
    arm.robot.deactivate()
    arm.robot.activate()
    assert arm.ticks(5).torque_status is Status.OK


@pytest.mark.parametrize(
    ("robot", "kept", "number"),
    [(DAMIAO, "registers", 9), (ROBSTRIDE, "parameters", 0x7028)],
    ids=["damiao", "robstride"],
)
def test_timeout_missing_from_the_factory_is_set(make_robot, robot, kept, number):
    arm = make_robot(robot)
    assert [node.timeout_s for node in arm.motors] == [None] * 3
    arm.start()
    assert [getattr(node, kept)[number] for node in arm.motors] == [2000] * 3
