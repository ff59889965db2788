"""What goes wrong with moteus controllers, and what the robot makes of it."""

import numpy as np
import pytest

from robot_io.drivers.can.line import CanFrame
from robot_io.errors import DeviceError
from robot_io.examination import Level
from robot_io.types import Status
from sim_backend.emulators import FaultKind
from tests.wire.parts import MOTEUS

PUSH_NM = (3.0, -2.0, 1.0)


def test_no_torque_and_no_mode_before_it_is_activated(bench):
    arm = bench(MOTEUS)
    arm.robot.configure()
    assert arm.ticks(10, None).encoder_status is Status.OK
    assert [node.mode for node in arm.motors] == [0] * 3
    arm.robot.activate()
    arm.robot.deactivate()
    assert [node.mode for node in arm.motors] == [0] * 3


def test_a_fault_is_named_and_forgotten_at_the_next_activation(bench):
    arm = bench(MOTEUS).start()
    arm.strike("motors", FaultKind.ALERT, device=3, times=1)
    assert arm.ticks_until(lambda m: m.torque_status is Status.FAULT) <= 3
    assert "joint 3 (motor 3): over temperature" in arm.problem
    (third,) = (one for one in arm.robot.buses["motors"].examine() if "motor 3" in one.subject)
    assert third.level is Level.WARN
    assert "over temperature; mode 1, 24.0 V, 31" in third.text
    arm.robot.deactivate()
    arm.robot.activate()
    assert arm.ticks(5).torque_status is Status.OK


def test_a_reference_that_is_lost_by_a_restart_is_missed_at_the_next_activation(bench):
    arm = bench(MOTEUS).start()
    arm.robot.deactivate()
    arm.motors[1].home = 0
    with pytest.raises(DeviceError, match=r"joint 2 \(motor 2\): has no reference for its position"):
        arm.robot.activate()
    assert [node.mode for node in arm.motors] == [0] * 3


def test_a_position_that_is_lost_is_no_old_one(bench):
    arm = bench(MOTEUS).start()
    arm.motors[0].known = False
    assert arm.ticks(3).encoder_status is Status.FAULT
    before = arm.tick().torque_at_s
    assert arm.ticks(3).torque_at_s == before


def test_what_cuts_a_torque_is_said(bench):
    arm = bench(MOTEUS).start()
    arm.motors[2]._max_torque_nm = 0.25
    arm.ticks(4, PUSH_NM)
    assert "joint 3 (motor 3): its torque is limited by servo.max_current_A" in arm.problem


@pytest.mark.parametrize(("number", "fd"), [(0x100, False), (0x900, True), (0x101, True), (0x8100, True)])
def test_answers_that_are_not_for_us_or_no_can_fd_are_no_position(bench, number, fd):
    arm = bench(MOTEUS).start()
    before = arm.tick().joint_position_rad
    bus = arm.robot.buses["motors"]
    bus.line.drain = lambda _: [(CanFrame(number, bytes(24), extended=True, fd=fd), 9.0)]
    bus._drain(0.0)
    np.testing.assert_allclose(bus._position_rad, before)
    assert bus.line.counts["foreign id"] == 1


def test_frames_of_classic_can_are_told_from_can_fd(bench):
    """Other drivers take none of the latter."""
    arm = bench(MOTEUS).start()
    sent = []
    arm.robot.buses["motors"].line._bus.send = lambda message, timeout: sent.append(message)
    arm.tick()
    assert {(one.is_fd, one.bitrate_switch, one.is_extended_id) for one in sent} == {(True, True, True)}
