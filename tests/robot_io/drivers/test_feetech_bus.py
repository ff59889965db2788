"""Feetech servos: settings, refusals, and torque without a torque mode."""

import json
import re
import runpy
import sys
from contextlib import nullcontext
from math import pi

import numpy as np
import pytest

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.drivers.feetech import lerobot
from palpate.robot_io.drivers.feetech.feedback import FeetechFeedback, PlausibilityFilter
from palpate.robot_io.drivers.feetech.lerobot import main, read_calibration
from palpate.robot_io.errors import DeviceError, InputError, LifecycleError
from palpate.robot_io.types import Command, Status
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import SO101

STALL_NM, NO_LOAD_RAD_S = 30 * 0.0980665, pi / 3 / 0.222
OFFSET, LEVEL, P_GAIN, TORQUE_ON, GOAL, LIMIT = 31, 8, 21, 40, 42, 48  # addresses


@pytest.fixture
def arm(make_robot):
    return make_robot(SO101)


def test_activation_sets_the_proportional_law_and_keeps_saved_values(arm):
    arm.start()
    for servo in arm.servos.values():
        told = [servo.get(place, 1) for place in (P_GAIN, 22, 23, 26, 27, 33, LEVEL)]
        assert told == [16, 0, 0, 0, 0, 0, 1]
        assert servo.get(TORQUE_ON, 1) == 1
        servo.reboot(arm.clock.now_s(), 0.0)
        assert [servo.get(place, 1) for place in (P_GAIN, 22, 26)] == [32, 32, 1]  # as its owner has it


@pytest.mark.parametrize(("address", "beside"), [(9, 100), (11, -100)], ids=["lowest", "highest"])
def test_calibrated_position_limits_make_no_torque(arm, address, beside):
    """LeRobot writes the ends of each joint's range; a servo beyond one would be driven back into it."""
    servo = arm.servos[4]
    arm.robot.configure()
    arm.hold()
    servo.put(address, servo.get(56) + beside)
    arm.robot.activate()
    arm.ticks(5)
    np.testing.assert_allclose(arm.drive_torque_nm, 0.0, atol=0.01)


def test_emulated_fault_ends_with_its_plan(arm):
    arm.start().inject_fault("motors", FaultKind.STUCK, device=2)
    arm.ticks(2)
    assert arm.servos[2].stuck
    arm.faults["motors"].clear()
    arm.ticks(2)
    assert not arm.servos[2].stuck


def test_holding_servos_stay_where_they_are(arm):
    arm.start()
    arm.ticks(20, (0.5, 0.3, 0.1))
    assert [arm.servos[one].get(GOAL) for one in (1, 5)] == [2048, 2048]
    arm.robot.deactivate()
    assert not any(servo.get(TORQUE_ON, 1) for servo in arm.servos.values())


def test_torque_is_a_goal_beside_the_joint(arm):
    """What the motors exert is what was commanded, as well as their makers keep what they state."""
    arm.start()
    arm.hold()
    draw = np.random.default_rng(3)
    for servo in arm.servos.values():
        servo.stall_nm *= draw.uniform(0.9, 1.1)
        servo.no_load_rad_s *= draw.uniform(0.9, 1.1)
        servo.duty_per_rad *= draw.uniform(0.9, 1.1)
    wanted_nm = np.array((1.5, -0.8, 0.4))
    measured = arm.ticks(5, wanted_nm)
    np.testing.assert_allclose(arm.drive_torque_nm, wanted_nm, rtol=0.2)
    np.testing.assert_allclose(measured.joint_torque_nm, arm.drive_torque_nm, rtol=0.1, atol=0.01)


@pytest.mark.parametrize(("count", "sign"), [(2, -1.0), (4093, 1.0)], ids=["lowest", "highest"])
def test_goals_stay_within_the_count_range_and_clipping_is_reported(arm, count, sign):
    arm.start()
    arm.hold()
    arm.ticks(2)
    motors = arm.robot.buses["motors"]
    feedback, asked_at_s = motors.sample
    position, speed = list(feedback.position), list(feedback.speed)
    position[1], speed[1] = count, 0
    motors.sample = feedback._replace(position=position, speed=speed), asked_at_s
    sent_nm = motors.stage(np.array([0.0, sign * np.sign(motors._joints.steps[0, 1]), 0.0]))
    _, _, torque_per_count_nm = motors._laws[1]
    assert abs(sent_nm[1]) == pytest.approx(2 * abs(torque_per_count_nm))


def test_load_of_a_turning_motor_is_no_torque(arm):
    """Its duty cycle holds what the speed takes; that is taken off."""
    arm.start()
    arm.ticks(50, (0.9, 0.4, 0.1))
    for _ in range(20):
        measurement = arm.tick((0.9, 0.4, 0.1))
        truth_nm = arm.arm.plant.world.truth().drive_torque_nm
        np.testing.assert_allclose(measurement.joint_torque_nm, truth_nm, atol=0.15)
    assert np.abs(measurement.joint_velocity_rad_s).max() > 0.1


def test_joints_stay_near_their_position_without_commands(arm):
    """There is no watchdog: the program may die, and the arm stands."""
    arm.start()
    let_go = arm.hold()
    before_rad = arm.ticks(5, (0.45, 0.15, 0.0)).joint_position_rad
    let_go()
    arm.clock.sleep_until(arm.clock.now_s() + 1.0)
    truth = arm.arm.plant.world.truth()
    assert np.abs(truth.joint_velocity_rad_s).max() < 0.01
    # 0.45 N m and the arm's weight, 0.3 N m, over 7.8 N m/rad.
    np.testing.assert_allclose(truth.joint_position_rad, before_rad, atol=0.1)


def test_no_torque_before_the_first_reading(arm):
    arm.robot.configure()
    arm.robot.buses["motors"]._powered = True
    arm.robot.buses["motors"].sample = None
    with pytest.raises(LifecycleError, match="starts from their positions"):
        arm.robot.torque.stage_torque(np.zeros(3))


def test_nonfinite_torque_is_refused(arm):
    arm.start()
    with pytest.raises(InputError, match="not a number"):
        arm.robot.torque.stage_torque(np.array((0.1, np.nan, 0.1)))


@pytest.mark.parametrize(("found", "refused"), [(85, False), (-85, True)])
def test_recalibrated_servo_is_refused(make_robot, found, refused):
    """Its positions mean other angles than the robot file says."""
    stated = "- {id: 3, model: STS3215-12V,"
    arm = make_robot(SO101, [(stated, f"{stated} homing_offset: 85,")])
    arm.servos[3].put(OFFSET, abs(found) | (0x800 if found < 0 else 0))
    said = "homing offset of -85, but the robot file states 85"
    with pytest.raises(DeviceError, match=said) if refused else nullcontext():
        arm.robot.configure()


def test_read_only_servo_is_set_to_answer(arm):
    for servo in arm.servos.values():
        servo.put(LEVEL, 0, 1)
    arm.start()
    assert arm.tick().encoder_status is Status.OK


@pytest.mark.parametrize("echoes", [False, True])
def test_servo_with_a_voltage_error_is_present(arm, echoes):
    arm.arm.wires["motors"].echoes = echoes
    arm.servos[3].error = 1
    arm.robot.configure()
    arm.tick(None)
    assert "servo 3 (joint 2): error: input voltage" in arm.problem


def test_echoing_adapter_disturbs_nothing(arm):
    arm.arm.wires["motors"].echoes = True
    arm.start()
    assert arm.ticks(10, (0.2, 0.1, 0.0)).encoder_status is Status.OK


@pytest.mark.parametrize(
    ("place", "value", "problem"),
    [(LIMIT, 300, "torque limit is 300 instead of"), (GOAL, 77, "goal position is 77 instead of 18")],
)
def test_impossible_servo_value_is_a_damaged_answer(arm, place, value, problem):
    """Eight bits of checksum let one damaged answer in 256 pass."""
    arm.start()
    arm.tick()
    arm.tick(None)
    arm.servos[2].put(place, value)
    assert arm.tick(None).encoder_status is Status.STALE
    assert problem in arm.problem


def test_restart_between_two_readings_is_detected(arm):
    """At stall its torque limit would be 1000, which is what a servo sets when it restarts."""
    arm.robot.configure()
    arm.tick(None)
    arm.servos[2].reboot(arm.clock.now_s(), 0.0)
    assert arm.tick(None).encoder_status is Status.FAULT
    assert "servo 2: torque limit is 1000 instead of 999; it has restarted" in arm.problem


@pytest.mark.parametrize(("moved", "jumps"), [(26, False), (27, True)])
@pytest.mark.parametrize("way", [1, -1])
def test_jump_beyond_the_fastest_motion_is_damage(moved, jumps, way):
    """10 ms at 1000 counts/s, and 16 counts; servo 1 stands still."""
    clock = SimulatedClock()
    plausibility = PlausibilityFilter(clock, dict.fromkeys((1, 2), (0, 0, 0, 999, 1)), 1000.0)

    def seen(position):
        still = (0, 0)
        return plausibility.problem(FeetechFeedback(still, still, (0, way * position), still, still, still))

    assert seen(100) is None
    clock.sleep_until(0.01)
    said = seen(100 + moved)
    assert said == (
        f"position of servo 2 jumped from {way * 100} to {way * (100 + moved)} counts" if jumps else None
    )
    clock.sleep_until(0.02)
    assert seen(110) is None


@pytest.mark.parametrize("counts_s", [7000, -7000, 32767])
def test_impossible_speed_is_a_fault(arm, counts_s):
    """Twice the no-load speed of 4.7 rad/s are 6150 counts/s."""
    arm.start()
    servo = arm.servos[3]
    servo._sample_position = lambda: servo.put(58, abs(counts_s) | (0x8000 if counts_s < 0 else 0))
    assert arm.ticks(2, None).encoder_status is Status.FAULT
    assert re.search(r"servo 3 .*: reports -?[0-9.]+ rad/s, but its maximum is 9.43 rad/s", arm.problem)


def test_impossible_jump_is_a_damaged_answer(arm):
    arm.start()
    servo = arm.servos[2]
    arm.tick()
    read = servo.read
    servo.read = lambda address, size: read(address, size)[:-10] + b"\x34\x02" + read(address, size)[-8:]
    assert arm.tick().encoder_status is Status.STALE
    assert "jumped from" in arm.problem
    del servo.read


@pytest.mark.parametrize(
    ("break_servo", "problem"),
    [
        (lambda servo: servo.put(TORQUE_ON, 0, 1), r"servo 1 \(holds\): has switched its torque off"),
        (lambda servo: servo.fail(), r"servo 1 \(holds\): error: overload"),
        (lambda servo: servo.put(GOAL, 1000), r"servo 1: goal position is 1000 instead of 2048"),
        (lambda servo: servo.put(LIMIT, 900), r"servo 1: torque limit is 900"),
    ],
    ids=["off", "overloaded", "other goal", "other limit"],
)
def test_holding_servo_is_monitored_like_the_joints(arm, break_servo, problem):
    arm.start()
    break_servo(arm.servos[1])
    arm.ticks(2)
    assert re.search(problem, arm.problem)


@pytest.mark.parametrize(
    ("torque_nm", "last"), [(1.2, 1.2 / STALL_NM + 0.5 / NO_LOAD_RAD_S), (0.1, 0.1)], ids=["load", "least"]
)
def test_each_servo_has_the_torque_limit_of_its_load(make_robot, torque_nm, last):
    """Torque, and what its speed takes beside it; those that hold stand still."""
    speed_rad_s = 0.5 if torque_nm > 1.0 else 0.01
    changes = [("velocity_rad_s: [3.0, 3.0, 3.0]", f"velocity_rad_s: [3.0, 1.0, {speed_rad_s}]")]
    changes += [("torque_nm: [2.0, 2.0, 1.2]", f"torque_nm: [2.0, 2.0, {torque_nm}]")]
    arm = make_robot(SO101, changes)
    arm.robot.configure()
    at_stall = ["stall torque" in finding.text for finding in arm.robot.buses["motors"].examine()]
    assert at_stall == [True, *4 * [False]]
    duty = {2: 1.0, 3: 2.0 / STALL_NM + 1.0 / NO_LOAD_RAD_S, 4: last}
    for servo_id, share in (duty | dict.fromkeys((1, 5), 2.0 / STALL_NM)).items():
        assert arm.servos[servo_id].get(LIMIT) == pytest.approx(1000 * share, abs=1)


def test_constantly_late_answers_are_as_old_as_their_requests(arm):
    arm.start()
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=0.009)
    seen = 0
    for _ in range(30):
        measurement = arm.tick(None)
        seen += measurement.encoder_status is Status.OK
        if np.isfinite(measurement.encoder_at_s):
            assert measurement.time_s - measurement.encoder_at_s >= -1e-9
            truth = arm.arm.plant.world.truth()
            assert np.abs(measurement.joint_position_rad - truth.joint_position_rad).max() < 0.05
    assert seen


def test_goal_of_an_old_sample_is_relative_to_the_current_joint(arm):
    """Thrown at 3 rad/s and coasting, the arm turns by 0.03 rad while a sample gets 9 ms old: 0.2 N m."""
    arm.start()
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=0.009)
    arm.ticks(15, (1.5, 0.7, 0.3))
    arm.ticks(5)
    for _ in range(5):
        measurement = arm.tick(None)
        sent = arm.robot.write(Command(np.zeros(3)), arm.clock.now_s())
        arm.clock.sleep_until(arm.clock.now_s() + 0.5 * arm.period_s)
        # Relative to the old sample, the goal would be wrong by this torque. A busy machine delays answers.
        age_s = measurement.time_s - measurement.encoder_at_s
        by_age_nm = 0.2 / 0.03 * measurement.joint_velocity_rad_s[0] * age_s
        np.testing.assert_allclose(arm.drive_torque_nm, sent.joint_torque_nm, atol=0.5 * by_age_nm)
    assert measurement.joint_velocity_rad_s[0] > 2.0
    assert measurement.time_s - measurement.encoder_at_s > 0.008


def test_arm_whose_answers_are_lost_comes_to_rest(arm):
    """Zero torque was a goal that moved on at the last known speed: up to the stops, with all the torque."""
    arm.start()
    assert arm.ticks(40, (0.0, 0.0, 0.8)).joint_velocity_rad_s[0] > 1.0
    arm.inject_fault("motors", FaultKind.DROP)
    arm.ticks(75)
    before_rad = arm.arm.plant.world.truth().joint_position_rad
    arm.ticks(75)
    truth = arm.arm.plant.world.truth()
    np.testing.assert_allclose(truth.joint_position_rad, before_rad, atol=0.01)


CALIBRATION = {
    "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": -85, "range_min": 850, "range_max": 3246},
    "elbow_flex": {"id": 3, "drive_mode": 1, "homing_offset": 1020, "range_min": 0, "range_max": 4095},
}


def test_lerobot_calibration_becomes_lines_of_a_robot_file(tmp_path, capsys, monkeypatch):
    path = tmp_path / "follower.json"
    path.write_text(json.dumps(CALIBRATION), encoding="utf-8")
    motors = read_calibration(path)
    assert motors["shoulder_lift"].zero_rad == pytest.approx(-pi)  # 2048 is the middle
    assert main([str(path)]) == 0
    said = capsys.readouterr().out
    assert "- {id: 2, model: STS3215-12V, zero_rad: -3.14159, homing_offset: -85}   # shoulder_lift" in said
    assert "- {id: 3, model: STS3215-12V, reversed: true, zero_rad: 3.14083, homing_offset: 1020}" in said
    for arguments, code in (([str(path)], 0), ([], 2), ([str(path)] * 2, 2)):
        monkeypatch.setattr(sys, "argv", ["lerobot", *arguments])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(lerobot.__file__, run_name="__main__")
        assert ended.value.code == code
        assert ("usage: python -m" in capsys.readouterr().err) is (code == 2)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "not a LeRobot calibration"),
        ("[1]", "dictionary"),
        ("{}", "at least 1 item"),
        ("[" * 100_000, "recursion"),
        (json.dumps({"a": CALIBRATION["elbow_flex"] | {"range_min": 4095}}), "range_min 4095 is not below"),
        (json.dumps({"a": CALIBRATION["elbow_flex"], "b": CALIBRATION["elbow_flex"]}), "id 3 appears twice"),
        (json.dumps({"a": CALIBRATION["elbow_flex"] | {"id": True}}), "a.id"),
        ('{"a": {"id": 1}}', "a.drive_mode"),
        (json.dumps({"a": CALIBRATION["elbow_flex"] | {"range_max": 5000}}), "a.range_max"),
    ],
)
def test_invalid_calibration_file_is_one_line(tmp_path, capsys, text, problem):
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=problem):
        read_calibration(path)
    assert main([str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
