"""Dynamixel driver against emulated servos: setup, readings, commands, refusals and faults."""

import numpy as np
import pytest

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.dynamixel.bus import DynamixelBus
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, InputError, LifecycleError
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import dynamixel_servo as table
from tests.robot_io.drivers.dynamixel_setup import READ_S, ROBOT_FILE, TICK_S, dynamixel_setup

FAST, PLAIN = {"fast_sync_read": True}, {"fast_sync_read": False}
BOTH = pytest.mark.parametrize("way", [FAST, PLAIN], ids=["fast", "plain"])
WATCHDOG_S = 0.06


@pytest.fixture(params=[FAST, PLAIN], ids=["fast", "plain"])
def active(request):
    with dynamixel_setup(**request.param) as setup:
        setup.start()
        setup.tick()
        yield setup


# Setting up


def test_activation_writes_the_settings_of_the_robot_file():
    with dynamixel_setup(return_delay_s=40e-6, watchdog_s=0.1) as setup:
        setup.start()
        for servo in setup.line.servos.values():
            assert servo.memory.get(table.OPERATING_MODE) == 0
            assert servo.memory.get(table.RETURN_DELAY) == 20
            assert servo.memory.get(table.BUS_WATCHDOG) == 5
            assert servo.memory.get(table.TORQUE_ENABLE) == 1
            assert servo.memory.get(table.GOAL_CURRENT) == 0


def test_configuring_powers_nothing():
    with dynamixel_setup() as setup:
        setup.bus.configure()
        assert not any(servo.memory.get(table.TORQUE_ENABLE) for servo in setup.line.servos.values())
        with pytest.raises(LifecycleError):
            setup.torque.stage_torque(np.zeros(3))


def test_older_firmware_uses_the_plain_read():
    with dynamixel_setup(bolted={3: {"firmware": 44}}) as setup:
        setup.start()
        assert np.isfinite(setup.tick().position_rad).all()


def test_stale_goal_is_not_followed_after_activation():
    with dynamixel_setup() as setup:
        for servo in setup.line.servos.values():
            servo.memory.put(table.OPERATING_MODE, 0)
            servo.memory.put(table.GOAL_CURRENT, 300)
        setup.start()
        setup.read()
        assert (setup.exerted_nm() == 0).all()


@pytest.mark.parametrize("level", [0, 1])
def test_silent_servo_is_set_to_answer(level):
    with dynamixel_setup() as setup:
        for servo in setup.line.servos.values():
            servo.memory.put(table.STATUS_RETURN_LEVEL, level)
        setup.start()
        assert setup.tick() is not None


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"servos": [{"id": 1, "model": "XM430-W999"}]}, "XM430-W350"),
        ({"servos": [{"id": 1, "model": "XM430-W350"}] * 2}, "twice"),
        ({"servos": [{"id": 1, "model": "XM430-W350"}, {"id": 2, "model": "XL330-M288"}]}, "two buses"),
        ({"baud_rate": 1234}, "57600"),
    ],
)
def test_invalid_settings_are_refused(settings, problem):
    own = {"port": "none", "servos": [{"id": 1, "model": "XM430-W350"}]} | settings
    context = DriverContext(SimulatedClock(), load_robot_file(ROBOT_FILE), section=("buses", "motors"))
    with pytest.raises(InputError, match=problem):
        DynamixelBus(own, context)


# Reading and commanding


def test_positions_are_the_arm_s_for_any_mounting():
    servos = [
        {"id": 1, "model": "XM540-W270", "zero_rad": 0.3},
        {"id": 2, "model": "XM540-W270", "zero_rad": -2.0, "reversed": True},
        {"id": 3, "model": "XM430-W350", "zero_rad": 6.0},
    ]
    with dynamixel_setup(servos=servos) as setup:
        setup.bus.configure()
        np.testing.assert_allclose(setup.read().position_rad, setup.robot_file.home_rad, atol=0.001)


@BOTH
def test_negative_values_are_signed(way):
    """Minus one in a current beside minus three in a velocity is what byte stuffing is for."""
    with dynamixel_setup(**way) as setup:
        setup.start()
        memory = setup.line.servos[1].memory
        setup.line.servos[1]._sample_position = lambda: None
        memory.put(table.PRESENT_CURRENT, -1)
        memory.put(table.PRESENT_VELOCITY, -3)
        memory.put(table.PRESENT_POSITION, -1)
        sample = setup.read()
        assert sample.velocity_rad_s[0] == pytest.approx(-3 * 0.229 * 2 * np.pi / 60)
        assert sample.torque_nm[0] == pytest.approx(-0.00269 * 10.6 / 4.4)
        step_rad = 2 * np.pi / 4096
        assert (sample.position_rad[0] - np.pi + step_rad + np.pi) % (2 * np.pi) == pytest.approx(np.pi)


def test_calibrated_torque_constant_is_used():
    constant = {1: {"torque_constant_nm_a": 2.0}}
    with dynamixel_setup(bolted=constant) as setup:  # the servo is weaker than its data sheet says
        setup.start()
        setup.tick((1.0, 0.0, 0.0))
        setup.clock.sleep_until(setup.clock.now_s() + TICK_S)
        assert setup.exerted_nm()[0] == pytest.approx(1.0 * 2.0 / (10.6 / 4.4), rel=0.01)


def test_configured_current_limit_is_preserved():
    with dynamixel_setup() as setup:
        setup.line.servos[3].memory.put(table.CURRENT_LIMIT, 100)
        setup.start()
        sent = setup.torque.stage_torque(np.full(3, 100.0))
        assert sent[2] == pytest.approx(100 * 0.00269 * 4.1 / 2.3)
        setup.tick((0.0, 0.0, 100.0))
        setup.clock.sleep_until(setup.clock.now_s() + TICK_S)
        assert setup.exerted_nm()[2] == pytest.approx(sent[2])


def test_samples_carry_the_request_time_and_cost_the_bus_time(active):
    before_s = active.clock.now_s() + TICK_S
    assert active.read().sampled_at_s == pytest.approx(before_s)
    assert active.clock.now_s() - before_s < 0.4e-3  # at 4 Mbit/s


# Faults on the wire: nothing wrong is accepted, nothing old is shown as new


@pytest.mark.parametrize("kind", ["drop", "corrupt", "delay", "wrong_id"])
def test_bad_answer_costs_one_tick(active, kind):
    for servo_id in (1, 2, 3):
        good = active.tick()
        active.befall(kind=kind, device=servo_id, times=1, delay_s=0.01 if kind == "delay" else 0.0)
        started_s = active.clock.now_s() + TICK_S
        said = rf"servo {servo_id} did not answer in time" if kind == "drop" else "servo"
        with pytest.raises(DeviceTimeoutError, match=said):
            active.tick()
        assert active.clock.now_s() - started_s <= READ_S + 1e-9
        assert active.bus.position.sampled_at_s == good.sampled_at_s
        active.wait(0.02)
        assert active.tick().sampled_at_s > good.sampled_at_s


def test_unordered_answers_are_sorted_by_id_or_refused(active):
    home = active.tick((0.0, 0.0, 0.0)).position_rad
    active.befall(kind="reorder", device=1, times=1)
    try:
        position = active.read().position_rad
    except DeviceTimeoutError:  # within a fast answer, the order is part of what must be right
        position = active.read().position_rad
    np.testing.assert_allclose(position, home, atol=0.05)


# Faults of the servos: named, and nothing that they show is believed


def test_nonfatal_hardware_error_is_a_fault_of_the_drives_alone(active):
    active.line.servos[3].memory.put(table.SHUTDOWN, 0)
    active.befall(kind="alert", device=3, times=1)
    with pytest.raises(DeviceError, match=r"servo 3.*overload"):
        active.tick()
    assert active.torque.read_torque().status is Status.FAULT
    assert active.encoder.read_position().status is Status.OK
    assert active.encoder.read_position().sampled_at_s == active.bus.torque.sampled_at_s


def test_hardware_error_keeps_the_torque_off_until_a_reboot(active):
    active.befall(kind="alert", device=2, times=1)
    with pytest.raises(DeviceError):
        active.tick()
    active.torque.deactivate()
    active.bus.activate()
    with pytest.raises(DeviceError, match=r"servo 2: setting torque enable.*overload; it must be rebooted"):
        active.torque.activate()


def test_servo_that_stays_off_silently_is_named_with_its_error():
    """Some firmware takes the write, says that all is well but for the alert bit, and stays off."""
    with dynamixel_setup() as setup:
        servo = setup.line.servos[2]
        servo.fail()
        write = servo.write
        servo.write = lambda address, data: 0 if address == table.TORQUE_ENABLE else write(address, data)
        setup.bus.configure()
        setup.bus.activate()
        with pytest.raises(DeviceError, match=r"servo 2: torque enable is 0 .*overload; it must be rebooted"):
            setup.torque.activate()


# Letting go


def test_servos_without_commands_disable_torque_until_reactivated(active):
    active.tick((0.5, 0.3, 0.1))
    active.wait(WATCHDOG_S - 0.005)
    assert (active.exerted_nm() != 0).all()
    active.wait(0.01)
    assert (active.exerted_nm() == 0).all()
    with pytest.raises(DeviceError, match=r"servo 1 \(joint 1\): its bus watchdog has fired"):
        active.read()
    active.torque.deactivate()
    active.read()
    active.bus.activate()
    active.torque.activate()
    active.tick((0.5, 0.3, 0.1))
    active.tick((0.5, 0.3, 0.1))
    assert (active.exerted_nm() != 0).all()


def test_switching_off_works_on_a_bad_line(active):
    active.befall(kind="corrupt", probability=0.3)
    active.torque.deactivate()
    assert not any(servo.memory.get(table.TORQUE_ENABLE) for servo in active.line.servos.values())
    assert (active.exerted_nm() == 0).all()
    active.torque.deactivate()


def test_unconfirmed_switch_off_is_an_error_with_consequences(active):
    active.befall(kind="drop", device=2)
    with pytest.raises(DeviceError, match=r"may still be on: servo 2.*watchdog switches it off 0.06 s"):
        active.torque.deactivate()


@BOTH
def test_failed_port_can_be_used_again(way, tmp_path):
    with dynamixel_setup(link=tmp_path / "port", **way) as setup:
        setup.start()
        setup.tick()
        setup.line.close()
        with pytest.raises(DeviceError, match="unplugged"):
            setup.read()
        for _ in range(2):  # a second try that did nothing must not pass for one that worked
            with pytest.raises(DeviceError, match=r"unplugged.*: the torque may still be on"):
                setup.torque.deactivate()
        with pytest.raises(DeviceError):
            setup.bus.configure()
        setup.plug_in()
        with pytest.raises(DeviceError, match=r"unplugged|not open"):
            setup.read()  # not by itself: a loose connector is not to be hidden
        setup.start()
        assert np.isfinite(setup.tick().position_rad).all()


def test_port_has_one_owner(active):
    with dynamixel_setup(port=active.line.path) as other, pytest.raises(DeviceError, match="be opened"):
        other.bus.configure()
    assert active.tick() is not None


def test_velocity_by_difference_follows_after_a_reading_without_a_sample():
    with dynamixel_setup(encoder={"velocity": "difference", "bandwidth_hz": 1000.0}) as setup:
        assert setup.encoder.read_velocity().status is Status.STALE  # as after a first poll that timed out
        setup.start()
        for _ in range(5):
            sample = setup.read()
            velocity = setup.encoder.read_velocity()
        assert velocity.status is Status.OK
        np.testing.assert_allclose(velocity.value, sample.velocity_rad_s, atol=1.6)  # one count in 1 ms
