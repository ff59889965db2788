"""What goes wrong with MIT-mode motors, and what the robot makes of it."""

import numpy as np
import pytest

from robot_io.errors import DeviceError
from robot_io.types import Command, Status
from sim_backend.emulators import FaultKind
from tests.wire.parts import CUBEMARS

PUSH_NM = (3.0, -2.0, 1.0)


def test_what_write_returns_is_what_acts(bench):
    arm = bench(CUBEMARS).start()
    sent = arm.robot.write(Command(np.array(PUSH_NM)), arm.clock.now_s())
    arm.clock.sleep_until(arm.clock.now_s() + 1e-3)
    np.testing.assert_allclose(arm.drive_torque_nm, sent.joint_torque_nm, rtol=1e-9)


@pytest.mark.parametrize("ask_with", ["exit", "enter"])
def test_no_torque_before_it_is_activated(bench, ask_with):
    arm = bench(CUBEMARS, [("driver: mit_bus", f"driver: mit_bus\n    ask_with: {ask_with}")])
    arm.robot.configure()
    measurement = arm.ticks(10, None)
    assert np.abs(arm.drive_torque_nm).max() < 0.02  # zero on the wire is half a step off
    assert measurement.encoder_status is Status.OK
    assert not any(node.enabled for node in arm.motors)
    arm.robot.activate()
    arm.robot.deactivate()
    assert arm.ticks(3, None).encoder_status is Status.OK
    assert not any(node.enabled for node in arm.motors)


@pytest.mark.parametrize("ask_with", ["exit", "enter"])
def test_a_timeout_that_bites_is_proven_and_leaves_no_torque(bench, ask_with):
    arm = bench(CUBEMARS, [("driver: mit_bus", f"driver: mit_bus\n    ask_with: {ask_with}")]).start()
    assert arm.tick().torque_status is Status.OK
    assert np.abs(arm.drive_torque_nm).max() < 0.02
    arm.ticks(3, PUSH_NM)
    np.testing.assert_allclose(arm.drive_torque_nm, PUSH_NM, atol=50 / 4095)


def test_what_a_motor_does_not_confirm_is_an_error(bench):
    arm = bench(CUBEMARS)
    arm.robot.configure()
    arm.strike("motors", FaultKind.DROP, device=2, for_s=0.2)
    with pytest.raises(DeviceError, match=r"motor mode is not confirmed by joint 2 \(motor 2\)"):
        arm.robot.activate()
    arm.clock.sleep_until(arm.clock.now_s() + 0.2)
    arm.robot.activate()
    assert all(node.enabled for node in arm.motors)
    arm.strike("motors", FaultKind.DROP, device=3, for_s=0.1)
    with pytest.raises(DeviceError, match=r"torque off is not confirmed by joint 3 \(motor 3\)"):
        arm.robot.deactivate()
    assert not any(node.enabled for node in arm.motors)  # they were told all the same


def test_a_motor_that_has_restarted_goes_on_answering_and_exerts_nothing(bench):
    """As the firmware does that the protocol comes from; `deaf_drive_s` is for this."""
    arm = bench(CUBEMARS).start()
    arm.ticks(5, PUSH_NM)
    arm.strike("motors", FaultKind.REBOOT, device=1, times=1, delay_s=0.001)
    measurement = arm.ticks(20, PUSH_NM)
    assert measurement.torque_status is Status.OK
    assert not arm.problem
    assert abs(measurement.joint_torque_nm[0]) < 0.1
    assert measurement.joint_torque_nm[1] == pytest.approx(PUSH_NM[1], abs=0.1)


def test_a_motor_that_is_deaf_outside_of_motor_mode_is_heard_out_and_let_go(bench):
    arm = bench(CUBEMARS, [("driver: mit_bus", "driver: mit_bus\n    ask_with: enter")]).start()
    arm.ticks(5, PUSH_NM)
    arm.strike("motors", FaultKind.REBOOT, device=1, times=1, delay_s=0.001)
    assert 2 <= arm.ticks_until(lambda m: bool(arm.problem), torque_nm=PUSH_NM) <= 5
    assert "joint 1 (motor 1): nothing valid" in arm.problem
    arm.robot.deactivate()  # all of them confirm, also the one that heard no zero torque
    assert not any(node.enabled for node in arm.motors)
    arm.robot.activate()
    assert arm.ticks(5, PUSH_NM).torque_status is Status.OK


def test_a_motor_s_error_is_named(bench):
    arm = bench(CUBEMARS).start()
    arm.strike("motors", FaultKind.ALERT, device=3, times=1)
    ticks = arm.ticks_until(lambda m: m.torque_status is Status.FAULT)
    assert ticks <= 3
    assert "joint 3 (motor 3): MOSFET over temperature" in arm.problem
    arm.robot.deactivate()
    with pytest.raises(DeviceError, match="MOSFET"):
        arm.robot.activate()


def test_short_frames_and_foreign_ids_are_told_apart(bench):
    arm = bench(CUBEMARS).start()
    counts = arm.robot.buses["motors"].line.counts
    arm.strike("motors", FaultKind.CORRUPT, device=1, for_s=0.002)
    arm.strike("motors", FaultKind.WRONG_ID, device=2, for_s=0.002)
    arm.ticks(4)
    assert counts["not valid"] >= 1
    assert counts["foreign id"] >= 1


def test_a_position_at_the_end_of_the_wire_s_range_is_marked(bench):
    ranges = "ranges: {position_rad: 1.0, velocity_rad_s: 50, torque_nm: 25}"
    arm = bench(CUBEMARS, [("motor_id: 1, model: AK70-10", f"motor_id: 1, model: AK70-10, {ranges}")])
    arm.robot.configure()
    assert (
        arm.ticks(3, None).encoder_status is Status.SATURATED
    )  # joint 1 stands at 0.87 rad, the motor at 1.75


def test_a_motor_that_answers_late_is_examined_as_one_that_answers(bench):
    arm = bench(CUBEMARS)
    arm.strike("motors", FaultKind.DELAY, delay_s=4.2e-3)
    arm.robot.configure()
    findings = [
        one for one in arm.robot.buses["motors"].examine() if "motor" in one.subject or "node" in one.subject
    ]
    assert findings
    assert not [one.text for one in findings if "does not answer" in one.text]
