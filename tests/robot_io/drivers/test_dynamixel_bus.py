"""Dynamixel driver against emulated servos: setup, readings, commands, refusals and faults."""

import re
from contextlib import closing

import numpy as np
import pytest

from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import DeviceError, LifecycleError
from palpate.robot_io.robot import build_robot
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from palpate.sim_backend.emulators import dynamixel_servo as table
from palpate.sim_backend.emulators.wiring import wire_up
from palpate.sim_backend.scenario import load_scenario
from tests.wire.parts import DYNAMIXEL, READ_SHARE

FAST, PLAIN = (), [("fast_sync_read: true", "fast_sync_read: false")]
WATCHDOG_S = 0.06
TORQUE_NM = (0.5, 0.3, 0.1)


@pytest.fixture
def arm(make_robot):
    return make_robot(DYNAMIXEL)


@pytest.fixture(params=[FAST, PLAIN], ids=["fast", "plain"])
def active(request, make_robot):
    return make_robot(DYNAMIXEL, request.param).start()


def wait(arm, time_s):
    arm.clock.sleep_until(arm.clock.now_s() + time_s)


# Setting up


def test_activation_writes_the_settings_of_the_robot_file(make_robot):
    settings = [("return_delay_s: 0.0 ", "return_delay_s: 0.00004 "), ("watchdog_s: 0.06", "watchdog_s: 0.1")]
    for servo in make_robot(DYNAMIXEL, settings).start().servos.values():
        assert servo.memory.get(table.OPERATING_MODE) == 0
        assert servo.memory.get(table.RETURN_DELAY) == 20
        assert servo.memory.get(table.BUS_WATCHDOG) == 5
        assert servo.memory.get(table.TORQUE_ENABLE) == 1
        assert servo.memory.get(table.GOAL_CURRENT) == 0


def test_configuring_powers_nothing(arm):
    arm.robot.configure()
    assert not any(servo.memory.get(table.TORQUE_ENABLE) for servo in arm.servos.values())
    with pytest.raises(LifecycleError):
        arm.robot.torque.stage_torque(np.zeros(3))


def test_older_firmware_uses_the_plain_read(arm):
    arm.servos[3].memory.put(6, 44)
    assert np.isfinite(arm.start().tick().joint_position_rad).all()


def test_stale_goal_is_not_followed_after_activation(arm):
    for servo in arm.servos.values():
        servo.memory.put(table.OPERATING_MODE, 0)
        servo.memory.put(table.GOAL_CURRENT, 300)
    arm.robot.configure()
    arm.robot.activate()
    arm.tick(None)
    assert (arm.drive_torque_nm == 0).all()


@pytest.mark.parametrize("level", [0, 1])
def test_silent_servo_is_set_to_answer(arm, level):
    for servo in arm.servos.values():
        servo.memory.put(table.STATUS_RETURN_LEVEL, level)
    assert arm.start().tick().encoder_status is Status.OK


# Reading and commanding


def test_positions_are_the_arm_s_for_any_mounting(make_robot):
    zeros = [
        ("1, model: XM540-W270, zero_rad: 3.14159265", "1, model: XM540-W270, zero_rad: 0.3"),
        ("2, model: XM540-W270, zero_rad: 3.14159265", "2, model: XM540-W270, zero_rad: -2.0"),
        ("3, model: XM430-W350, zero_rad: 3.14159265", "3, model: XM430-W350, zero_rad: 6.0"),
    ]
    arm = make_robot(DYNAMIXEL, zeros)
    arm.robot.configure()
    np.testing.assert_allclose(arm.tick(None).joint_position_rad, arm.arm.robot_file.home_rad, atol=0.001)


def test_negative_values_are_signed(active):
    """Minus one in a current beside minus three in a velocity is what byte stuffing is for."""
    memory = active.servos[1].memory
    active.servos[1]._sample_position = lambda: None
    memory.put(table.PRESENT_CURRENT, -1)
    memory.put(table.PRESENT_VELOCITY, -3)
    memory.put(table.PRESENT_POSITION, -1)
    measurement = active.tick(None)
    assert measurement.joint_velocity_rad_s[0] == pytest.approx(-3 * 0.229 * 2 * np.pi / 60)
    assert measurement.joint_torque_nm[0] == pytest.approx(-0.00269 * 10.6 / 4.4)
    step_rad = 2 * np.pi / 4096
    assert (measurement.joint_position_rad[0] + step_rad) % (2 * np.pi) == pytest.approx(np.pi)


def test_calibrated_torque_constant_is_used(make_robot):
    stated = "{id: 1, model: XM540-W270,"
    arm = make_robot(DYNAMIXEL, [(stated, f"{stated} torque_constant_nm_a: 2.0,")]).start()
    arm.ticks(2, (1.0, 0.0, 0.0))
    assert arm.servos[1].memory.get(table.GOAL_CURRENT) == round(1.0 / 2.0 / 0.00269)


def test_configured_current_limit_is_preserved(arm):
    arm.servos[3].memory.put(table.CURRENT_LIMIT, 100)
    arm.start()
    sent_nm = arm.robot.torque.stage_torque(np.full(3, 100.0))
    assert sent_nm[2] == pytest.approx(100 * 0.00269 * 4.1 / 2.3)
    arm.ticks(2, (0.0, 0.0, 100.0))
    assert arm.drive_torque_nm[2] == pytest.approx(sent_nm[2])


def test_samples_carry_the_request_time_and_cost_the_bus_time(active):
    before_s = active.clock.now_s() + active.period_s
    assert active.tick(None).encoder_at_s == pytest.approx(before_s)
    assert active.clock.now_s() - before_s < 0.4e-3  # at 4 Mbit/s


# Faults on the wire: nothing wrong is accepted, nothing old is shown as new


@pytest.mark.parametrize("kind", [FaultKind.DROP, FaultKind.CORRUPT, FaultKind.DELAY, FaultKind.WRONG_ID])
def test_bad_answer_costs_one_tick(active, kind):
    for servo_id in (1, 2, 3):
        good = active.tick(TORQUE_NM)
        delay_s = 0.01 if kind is FaultKind.DELAY else 0.0
        active.inject_fault("motors", kind, device=servo_id, times=1, delay_s=delay_s)
        started_s = active.clock.now_s() + active.period_s
        bad = active.tick(None)
        assert active.clock.now_s() - started_s <= READ_SHARE * active.period_s + 1e-9
        assert (bad.encoder_status, bad.encoder_at_s) == (Status.STALE, good.encoder_at_s)
        said = f"servo {servo_id} did not answer in time" if kind is FaultKind.DROP else "servo"
        assert said in active.robot.bus_delays["motors"]
        wait(active, 0.02)
        assert active.tick(TORQUE_NM).encoder_at_s > good.encoder_at_s


def test_unordered_answers_are_sorted_by_id_or_refused(active):
    home_rad = active.tick().joint_position_rad
    active.inject_fault("motors", FaultKind.REORDER, device=1, times=1)
    measurement = active.tick(None)
    if measurement.encoder_status is Status.STALE:  # a fast answer must be in order
        measurement = active.tick(None)
    assert measurement.encoder_status is Status.OK
    np.testing.assert_allclose(measurement.joint_position_rad, home_rad, atol=0.05)


# Faults of the servos: named, and nothing that they show is believed


def test_nonfatal_hardware_error_is_a_fault_of_the_drives_alone(active):
    active.servos[3].memory.put(table.SHUTDOWN, 0)
    active.inject_fault("motors", FaultKind.ALERT, device=3, times=1)
    measurement = active.tick(TORQUE_NM)
    assert re.search(r"servo 3.*overload", active.problem)
    assert (measurement.encoder_status, measurement.torque_status) == (Status.OK, Status.FAULT)
    assert measurement.encoder_at_s == measurement.torque_at_s


def test_hardware_error_keeps_the_torque_off_until_a_reboot(active):
    active.inject_fault("motors", FaultKind.ALERT, device=2, times=1)
    active.tick(TORQUE_NM)
    assert "servo 2" in active.problem
    active.robot.deactivate()
    with pytest.raises(DeviceError, match=r"servo 2: setting torque enable.*overload; to clear it"):
        active.robot.activate()


def test_servo_that_stays_off_silently_is_named_with_its_error(arm):
    """Some firmware takes the write, says that all is well but for the alert bit, and stays off."""
    servo = arm.servos[2]
    servo.fail()
    write = servo.write
    servo.write = lambda address, data: 0 if address == table.TORQUE_ENABLE else write(address, data)
    arm.robot.configure()
    with pytest.raises(DeviceError, match=r"servo 2: torque enable is 0 .*overload; to clear it"):
        arm.robot.activate()


# Letting go


def test_servos_without_commands_disable_torque_until_reactivated(active):
    active.tick(TORQUE_NM)
    wait(active, WATCHDOG_S - 0.005)
    assert (active.drive_torque_nm != 0).all()
    wait(active, 0.01)
    assert (active.drive_torque_nm == 0).all()
    active.tick(None)
    assert "servo 1 (joint 1): its bus watchdog has fired" in active.problem
    active.robot.deactivate()
    active.tick(None)
    assert not active.problem
    active.robot.activate()
    active.ticks(2, TORQUE_NM)
    assert (active.drive_torque_nm != 0).all()


def test_switching_off_works_on_a_bad_line(active):
    active.tick(TORQUE_NM)
    active.inject_fault("motors", FaultKind.CORRUPT, probability=0.3)
    active.robot.deactivate()
    assert not any(servo.memory.get(table.TORQUE_ENABLE) for servo in active.servos.values())
    assert (active.drive_torque_nm == 0).all()
    active.robot.deactivate()


def test_unconfirmed_switch_off_is_an_error_with_consequences(active):
    active.inject_fault("motors", FaultKind.DROP, device=2)
    with pytest.raises(
        DeviceError, match=r"may still be on: servo 2.*watchdog of each servo switches it off 0.06 s"
    ):
        active.robot.deactivate()


def test_failed_port_can_be_used_again(active):
    motors = active.robot.buses["motors"]
    active.arm.wires["motors"].close()
    active.tick(None)
    assert "unplugged" in active.problem
    for _ in range(2):  # a second try that did nothing must not pass for one that worked
        with pytest.raises(DeviceError, match=r"unplugged.*: the torque may still be on"):
            active.robot.deactivate()
    with pytest.raises(DeviceError):
        motors.configure()
    plugged_in = wire_up(active.arm.robot_file, load_scenario("default"), active.clock)
    with closing(plugged_in.emulator):
        motors._port.path = plugged_in.wires["motors"].path
        active.tick(None)
        assert re.search(r"unplugged|not open", active.problem)  # a loose connector is not to be hidden
        motors.configure()
        active.robot.activate()
        assert active.ticks(2).encoder_status is Status.OK
        active.robot.close()


def test_port_has_one_owner(active):
    with pytest.raises(DeviceError, match="be opened"):
        build_robot(active.arm.robot_file, DriverCatalog(), active.clock).configure()
    assert active.tick().encoder_status is Status.OK


def test_velocity_by_difference_follows_after_a_reading_without_a_sample(make_robot):
    arm = make_robot(DYNAMIXEL, [("velocity: servo}", "velocity: difference, bandwidth_hz: 1000.0}")])
    # As after a first poll that timed out.
    assert arm.robot.encoder.read_velocity().status is Status.STALE
    measurement = arm.start().tick()
    assert measurement.encoder_status is Status.OK
    reported_rad_s = arm.robot.buses["motors"].velocity.value
    # One count in 1 ms.
    np.testing.assert_allclose(measurement.joint_velocity_rad_s, reported_rad_s, atol=1.6)
