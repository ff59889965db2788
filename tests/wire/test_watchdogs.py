"""Motors let go by themselves once nothing commands them, and say so; the next activation forgets it."""

import numpy as np
import pytest

from robot_io.types import Status
from tests.wire.parts import DAMIAO, MOTEUS, ROBSTRIDE

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
def test_a_motor_that_hears_nothing_lets_go(bench, robot, step_nm, attribute, shown, problem):
    arm = bench(robot).start()
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
def test_a_timeout_that_motors_are_delivered_without_is_set(bench, robot, kept, number):
    arm = bench(robot)
    assert [node.timeout_s for node in arm.motors] == [None] * 3
    arm.start()
    assert [getattr(node, kept)[number] for node in arm.motors] == [2000] * 3
