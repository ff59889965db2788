"""What goes wrong with Robstride motors, and what the robot makes of it."""

import numpy as np
import pytest

from robot_io.drivers.can.line import CanFrame
from robot_io.errors import DeviceError
from robot_io.types import Status
from sim_backend.emulators import FaultKind
from tests.wire.parts import ROBSTRIDE

STATE, CONTROL, ANSWER, FAULTS, HOST = 2, 1, 17, 21, 0xFD


def test_another_host_is_answered(bench):
    arm = bench(ROBSTRIDE, [("maker: robstride", "maker: robstride\n    host_id: 0")]).start()
    assert arm.ticks(5).torque_status is Status.OK


def test_faults_are_told_by_name_also_those_that_no_state_has(bench):
    arm = bench(ROBSTRIDE).start()
    arm.motors[2].tell_faults(1 << 3 | 1 << 16)
    assert arm.ticks_until(lambda m: m.torque_status is Status.FAULT) <= 3
    assert "joint 3 (motor 3): over voltage, over current in phase A" in arm.problem
    arm.robot.deactivate()
    with pytest.raises(DeviceError, match="over voltage, over current in phase A: remove the cause"):
        arm.robot.activate()
    arm.robot.activate()  # which the motor takes, and says no more of it
    assert arm.ticks(3).torque_status is Status.OK


def test_a_fault_that_stays_is_not_cleared_in_silence(bench):
    arm = bench(ROBSTRIDE).start()
    arm.robot.deactivate()
    arm.strike("motors", FaultKind.ALERT, device=3, times=1)
    arm.ticks(2, None)
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"joint 3 \(motor 3\): over temperature: remove"):
            arm.robot.activate()


@pytest.mark.parametrize(
    ("kind", "middle", "host"),
    [
        (STATE, 2 << 14 | 9, HOST),  # of a motor that is not there
        (STATE, 2 << 14 | 1, 0x01),  # to another host
        (CONTROL, 1, HOST),
        (24, 2 << 14 | 1, HOST),  # a report by itself
        (ANSWER, 1, HOST),
        (STATE, 3 << 14 | 1, HOST),  # a mode that does not exist
    ],
)
def test_frames_that_are_no_state_of_a_motor_of_ours_are_no_position(bench, kind, middle, host):
    arm = bench(ROBSTRIDE).start()
    before = arm.tick().joint_position_rad
    bus = arm.robot.buses["motors"]
    for extended in (True, False):
        bus.line.drain = lambda _, one=extended: [
            (CanFrame(kind << 24 | middle << 8 | host, bytes(8), one), 9.0)
        ]
        bus._drain(0.0)
    np.testing.assert_allclose(bus._position_rad, before)
