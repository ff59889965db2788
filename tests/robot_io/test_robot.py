"""Robot: valid samples, commands as sent, and recovery from every failure."""

import numpy as np
import pytest

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.errors import DeviceError, InputError, LifecycleError
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import Robot, RobotState
from palpate.robot_io.types import Command, Reading, Status
from tests.mock_robot import ROBOT_YAML, build_mock_robot, mock_bus, mock_robot_file

DT = 1e-3
UP, DOWN = ["bus", "encoder", "force", "torque"], ["torque", "force", "encoder", "bus"]


@pytest.fixture
def robot():
    robot = build_mock_robot()
    yield robot
    mock_bus(robot).faults.refuse.clear()
    robot.close()


@pytest.fixture
def bus(robot):
    return mock_bus(robot)


@pytest.fixture
def active(robot):
    robot.configure()
    robot.activate()
    tick(robot)
    return robot


def tick(robot):
    """The next tick's measurement."""
    robot.clock.sleep_until(robot.clock.now_s() + DT)
    return robot.read(robot.clock.now_s() + DT)


def steps(bus, step):
    """Which devices were taken through a lifecycle step, in order."""
    return [device for device, called in bus.calls if called == step]


class TestReading:
    def test_buses_are_polled_once_a_tick_and_samples_keep_their_times(self, active, bus):
        before = bus.polls
        tick(active)
        assert bus.polls == before + 1
        bus.faults.status["force"] = Status.SATURATED
        measurement = tick(active)
        now_s = active.clock.now_s()
        assert measurement.time_s == measurement.encoder_at_s == measurement.force_at_s == now_s
        assert measurement.force_status is Status.SATURATED
        assert measurement.encoder_status is Status.OK

    @pytest.mark.parametrize("device", ["encoder", "torque", "force"])
    def test_silent_device_is_stale_with_its_age_and_its_old_value(self, active, bus, device):
        bus.plant.hand_force_n = 3.0
        active.write(Command(np.array([0.5, 0.2, 0.1])), 1.0)
        fresh = tick(active)
        bus.faults.silent.add(device)
        for _ in range(5):
            old = tick(active)
        assert getattr(old, f"{device}_status") is Status.STALE
        assert getattr(old, f"{device}_at_s") == fresh.time_s
        assert old.time_s == pytest.approx(fresh.time_s + 5 * DT)
        same = {
            "encoder": np.array_equal(old.joint_position_rad, fresh.joint_position_rad),
            "torque": np.array_equal(old.joint_torque_nm, fresh.joint_torque_nm),
            "force": old.force_n == fresh.force_n != 0.0,
        }
        assert same[device]

    @pytest.mark.parametrize("ago_s", [0.0, DT], ids=["a repeat", "a late packet from the past"])
    def test_repeated_sample_is_stale(self, active, monkeypatch, ago_s):
        reading = Reading(np.array([1.0]), active.force.read_force().sampled_at_s - ago_s)
        monkeypatch.setattr(active.force, "read_force", lambda: reading)
        assert reading.status is Status.OK
        assert tick(active).force_status is Status.STALE

    def test_older_of_position_and_velocity_counts(self, active, monkeypatch):
        velocity = active.encoder.read_velocity()
        monkeypatch.setattr(active.encoder, "read_velocity", lambda: velocity)
        measurement = tick(active)
        assert measurement.encoder_at_s == velocity.sampled_at_s
        assert measurement.encoder_status is Status.STALE

    @pytest.mark.parametrize("part", ["read_position", "read_velocity"])
    def test_worse_of_position_and_velocity_counts(self, active, monkeypatch, part):
        read = getattr(active.encoder, part)
        monkeypatch.setattr(active.encoder, part, lambda: read()._replace(status=Status.FAULT))
        assert tick(active).encoder_status is Status.FAULT

    def test_preempted_poll_still_has_good_samples(self, active, bus, monkeypatch):
        """On the machine's clock another program may take the processor for longer than the age limit."""
        poll = bus.poll

        def preempted(deadline_s):
            active.clock.sleep_until(active.clock.now_s() + 20 * DT)
            poll(deadline_s)

        monkeypatch.setattr(bus, "poll", preempted)
        guard = Guard(mock_robot_file().limits, mock_robot_file().safe_state, 3)
        measurement = tick(active)
        assert measurement.encoder_at_s == pytest.approx(measurement.time_s + 20 * DT)
        assert measurement.encoder_status is measurement.force_status is Status.OK
        guard.watch(measurement)
        assert guard.tripped is None

    @pytest.mark.parametrize("device", ["encoder", "torque", "force"])
    def test_sample_from_after_the_poll_is_a_fault_with_its_cause(self, active, monkeypatch, device):
        part = getattr(active, device)
        name = {"encoder": "read_velocity", "torque": "read_torque", "force": "read_force"}[device]
        read = getattr(part, name)
        offset_s = 1.0
        for method in (name, "read_position") if device == "encoder" else (name,):
            read = getattr(part, method)
            monkeypatch.setattr(
                part, method, lambda read=read: read()._replace(sampled_at_s=read().sampled_at_s + offset_s)
            )
        assert getattr(tick(active), f"{device}_status") is Status.FAULT
        assert list(active.sample_errors) == [device]
        assert "sample from the future, 1 s ahead" in active.sample_errors[device]
        offset_s = 0.0  # and it is not remembered as the newest
        assert getattr(tick(active), f"{device}_status") is Status.OK
        assert active.sample_errors == {}

    def test_all_values_are_invalid_before_the_first_sample(self, robot, bus):
        bus.faults.silent |= {"encoder", "torque", "force"}
        robot.configure()
        measurement = tick(robot)
        assert np.isnan([*measurement.joint_position_rad, *measurement.joint_torque_nm]).all()
        assert np.isnan(measurement.force_n)
        assert measurement.encoder_at_s == measurement.force_at_s == -np.inf
        assert measurement.encoder_status is measurement.torque_status is Status.STALE

    def test_deadline_missed_by_the_bus_makes_samples_stale(self, active, bus):
        last = tick(active)
        bus.faults.poll_takes_s = 5 * DT
        measurement = tick(active)
        assert measurement.encoder_at_s == last.encoder_at_s
        assert measurement.encoder_status is measurement.force_status is Status.STALE
        assert active.clock.now_s() == pytest.approx(measurement.time_s + DT)  # the deadline
        assert active.bus_errors == {}
        assert active.bus_delays == {"world": "mock bus: no answer before the deadline"}
        bus.faults.poll_takes_s = 0.0
        tick(active)
        assert active.bus_delays == {}

    def test_failed_bus_marks_its_devices_faulty_with_a_reason(self, active, bus):
        bus.faults.unplugged = True
        measurement = tick(active)
        assert measurement.encoder_status is measurement.force_status is Status.FAULT
        assert active.bus_errors == {"world": "mock bus: unplugged"}
        bus.faults.unplugged = False
        assert tick(active).encoder_status is Status.OK
        assert active.bus_errors == {}

    def test_measurement_copies_driver_arrays(self, active, bus):
        measurement = tick(active)
        kept = measurement.joint_position_rad.copy()
        bus.readings["encoder"].value[:] = 77.0
        np.testing.assert_array_equal(measurement.joint_position_rad, kept)

    def test_reading_of_the_wrong_shape_is_an_error(self, active, monkeypatch):
        monkeypatch.setattr(active.encoder, "read_position", lambda: Reading(np.zeros(2), 1.0))
        with pytest.raises(DeviceError, match=r"encoder position has shape \(2,\), expected \(3,\)"):
            tick(active)

    def test_reading_needs_a_configured_robot(self, robot):
        with pytest.raises(
            LifecycleError, match="needs a robot that is configured or active, but this one is new"
        ):
            robot.read(0.0)


class TestWriting:
    def test_write_returns_the_torque_of_the_drives(self, active, bus):
        sent = active.write(Command(np.array([0.12345, 99.0, -0.0004])), 1.0)
        np.testing.assert_allclose(sent.joint_torque_nm, [0.123, 20.0, 0.0], atol=1e-12)
        np.testing.assert_array_equal(bus.plant.torque_nm, sent.joint_torque_nm)

    @pytest.mark.parametrize("bad", [[1.0, 2.0], [np.nan, 0, 0], [0, np.inf, 0]])
    def test_invalid_command_is_not_sent(self, active, bus, bad):
        active.write(Command(np.array([0.5, 0, 0])), 1.0)
        with pytest.raises(InputError, match="joint torque command"):
            active.write(Command(np.array(bad)), 1.0)
        np.testing.assert_array_equal(bus.plant.torque_nm, [0.5, 0, 0])

    def test_failing_bus_is_named(self, active, bus):
        bus.faults.unplugged = True
        with pytest.raises(DeviceError, match="mock: command not sent: bus 'world': mock bus: unplugged"):
            active.write(Command(np.zeros(3)), 1.0)

    def test_all_buses_are_flushed_even_if_the_first_fails(self, robot, bus):
        other = mock_bus(build_mock_robot())
        pair = Robot(robot.encoder, robot.torque, robot.force, {"a": bus, "b": other}, robot.clock, "pair")
        pair.configure()
        pair.activate()
        other.powered, other.staged_nm = True, np.ones(3)
        bus.faults.unplugged = True
        with pytest.raises(DeviceError, match="bus 'a'"):
            pair.write(Command(np.zeros(3)), 1.0)
        np.testing.assert_array_equal(other.plant.torque_nm, np.ones(3))

    def test_writing_needs_an_active_robot(self, robot):
        robot.configure()
        with pytest.raises(LifecycleError, match="needs a robot that is active, but this one is configured"):
            robot.write(Command(np.zeros(3)), 1.0)


class TestLife:
    def test_torque_is_the_last_on_and_the_first_off(self, robot, bus):
        robot.configure()
        robot.activate()
        robot.deactivate()
        robot.close()
        assert steps(bus, "configure") == steps(bus, "activate") == UP
        assert steps(bus, "deactivate")[:4] == steps(bus, "close") == DOWN

    @pytest.mark.parametrize("failing", UP)
    def test_failed_activation_deactivates_what_was_activated(self, robot, bus, failing):
        robot.configure()
        bus.faults.refuse.add((failing, "activate"))
        with pytest.raises(DeviceError, match=f"mock {failing} refuses to activate"):
            robot.activate()
        assert steps(bus, "deactivate") == DOWN[UP[::-1].index(failing) :]
        assert robot.state is RobotState.CONFIGURED
        assert not bus.powered
        bus.faults.refuse.clear()
        robot.activate()

    @pytest.mark.parametrize("failing", UP)
    def test_failed_configuration_closes_what_was_opened(self, robot, bus, failing):
        bus.faults.refuse.add((failing, "configure"))
        with pytest.raises(DeviceError, match=f"configure failed: mock {failing} refuses"):
            robot.configure()
        assert steps(bus, "close") == DOWN[UP[::-1].index(failing) :]
        assert robot.state is RobotState.NEW

    def test_failure_during_the_return_is_reported(self, robot, bus):
        robot.configure()
        bus.faults.refuse |= {("torque", "activate"), ("encoder", "deactivate")}
        with pytest.raises(DeviceError, match=r"refuses to activate; then encoder: deactivate failed"):
            robot.activate()
        assert steps(bus, "deactivate") == DOWN

    @pytest.mark.parametrize("step", ["deactivate", "close"])
    def test_all_devices_are_tried_before_an_error_is_raised(self, active, bus, step):
        bus.faults.refuse |= {("torque", step), ("encoder", step)}
        with pytest.raises(DeviceError) as caught:
            getattr(active, step)()
        assert steps(bus, step) == DOWN
        assert "drives: " in str(caught.value)
        assert "encoder: " in str(caught.value)

    def test_robot_that_could_not_be_deactivated_takes_no_commands_and_can_retry(self, active, bus):
        bus.faults.refuse.add(("torque", "deactivate"))
        with pytest.raises(DeviceError):
            active.deactivate()
        with pytest.raises(LifecycleError):
            active.write(Command(np.zeros(3)), 1.0)
        bus.faults.refuse.clear()
        active.deactivate()
        assert not bus.powered

    def test_closing_releases_everything_even_if_the_torque_stays_on(self, active, bus):
        bus.faults.refuse.add(("torque", "deactivate"))
        with pytest.raises(DeviceError):
            active.close()
        assert steps(bus, "close") == DOWN
        assert active.state is RobotState.CLOSED

    def test_second_ctrl_c_does_not_leave_the_torque_on(self, active, bus, monkeypatch):
        real, interrupts = active.torque.deactivate, [KeyboardInterrupt()]

        def deactivate():
            if interrupts:
                raise interrupts.pop()
            real()

        monkeypatch.setattr(active.torque, "deactivate", deactivate)
        with pytest.raises(KeyboardInterrupt):
            active.deactivate()
        assert steps(bus, "deactivate") == DOWN
        assert not bus.powered

    def test_ctrl_c_while_activating_reverts_everything(self, robot, bus, monkeypatch):
        def activate():
            raise KeyboardInterrupt

        robot.configure()
        monkeypatch.setattr(robot.torque, "activate", activate)
        with pytest.raises(KeyboardInterrupt):
            robot.activate()
        assert steps(bus, "deactivate") == DOWN
        assert robot.state is RobotState.CONFIGURED

    def test_bug_in_one_driver_does_not_spare_the_others(self, active, bus, monkeypatch):
        def deactivate():
            raise TypeError("a bug")

        monkeypatch.setattr(active.torque, "deactivate", deactivate)
        with pytest.raises(DeviceError, match="drives: deactivate failed: a bug"):
            active.deactivate()
        assert steps(bus, "deactivate") == DOWN[1:]

    def test_with_block_keeps_its_own_error_and_notes_a_failed_close(self, robot, bus):
        bus.faults.refuse.add(("encoder", "close"))

        def work():
            with robot:
                raise ZeroDivisionError("the work")

        with pytest.raises(ZeroDivisionError, match="the work") as caught:
            work()
        assert "closing failed too: encoder: close failed" in caught.value.__notes__[0]

    def test_with_block_reports_a_failed_close(self, robot, bus):
        bus.faults.refuse.add(("encoder", "close"))
        with pytest.raises(DeviceError, match="encoder: close failed"), robot:
            pass

    def test_deactivating_touches_nothing_that_is_not_open(self, robot, bus):
        robot.deactivate()
        assert bus.calls == []


class TestBuilding:
    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("driver: mock_bus", "driver: mock_buss", "line 7, buses.world.driver: no bus driver is"),
            ("driver: mock_force,", "driver: mock_encoder,", "force.driver: no force sensor driver"),
            ("{driver: mock_bus}", "{driver: mock_bus, stiffness_n_m: -1}", "buses.world.stiffness_n_m"),
            ("{driver: mock_bus}", "{driver: mock_bus, stiffness: 1}", "did you mean 'stiffness_n_m'?"),
            ("mock_encoder, bus: world", "mock_encoder", "encoder.bus: must name a bus whose driver is"),
            ("home_rad: [-1.275, 1.391, 1.455]", "home_rad: [0, 0, 0]", None),
        ],
    )
    def test_drivers_and_their_settings_are_checked_with_their_line(self, old, new, message):
        assert old in ROBOT_YAML
        text = ROBOT_YAML.replace(old, new)
        if message is None:
            assert build_mock_robot(text=text).joint_count == 3
            return
        with pytest.raises(InputError) as caught:
            build_mock_robot(text=text)
        assert str(caught.value).startswith("mock.yaml line ")
        assert message in str(caught.value)

    def test_encoder_and_drives_must_agree_about_the_joints(self, robot, bus, monkeypatch):
        monkeypatch.setattr(type(robot.encoder), "joint_count", 2)
        with pytest.raises(InputError, match="the encoder has 2 joints, but the drives have 3"):
            Robot(robot.encoder, robot.torque, robot.force, {"world": bus}, SimulatedClock(), "odd")

    def test_drives_must_fit_the_robot_file(self, robot, monkeypatch):
        monkeypatch.setattr(type(robot.encoder), "joint_count", 2)
        monkeypatch.setattr(type(robot.torque), "joint_count", 2)
        with pytest.raises(InputError, match="the drives have 2 joints, but home_rad has 3"):
            build_mock_robot()

    def test_building_opens_nothing(self, bus):
        assert bus.calls == []
        assert bus.polls == 0
