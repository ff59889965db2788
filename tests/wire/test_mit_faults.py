"""Faults of CAN motors in MIT mode and of moteus."""

import numpy as np
import pytest

from palpate.robot_io.drivers.can.line import CanFrame
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.examination import Level
from palpate.robot_io.types import Command, Status
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import CUBEMARS, DAMIAO, MOTEUS, ROBSTRIDE

PUSH_NM = (3.0, -2.0, 1.0)
TIMEOUT = 9  # a register of a Damiao motor
ENTER = [("driver: mit_bus", "driver: mit_bus\n    ask_with: enter")]
STATE, CONTROL, ANSWER, HOST = 2, 1, 17, 0xFD  # kinds of Robstride frames, and who is addressed


def test_write_returns_the_applied_torque(make_robot):
    arm = make_robot(CUBEMARS).start()
    sent = arm.robot.write(Command(np.array(PUSH_NM)), arm.clock.now_s())
    arm.clock.sleep_until(arm.clock.now_s() + 1e-3)
    np.testing.assert_allclose(arm.drive_torque_nm, sent.joint_torque_nm, rtol=1e-9)


@pytest.mark.parametrize("ask_with", ["exit", "enter"])
def test_no_torque_before_activation_nor_after_the_timeout(make_robot, ask_with):
    arm = make_robot(CUBEMARS, [("driver: mit_bus", f"driver: mit_bus\n    ask_with: {ask_with}")])
    arm.robot.configure()
    measurement = arm.ticks(10, None)
    assert np.abs(arm.drive_torque_nm).max() < 0.02  # zero on the wire is half a step off
    assert measurement.encoder_status is Status.OK
    assert not any(node.enabled for node in arm.motors)
    arm.robot.activate()
    arm.robot.deactivate()
    assert arm.ticks(3, None).encoder_status is Status.OK
    assert not any(node.enabled for node in arm.motors)
    arm = make_robot(CUBEMARS, [("driver: mit_bus", f"driver: mit_bus\n    ask_with: {ask_with}")]).start()
    assert arm.tick().torque_status is Status.OK
    assert np.abs(arm.drive_torque_nm).max() < 0.02
    arm.ticks(3, PUSH_NM)
    np.testing.assert_allclose(arm.drive_torque_nm, PUSH_NM, atol=50 / 4095)


def test_unconfirmed_motor_command_is_an_error(make_robot):
    arm = make_robot(CUBEMARS)
    arm.robot.configure()
    arm.inject_fault("motors", FaultKind.DROP, device=2, for_s=0.5)
    with pytest.raises(DeviceError, match=r"motor mode is not confirmed by joint 2 \(motor 2\)"):
        arm.robot.activate()
    arm.clock.sleep_until(arm.clock.now_s() + 0.5)
    arm.robot.activate()
    assert all(node.enabled for node in arm.motors)
    arm.inject_fault("motors", FaultKind.DROP, device=3, for_s=0.5)
    arm.tick()
    with pytest.raises(DeviceError, match=r"torque off is not confirmed by joint 3 \(motor 3\)"):
        arm.robot.deactivate()
    assert not any(node.enabled for node in arm.motors)  # they were told all the same


def test_restarted_motor_answers_and_exerts_no_torque(make_robot):
    """As the firmware does that the protocol comes from; `deaf_drive_s` is for this."""
    arm = make_robot(CUBEMARS).start()
    arm.ticks(5, PUSH_NM)
    arm.inject_fault("motors", FaultKind.REBOOT, device=1, times=1, delay_s=0.001)
    measurement = arm.ticks(20, PUSH_NM)
    assert measurement.torque_status is Status.OK
    assert not arm.problem
    assert abs(measurement.joint_torque_nm[0]) < 0.1
    assert measurement.joint_torque_nm[1] == pytest.approx(PUSH_NM[1], abs=0.1)


def test_motor_that_ignores_queries_outside_motor_mode_is_switched_off(make_robot):
    arm = make_robot(CUBEMARS, [("driver: mit_bus", "driver: mit_bus\n    ask_with: enter")]).start()
    arm.ticks(5, PUSH_NM)
    arm.inject_fault("motors", FaultKind.REBOOT, device=1, times=1, delay_s=0.001)
    assert 2 <= arm.ticks_until(lambda m: bool(arm.problem), torque_nm=PUSH_NM) <= 5
    assert "joint 1 (motor 1): nothing valid" in arm.problem
    arm.robot.deactivate()  # all of them confirm, also the one that heard no zero torque
    assert not any(node.enabled for node in arm.motors)
    arm.robot.activate()
    assert arm.ticks(5, PUSH_NM).torque_status is Status.OK


def test_short_frames_and_foreign_ids_are_counted_separately(make_robot):
    arm = make_robot(CUBEMARS).start()
    counts = arm.robot.buses["motors"].line.counts
    arm.inject_fault("motors", FaultKind.CORRUPT, device=1, for_s=0.002)
    arm.inject_fault("motors", FaultKind.WRONG_ID, device=2, for_s=0.002)
    arm.ticks(4)
    assert counts["not valid"] >= 1
    assert counts["foreign id"] >= 1


def test_position_at_the_end_of_the_wire_range_is_saturated(make_robot):
    ranges = "ranges: {position_rad: 10.0, velocity_rad_s: 50, torque_nm: 25}"
    arm = make_robot(CUBEMARS, [("motor_id: 1, model: AK70-10", f"motor_id: 1, model: AK70-10, {ranges}")])
    arm.motors[0]._zero_rad = -5.0
    arm.robot.configure()
    # Joint 1 stands at 0.87 rad, the motor at 11.75.
    assert arm.ticks(3, None).encoder_status is Status.SATURATED


@pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, ROBSTRIDE], ids=lambda path: path.stem)
@pytest.mark.parametrize("end", [-1, 1])
def test_torque_at_the_end_of_the_wire_range_is_saturated(make_robot, path, end):
    """The end of the range was served as the measured torque."""
    arm = make_robot(path).start()
    push_nm = (end * 3.0, -2.0, 1.0)
    assert arm.ticks(4, push_nm).torque_status is Status.OK
    motor = arm.motors[0]
    motor._torque_limit = 0.5 * abs(motor.shaft.torque_nm)
    motor._drive = lambda: None  # its own torque stays
    measurement = arm.ticks(4, push_nm)
    assert (measurement.torque_status, measurement.torque_saturated) == (
        Status.SATURATED,
        (True, False, False),
    )
    assert not arm.problem


@pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, ROBSTRIDE], ids=lambda path: path.stem)
@pytest.mark.parametrize("end", [-1, 1])
def test_motor_that_passes_the_end_of_its_range_has_no_known_position(make_robot, path, end):
    """Robstride's continue at the other end, and were read 12.6 rad off as healthy."""
    arm = make_robot(path)
    arm.motors[0]._zero_rad -= 5.0 * end  # nearly there
    arm.start()
    step_rad, passed = end * arm.period_s * 6.0, False  # at the velocity limit
    for _ in range(500):
        arm.motors[0]._zero_rad -= step_rad
        measurement, motor = arm.tick(), arm.motors[0]
        passed |= measurement.encoder_status is Status.SATURATED
        if measurement.encoder_status is Status.OK:
            assert not passed
            assert measurement.joint_position_rad[0] == pytest.approx(motor.shaft.position_rad / 2, abs=0.02)
    assert passed
    assert "joint 1 (motor 1): was at the end of its range of 12.5" in arm.problem


def test_late_motor_is_examined_as_present(make_robot):
    arm = make_robot(CUBEMARS)
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=4.2e-3)
    arm.robot.configure()
    findings = [
        one for one in arm.robot.buses["motors"].examine() if "motor" in one.subject or "node" in one.subject
    ]
    assert findings
    assert not [one.text for one in findings if "does not answer" in one.text]


@pytest.mark.parametrize(("stuck", "problem"), [(True, "torque off"), (False, "motor mode")])
def test_motor_state_is_the_reported_state(make_robot, stuck, problem):
    """An answer alone is no confirmation."""
    arm = make_robot(DAMIAO)
    arm.robot.configure()
    if stuck:
        arm.robot.activate()

    class Stuck(type(arm.motors[0])):
        enabled = property(lambda self: stuck, lambda self, value: None)

    arm.motors[0].__class__ = Stuck
    with pytest.raises(DeviceError, match=rf"{problem} is not confirmed by joint 1 \(motor 1\)"):
        arm.robot.deactivate() if stuck else arm.robot.activate()


@pytest.mark.parametrize(
    ("path", "frame"),
    [
        (
            DAMIAO,
            CanFrame(17, bytes((1, 0, 0x33, TIMEOUT, 0xD0, 0x07, 0, 0))),
        ),  # a late answer about a register
        (ROBSTRIDE, CanFrame(STATE << 24 | 2 << 22 | 1 << 8 | HOST, bytes(8), extended=False)),
        *(
            (ROBSTRIDE, CanFrame(kind << 24 | middle << 8 | host, bytes(8), extended=True))
            for kind, middle, host in (
                (STATE, 2 << 14 | 9, HOST),  # of a motor that is not there
                (STATE, 2 << 14 | 1, 0x01),  # to another host
                (CONTROL, 1, HOST),
                (24, 2 << 14 | 1, HOST),  # a report by itself
                (ANSWER, 1, HOST),
                (STATE, 3 << 14 | 1, HOST),  # a mode that does not exist
            )
        ),
        *(  # a classic CAN frame, and CAN FD answers that are not for us
            (MOTEUS, CanFrame(number, bytes(24), extended=True, fd=fd))
            for number, fd in ((0x100, False), (0x900, True), (0x101, True), (0x8100, True))
        ),
    ],
)
def test_frame_without_a_motor_state_is_no_position(make_robot, path, frame):
    arm = make_robot(path).start()
    before = arm.tick().joint_position_rad
    bus = arm.robot.buses["motors"]
    bus.line.drain = lambda _: [(frame, arm.clock.now_s())]  # as if it answered the last request
    bus._drain(0.0)
    np.testing.assert_allclose(bus._position_rad, before)
    assert path is not MOTEUS or bus.line.counts["foreign id"] == 1


@pytest.mark.parametrize(
    ("path", "error"),
    [
        (CUBEMARS, "MOSFET over temperature"),
        (DAMIAO, "MOSFET over temperature"),
        (ROBSTRIDE, "over temperature; remove"),
    ],
)
def test_error_other_than_the_timeout_is_not_cleared_silently(make_robot, path, error):
    arm = make_robot(path).start()
    arm.robot.deactivate()
    arm.inject_fault("motors", FaultKind.ALERT, device=3, times=1)
    arm.ticks(2, None)
    for _ in range(2):
        with pytest.raises(DeviceError, match=rf"joint 3 \(motor 3\): {error}"):
            arm.robot.activate()
    assert path is not DAMIAO or arm.motors[2].error == 11


def test_another_host_is_answered(make_robot):
    arm = make_robot(ROBSTRIDE, [("maker: robstride", "maker: robstride\n    host_id: 0")]).start()
    assert arm.ticks(5).torque_status is Status.OK


def test_faults_are_named_even_without_a_state_bit(make_robot):
    arm = make_robot(ROBSTRIDE).start()
    arm.motors[2].report_faults(1 << 3 | 1 << 16)
    assert arm.ticks_until(lambda m: m.torque_status is Status.FAULT) <= 3
    assert "joint 3 (motor 3): over voltage, over current in phase A" in arm.problem
    arm.robot.deactivate()
    with pytest.raises(DeviceError, match="over voltage, over current in phase A; remove the cause"):
        arm.robot.activate()
    arm.robot.activate()  # which the motor takes, and says no more of it
    assert arm.ticks(3).torque_status is Status.OK


def test_warning_is_named_and_no_fault(make_robot):
    arm = make_robot(ROBSTRIDE).start()
    arm.motors[1].report_faults(0, 1 | 1 << 4)
    assert arm.ticks(3, PUSH_NM).torque_status is Status.OK
    assert "joint 2 (motor 2): warns: near over temperature, unknown fault, bit 36" in arm.problem
    arm.robot.deactivate()
    (second,) = (one for one in arm.robot.buses["motors"].examine() if "motor 2" in one.subject)
    assert (second.level, "warns: near over temperature" in second.text) == (Level.WARN, True)
    arm.motors[1].report_faults(0)
    arm.ticks(3, None)
    assert not arm.problem


@pytest.mark.parametrize("when", ["before", "during a run"])
def test_active_reports_in_the_form_of_answers_are_named(make_robot, when):
    """Older firmware sends them as states (type 2): only two motors with one id were suspected."""
    arm = make_robot(ROBSTRIDE)
    motor = arm.motors[1]
    report = lambda now_s: [motor._reply()]  # noqa: E731
    if when == "before":
        motor.send_unrequested = report
        with pytest.raises(
            DeviceError, match=r"joint 2 \(motor 2\): .*, or does the motor send reports without a request\?"
        ):
            arm.robot.configure()
        return
    arm.start()
    motor.send_unrequested = report
    motor._zero_rad += 0.01
    arm.ticks(20, PUSH_NM)
    assert "does the motor send reports without a request" in arm.problem


@pytest.mark.parametrize(("changes", "hinted"), [((), True), (ENTER, False)], ids=["exit", "enter"])
def test_motor_that_may_answer_in_its_mode_only_is_hinted_at(make_robot, changes, hinted):
    """By CubeMars' manual; the setting was named nowhere."""
    arm = make_robot(CUBEMARS, changes)
    arm.motors[1].receive = lambda *_: []
    with pytest.raises(DeviceError, match=r"no answer in 0\.05 s from joint 2") as raised:
        arm.robot.buses["motors"].configure()
    findings = arm.robot.buses["motors"].examine()
    (second,) = (one for one in findings if "motor 2" in one.subject)
    assert ["'ask_with: enter'" in text for text in (str(raised.value), second.remedy)] == [hinted] * 2


def test_no_torque_and_no_mode_before_activation(make_robot):
    arm = make_robot(MOTEUS)
    arm.robot.configure()
    assert arm.ticks(10, None).encoder_status is Status.OK
    assert [node.mode for node in arm.motors] == [0] * 3
    arm.robot.activate()
    arm.robot.deactivate()
    assert [node.mode for node in arm.motors] == [0] * 3


def test_fault_is_named_and_cleared_by_the_next_activation(make_robot):
    arm = make_robot(MOTEUS).start()
    arm.inject_fault("motors", FaultKind.ALERT, device=3, times=1)
    assert arm.ticks_until(lambda m: m.torque_status is Status.FAULT) <= 3
    assert "joint 3 (motor 3): over temperature" in arm.problem
    (third,) = (one for one in arm.robot.buses["motors"].examine() if "motor 3" in one.subject)
    assert third.level is Level.WARN
    assert "over temperature; mode 1, 24.0 V, 31" in third.text
    arm.robot.deactivate()
    arm.robot.activate()
    assert arm.ticks(5).torque_status is Status.OK


def test_lost_reference_is_detected_at_the_next_activation(make_robot):
    arm = make_robot(MOTEUS).start()
    arm.robot.deactivate()
    arm.motors[1].home = 0
    with pytest.raises(DeviceError, match=r"joint 2 \(motor 2\): has no reference for its position"):
        arm.robot.activate()
    assert [node.mode for node in arm.motors] == [0] * 3


@pytest.mark.parametrize(
    ("home", "encoder", "said"),
    [
        (2, Status.OK, "has left motor mode; has it restarted?"),
        (0, Status.FAULT, "has no reference for its position (home state 0)"),
    ],
)
def test_restarted_controller_gets_no_torque_until_the_next_activation(make_robot, home, encoder, said):
    """The next torque switched it on again, at a position without reference that was read as healthy."""
    arm = make_robot(MOTEUS).start()
    arm.ticks(5, PUSH_NM)
    arm.motors[0].home = home
    if home:
        arm.inject_fault("motors", FaultKind.REBOOT, device=1, times=1, delay_s=0.002)
    for _ in range(2):
        measurement = arm.ticks(20, PUSH_NM)
        assert (measurement.encoder_status, measurement.torque_status) == (encoder, Status.FAULT)
        assert f"joint 1 (motor 1): {said}" in arm.problem
        assert (arm.motors[0].mode, arm.drive_torque_nm[0]) == (0, 0.0)
    arm.ticks(2, None)
    assert arm.motors[0].mode == 0
    arm.robot.deactivate()
    arm.motors[0].home = 2
    arm.robot.activate()
    assert arm.ticks(5, PUSH_NM).torque_status is Status.OK
    assert arm.drive_torque_nm[0] == pytest.approx(PUSH_NM[0], abs=1e-5)


def test_lost_position_is_a_fault(make_robot):
    arm = make_robot(MOTEUS).start()
    arm.motors[0].known = False
    assert arm.ticks(3).encoder_status is Status.FAULT
    assert "joint 1 (motor 1): its position is nan" in arm.robot.bus_errors["motors"]
    before = arm.tick().torque_at_s
    assert arm.ticks(3).torque_at_s == before


@pytest.mark.parametrize(
    ("fault", "status"), [(35, Status.FAULT), (42, Status.FAULT), (43, Status.FAULT), (38, Status.OK)]
)
def test_position_of_a_faulty_encoder_is_invalid(make_robot, fault, status):
    arm = make_robot(MOTEUS).start()
    arm.motors[1].mode, arm.motors[1].fault = 1, fault
    measurement = arm.ticks(3)
    assert np.isfinite(measurement.joint_position_rad).all()
    assert (measurement.encoder_status, measurement.torque_status) == (status, Status.FAULT)


def test_torque_limitation_is_reported(make_robot):
    arm = make_robot(MOTEUS).start()
    arm.motors[2]._max_torque_nm = 0.25
    arm.ticks(4, PUSH_NM)
    assert "joint 3 (motor 3): its torque is limited by servo.max_current_A" in arm.problem


def test_classic_can_frames_are_distinguished_from_can_fd(make_robot):
    """Other drivers take none of the latter."""
    arm = make_robot(MOTEUS).start()
    sent = []
    arm.robot.buses["motors"].line._bus.send = lambda message, timeout: sent.append(message)
    arm.tick()
    assert {(one.is_fd, one.bitrate_switch, one.is_extended_id) for one in sent} == {(True, True, True)}
