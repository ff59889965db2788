"""CAN motor drivers: conversions, and foreign, late and lost answers."""

import numpy as np
import pytest

from palpate.robot_io.errors import DeviceError
from palpate.robot_io.types import Command, Status
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import CUBEMARS, DAMIAO, MOTEUS, ODRIVE, ROBSTRIDE, V0_5, add_twin

PUSH_NM = (3.0, -2.0, 1.0)


@pytest.mark.parametrize(
    ("path", "changes", "drive_nm", "read_nm", "read_rad"),
    [
        pytest.param(ODRIVE, (), 1e-6, 0.05, 1e-3, id="odrive 0.6"),
        pytest.param(ODRIVE, V0_5, 1e-6, 0.05, 1e-3, id="odrive 0.5"),
        pytest.param(
            ODRIVE, [("node_id: 1,", "node_id: 1, zero_rad: 0.3,")], 1e-6, 0.05, 1e-3, id="odrive turned"
        ),
        pytest.param(CUBEMARS, (), 50 / 4095, 0.1, 2e-3, id="cubemars"),
        pytest.param(
            *(CUBEMARS, [("motor_id: 1,", "motor_id: 1, zero_rad: 0.4,")], 50 / 4095, 0.1, 2e-3),
            id="cubemars turned",
        ),
        pytest.param(DAMIAO, (), 2 * 56 / 4095, 0.1, 2e-3, id="damiao"),
        pytest.param(MOTEUS, (), 1e-5, 0.05, 2e-3, id="moteus"),
        pytest.param(ROBSTRIDE, (), 2 * 120 / 65535, 0.05, 2e-3, id="robstride"),
    ],
)
def test_torques_are_sent_and_read_within_the_wire_resolution(
    make_robot, path, changes, drive_nm, read_nm, read_rad
):
    arm = make_robot(path, changes).start()
    measurement = arm.ticks(20, PUSH_NM)
    np.testing.assert_allclose(arm.drive_torque_nm, PUSH_NM, atol=drive_nm)
    np.testing.assert_allclose(measurement.joint_torque_nm, PUSH_NM, atol=read_nm)
    truth = arm.arm.plant.world.truth()
    since = measurement.joint_velocity_rad_s * (truth.time_s - measurement.encoder_at_s)
    np.testing.assert_allclose(
        measurement.joint_position_rad + since, truth.joint_position_rad, atol=read_rad
    )


@pytest.mark.parametrize(
    ("path", "frames"),
    [(CUBEMARS, [(1, 2), (2, 1), (3, 9)]), (DAMIAO, [(17, 0x12), (18, 0x11), (1, 0x11), (0, 0x13)])],
    ids=["cubemars", "damiao"],
)
def test_answers_under_another_motor_id_are_no_position(make_robot, path, frames):
    """Each by the id of its frame, and the id inside."""
    arm = make_robot(path).start()
    before = arm.tick().joint_position_rad
    arm.intrude(*((own, bytes((inside, 0x12, 0x34, 0, 0, 0, 0, 0))) for own, inside in frames))
    assert arm.tick().joint_position_rad == pytest.approx(before, abs=0.02)


ASKED = pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, ROBSTRIDE, MOTEUS], ids=lambda path: path.stem)


@pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, ROBSTRIDE, MOTEUS, ODRIVE], ids=lambda path: path.stem)
@pytest.mark.parametrize("late_ms", [0.0, 4.2])
def test_constantly_late_frames_are_as_old_as_they_are(make_robot, path, late_ms):
    """CAN frames carry no time: those that came 4.2 ms late from the start on once passed as fresh."""
    arm = make_robot(path)
    if late_ms:
        arm.inject_fault("motors", FaultKind.DELAY, delay_s=late_ms * 1e-3)
    arm.robot.configure()
    arm.ticks(10, None)
    for _ in range(30):
        measurement = arm.tick(None)
        for sampled_at_s in (measurement.encoder_at_s, measurement.torque_at_s):
            assert late_ms - 1e-6 <= 1e3 * (measurement.time_s - sampled_at_s) <= late_ms + 2.6


@ASKED
def test_answers_that_come_too_late_once_are_no_second_motor(make_robot, path):
    """A program that a busy machine delays by 55 ms while it configures its motors blames none of them."""
    arm = make_robot(path)
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=0.055, times=1)
    arm.robot.configure()
    arm.ticks(20, None)
    assert age_ms(arm.tick(None)) < 2.6


def age_ms(measurement):
    return 1e3 * (measurement.time_s - min(measurement.encoder_at_s, measurement.torque_at_s))


@ASKED
@pytest.mark.parametrize(("late_ms", "torque_nm"), [(1.5, None), (4.2, (0.5, 0.3, 0.1))], ids=["off", "on"])
def test_answers_that_become_late_are_as_old_as_their_requests(make_robot, path, late_ms, torque_nm):
    """They were dated by a delay that was measured before the run: 4.2 ms passed for 0.4."""
    arm = make_robot(path)
    arm.robot.configure()
    if torque_nm:
        arm.robot.activate()
    arm.ticks(20, torque_nm)
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=late_ms * 1e-3)
    arm.ticks(5, torque_nm)
    ages_ms = [age_ms(arm.tick(torque_nm)) for _ in range(50)]
    assert min(ages_ms) > late_ms - 1e-6
    assert max(ages_ms[10:]) < late_ms + 1.6
    arm.faults["motors"].clear()
    arm.ticks(10, torque_nm)
    assert max(age_ms(arm.tick(torque_nm)) for _ in range(20)) < 1.1


@ASKED
def test_refused_frame_counts_as_no_lost_answer(make_robot, path, monkeypatch):
    arm = make_robot(path).start()
    arm.ticks(5, PUSH_NM)
    line = arm.robot.buses["motors"].line
    send, refused = line.send, []

    def refuse_once(frame, deadline_s):
        if not refused:
            refused.append(frame)
            raise DeviceError("the adapter's buffer is full")
        send(frame, deadline_s)

    monkeypatch.setattr(line, "send", refuse_once)
    with pytest.raises(DeviceError, match="buffer is full"):
        arm.tick(PUSH_NM)
    arm.clock.sleep_until(arm.clock.now_s() + 1e-3)  # the rest of this tick
    arm.tick(PUSH_NM)
    assert max(age_ms(arm.tick(PUSH_NM)) for _ in range(10)) < 1.1


@ASKED
@pytest.mark.parametrize(("kind", "oldest_ms"), [(FaultKind.DUPLICATE, 1.1), (FaultKind.DROP, 4.1)])
def test_doubled_or_lost_answer_makes_later_ones_no_older(make_robot, path, kind, oldest_ms):
    arm = make_robot(path).start()
    arm.ticks(5)
    for _ in range(5):
        arm.inject_fault("motors", kind, device=2, times=1)
        assert max(age_ms(arm.tick()) for _ in range(10)) < oldest_ms
        assert max(age_ms(arm.tick()) for _ in range(10)) < 1.1
    assert not arm.problem


@ASKED
def test_torque_off_is_confirmed_though_every_answer_is_doubled(make_robot, path):
    """The answers before and after the motor went off arrived in one batch, and none of them counted."""
    arm = make_robot(path).start()
    arm.inject_fault("motors", FaultKind.DUPLICATE)
    arm.ticks(5, PUSH_NM)
    assert not arm.problem
    arm.robot.deactivate()
    assert not any(getattr(node, "enabled", False) for node in arm.motors)


@ASKED
def test_doubled_answer_before_activation_is_no_second_motor(make_robot, path):
    arm = make_robot(path)
    arm.robot.configure()
    arm.inject_fault("motors", FaultKind.DUPLICATE, device=2, times=1)
    arm.ticks(5, None)
    arm.robot.activate()


@ASKED
def test_answers_from_before_a_wait_are_as_old_as_the_wait(make_robot, path):
    """A clock that is set back makes the loop wait until it has caught up: 21 ms passed for 1."""
    arm = make_robot(path).start()
    arm.ticks(20)
    now_s, sleep_until = arm.clock.now_s, arm.clock.sleep_until
    arm.clock.now_s = lambda: now_s() - 0.02
    arm.clock.sleep_until = lambda time_s: sleep_until(time_s + 0.02)
    arm.robot.write(Command(np.zeros(3)), arm.clock.now_s())
    sleep_until(now_s() + 0.02)
    assert 20.0 < age_ms(arm.tick()) < 21.1
    assert max(age_ms(arm.tick()) for _ in range(20)) < 2.1


@ASKED
@pytest.mark.parametrize("kind", [FaultKind.DROP, FaultKind.DUPLICATE, FaultKind.DELAY, FaultKind.CORRUPT])
def test_lost_doubled_and_late_answers_refuse_no_activation(make_robot, path, kind):
    """With a fault in every hundredth answer, up to 30 % of activations failed."""
    arm = make_robot(path)
    arm.inject_fault("motors", kind, probability=0.02, delay_s=3e-3)
    arm.robot.configure()
    for _ in range(5):
        arm.robot.activate()
        arm.ticks(3)
        arm.robot.deactivate()


@ASKED
@pytest.mark.parametrize("when", ["before", "after"])
def test_two_motors_with_one_id_are_refused(make_robot, path, when):
    """The second stands elsewhere: the arm was armed with its position."""
    arm = make_robot(path)
    start = arm.robot.configure
    if when == "after":
        arm.robot.configure()
        start = arm.robot.activate
    add_twin(arm)
    with pytest.raises(DeviceError, match=r"joint 1 \(motor 1\): answers more often than .* asked: do two"):
        start()
    assert not any(getattr(node, "enabled", False) for node in arm.motors)


@ASKED
def test_two_motors_with_one_id_are_refused_though_their_first_answers_are_lost(make_robot, path):
    arm = make_robot(path)
    add_twin(arm)
    arm.inject_fault("motors", FaultKind.DROP, device=1, times=2)
    with pytest.raises(DeviceError, match=r"joint 1 \(motor 1\): answers more often than .* asked: do two"):
        arm.robot.configure()


@ASKED
@pytest.mark.parametrize("joint", [1, 2])
def test_duplicate_motor_id_during_a_run_is_a_fault_that_is_named(make_robot, path, joint):
    """The guard stopped the arm because samples were old, and named the id last."""
    arm = make_robot(path).start()
    before_rad = arm.ticks(20, PUSH_NM).joint_position_rad
    add_twin(arm, joint)

    def is_fault(measurement):
        assert measurement.joint_position_rad == pytest.approx(before_rad, abs=0.2)
        return measurement.encoder_status is Status.FAULT

    assert arm.ticks_until(is_fault, most=5) <= 4
    said = "joint 1 (motor 1): answers more often than it is asked, with different states: do two motors"
    assert said in arm.robot.bus_errors["motors"]


@ASKED
def test_problem_before_a_valid_answer_is_no_cause_of_a_later_silence(make_robot, path):
    arm = make_robot(path).start()
    nodes = arm.arm.wires["motors"]._nodes
    add_twin(arm)
    arm.tick()
    arm.arm.wires["motors"]._nodes = nodes
    arm.ticks(20)
    arm.inject_fault("motors", FaultKind.DROP, device=1)
    arm.ticks(6)
    assert "joint 1 (motor 1): nothing valid" in arm.problem
    assert "do two motors" not in arm.problem


def test_damiao_motors_with_the_factory_master_id_are_named(make_robot):
    arm = make_robot(DAMIAO)
    for motor in arm.motors:
        motor._host_id = 0
    ids = r"set the master id of each motor \(0x011, 0x012, 0x013 according to the rob"
    said = f"no answer .*; received frames with the ids 0x000: {ids}"
    with pytest.raises(DeviceError, match=said):
        arm.robot.buses["motors"].configure()
    findings = arm.robot.buses["motors"].examine()
    (foreign,) = [finding for finding in findings if "not in the robot file: 0x000" in finding.text]
    assert "set the master id" in foreign.remedy


@pytest.mark.parametrize(
    ("path", "fail", "said"),
    [
        (CUBEMARS, lambda motor: setattr(motor, "error", 5), "encoder fault"),
        (ROBSTRIDE, lambda motor: setattr(motor, "error", 1 << 3), "encoder fault"),
        (ODRIVE, lambda motor: motor._disarm(1 << 26), "SPINOUT_DETECTED"),
    ],
    ids=["cubemars", "robstride", "odrive"],
)
def test_encoder_fault_invalidates_the_velocity(make_robot, path, fail, said):
    arm = make_robot(path).start()
    fail(arm.motors[0])
    most = 12 if path is ODRIVE else 3
    arm.ticks_until(lambda measurement: measurement.encoder_status is Status.FAULT, most)
    assert said in arm.robot.bus_errors["motors"]


@pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, MOTEUS, ROBSTRIDE])
def test_last_command_is_repeated_for_the_watchdog_time_only(make_robot, path):
    """The motors' own watchdogs do not help: each request for the state would restart them."""
    arm = make_robot(path).start()
    arm.ticks(3, PUSH_NM)
    arm.ticks(round(0.08 / arm.period_s), None)
    np.testing.assert_allclose(arm.drive_torque_nm, PUSH_NM, atol=0.05)
    arm.ticks(round(0.04 / arm.period_s), None)
    np.testing.assert_allclose(arm.drive_torque_nm, 0.0, atol=0.03)
