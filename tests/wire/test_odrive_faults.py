"""Faults of ODrive axes."""

import numpy as np
import pytest

from palpate.robot_io.drivers.can.line import CanLine, CanLineSettings
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.examination import Level
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import ODRIVE, V0_5, add_twin

PUSH_NM = (3.0, -2.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "remedy"), [((), "torques_msg_rate_ms = 1"), (V0_5, "iq_rate_ms = 1")], ids=["0.6", "0.5"]
)
def test_axis_with_factory_settings_is_refused_with_the_needed_settings(make_robot, changes, remedy):
    arm = make_robot(changes=changes)
    bus = arm.robot.buses["motors"]
    arm.motors[1]._torque = lambda: None
    with pytest.raises(DeviceError, match=rf"joint 2 \(node 1\): sends no torques; set .*{remedy}"):
        bus.configure()
    seen = [one.remedy for one in bus.examine() if "node 1" in one.subject]
    assert remedy in seen[0]


@pytest.mark.parametrize(
    ("changes", "current"), [((), "motor.current_soft_max"), (V0_5, "config.current_lim")], ids=["0.6", "0.5"]
)
def test_settings_unreadable_over_can_are_printed_as_commands(make_robot, changes, current):
    """As typed into odrivetool; the speed is 6 rad/s at a joint with nine turns of its motor."""
    arm = make_robot(changes=changes)
    arm.robot.configure()
    (unseen,) = (one for one in arm.robot.buses["motors"].examine() if one.subject == "set over USB")
    for command in (
        *("heartbeat", "rate_ms = 10;", "rate_ms = 1;", "watchdog_timeout = 0.05", "enable_watchdog = True"),
        *("enable_torque_mode_vel_limit = False", "vel_limit = 8.6", current, "save_configuration()"),
    ):
        assert command in unseen.text


@pytest.mark.parametrize(
    ("name", "value", "level", "said"),
    [
        ("supply_v", 8.0, Level.OK, "8.0 V"),
        ("supply_v", 7.9, Level.FAIL, "7.9 V"),
        ("error", 1, Level.WARN, "24.0 V"),
    ],
)
def test_axis_without_supply_or_with_an_error_is_found_by_its_examination(
    make_robot, name, value, level, said
):
    arm = make_robot()
    arm.robot.configure()
    setattr(arm.motors[1], name, value)
    (seen,) = (one for one in arm.robot.buses["motors"].examine() if "node 1" in one.subject)
    assert (seen.level, said in seen.text) == (level, True)


def test_missing_torques_name_their_joint(make_robot):
    arm = make_robot().start()
    arm.motors[1]._torque = lambda: None
    assert arm.ticks_until(lambda m: bool(arm.problem), most=10) <= 7  # half of the age limit of 10 ms
    assert "joint 2 (node 1): no torques for" in arm.problem
    assert "node 0" not in arm.problem


@pytest.mark.parametrize(("left_nm", "named"), [(0.333, True), (0.7, True), (0.725, False)])
def test_velocity_limiter_that_cuts_torques_is_named(make_robot, left_nm, named):
    """As delivered 3 of 9 N m remain at rest. Named below 0.8 of the torque minus 0.02 of 4.4 N m."""
    arm = make_robot().start()
    arm.arm.plant.world.held = True
    arm.ticks(10, (9.0, 1.0, 0.0))
    assert not arm.problem
    arm.motors[0].velocity_limiter = (2e3, left_nm / 2e3)  # which hardly depends on its speed
    arm.ticks(4, (9.0, 1.0, 0.0))
    assert not arm.problem  # it is named in the fifth sample
    arm.tick((9.0, 1.0, 0.0))
    assert arm.drive_torque_nm[0] == pytest.approx(9.0 * left_nm, abs=0.1)
    assert (
        f"joint 1 (node 0): exerts {left_nm:.2f} N m at the motor instead of 1.00" in arm.problem
    ) is named
    assert ("enable_torque_mode_vel_limit = False" in arm.problem) is named
    assert "node 1" not in arm.problem


def test_limits_are_written_where_the_robot_file_states_a_current(make_robot):
    """As delivered an axis fails beyond 2.4 rev/s, a quarter of what this robot file allows."""
    said = [("max_torque_nm: 4.4}", "max_torque_nm: 4.4, current_limit_a: 40}")]
    for changes, failed in (((), True), (said, False)):
        arm = make_robot(ODRIVE, changes)
        arm.motors[0].velocity_limit_rev_s = 2.0
        arm.start()
        speed = 0.0
        while speed < 3.0 and not arm.robot.bus_errors:
            speed = arm.tick((6.0, 0.0, 0.0)).joint_velocity_rad_s[0]
        arm.ticks(12)
        assert ("joint 1 (node 0): IDLE VELOCITY_LIMIT_VIOLATION" in arm.problem) == failed
    assert arm.motors[0].velocity_limit_rev_s == pytest.approx(1.5 * 9 * 6.0 / (2.0 * np.pi))
    assert [node.current_limit_a for node in arm.motors[:2]] == [40.0, pytest.approx(np.nan, nan_ok=True)]


@pytest.mark.parametrize(
    ("changes", "name"), [((), "INVERTER_OVER_TEMP"), (V0_5, "MOTOR_FAILED motor error")], ids=["0.6", "0.5"]
)
def test_axis_error_is_named_as_a_drive_fault(make_robot, changes, name):
    arm = make_robot(changes=changes).start()
    arm.inject_fault("motors", FaultKind.ALERT, device=1, times=1)
    ticks = arm.ticks_until(lambda m: m.torque_status is Status.FAULT)
    assert ticks <= 11  # with the next heartbeat
    assert "joint 2 (node 1)" in arm.robot.bus_errors["motors"]
    assert name in arm.problem
    assert arm.tick().encoder_status is Status.OK  # the others can still be braked


def test_restarted_axis_that_arms_itself_gets_no_torque_until_the_next_activation(make_robot):
    """As with startup_closed_loop_control: its fault ended by itself, and its torque came back."""
    arm = make_robot().start()
    arm.inject_fault("motors", FaultKind.REBOOT, device=1, times=1, delay_s=0.001)
    arm.ticks_until(lambda m: m.torque_status is Status.FAULT, torque_nm=PUSH_NM)
    arm.motors[1].state, arm.motors[1]._control_mode = 8, 1
    assert arm.ticks(30, PUSH_NM).torque_status is Status.FAULT
    assert "joint 2 (node 1): left closed-loop control (IDLE)" in arm.problem
    assert (arm.motors[1].state, arm.drive_torque_nm[1]) == (1, 0.0)
    arm.robot.deactivate()
    arm.robot.activate()
    assert arm.ticks(5, PUSH_NM).torque_status is Status.OK


def lose(motor, lost):
    """Lose the frames to a motor for whose command and number `lost` is true; return all commands."""
    commands, process = [], motor._process

    def process_others(message, now_s):
        if message.arbitration_id >> 5 != motor.number:
            return []
        commands.append(message.arbitration_id & 0x1F)
        return [] if lost(commands[-1], commands.count(commands[-1])) else process(message, now_s)

    motor._process = process_others
    return commands


CLEAR, STATE, TORQUE = 0x18, 0x07, 0x0E


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("command", [0x0B, 0x0F, TORQUE, STATE, CLEAR])
def test_lost_frame_of_an_activation_is_sent_again(make_robot, command, count):
    """Every tenth activation failed with one lost frame in a hundred; a lost mode went unnoticed."""
    arm = make_robot(ODRIVE, [("max_torque_nm: 4.4}", "max_torque_nm: 4.4, current_limit_a: 40}")])
    arm.robot.configure()
    motor = arm.motors[0]
    commands = lose(motor, lambda sent, number: (sent, number) == (command, count))
    arm.robot.activate()
    assert (motor.state, motor.error, motor._control_mode, motor.current_limit_a) == (8, 0, 1, 40.0)
    assert commands.count(CLEAR) == 2 + ((command, count) == (CLEAR, 2))  # again for the expired watchdog
    arm.ticks(3, (1.0, 0.0, 0.0))
    assert arm.drive_torque_nm[0] == pytest.approx(1.0)
    del commands[:]
    command, count = STATE, 1  # the command to be idle is lost as well
    arm.robot.deactivate()
    assert motor.state == 1


@pytest.mark.parametrize("modes", [(3, 1), (2, 1), (1, 0)], ids=["position", "velocity", "no input"])
@pytest.mark.parametrize("changes", [(), V0_5], ids=["0.6", "0.5"])
def test_axis_that_stays_in_another_mode_is_refused(make_robot, changes, modes):
    """With all frames lost that set its mode, it was armed, and nothing said so."""
    arm = make_robot(changes=changes)
    arm.robot.configure()
    motor = arm.motors[1]
    motor._control_mode, motor._input_mode = modes
    lose(motor, lambda command, _: command == 0x0B)
    with pytest.raises(DeviceError, match=r"not in torque control: joint 2 \(node 1\);"):
        arm.robot.activate()
    assert {node.state for node in arm.motors} == {1}


@pytest.mark.parametrize("since", [STATE, None], ids=["while armed", "in the silence"])
@pytest.mark.parametrize("changes", [(), V0_5], ids=["0.6", "0.5"])
def test_error_during_an_activation_is_not_cleared(make_robot, changes, since):
    """The watchdog's error is cleared after its trial, and so was any other."""
    arm = make_robot(changes=changes)
    arm.robot.configure()
    motor, disarm = arm.motors[1], arm.motors[1]._disarm
    if since:
        commands = lose(motor, lambda command, _: command == since and bool(motor._fail()))
    else:
        commands = lose(motor, lambda *_: False)
        motor._disarm = lambda error: disarm(error) or (motor.error and disarm(motor.error | 1 << 6))
    with pytest.raises(DeviceError, match=r"no closed-loop control: .*joint 2 \(node 1\) is IDLE "):
        arm.robot.activate()
    assert commands.count(CLEAR) == 1


def test_lost_heartbeat_is_distinguished_from_lost_estimates(make_robot):
    arm = make_robot().start()
    arm.motors[0]._heartbeat_s = 1e9
    arm.motors[0]._next_heartbeat_s = 1e9
    ticks = arm.ticks_until(lambda m: m.torque_status is Status.FAULT)
    assert 20 < ticks <= 36  # three and a half periods of 10 ms
    assert "joint 1 (node 0): heartbeat lost" in arm.problem
    assert "node 1" not in arm.problem


def test_foreign_ids_are_counted_and_ignored(make_robot):
    arm = make_robot().start()
    counts = arm.robot.buses["motors"].line.counts
    before = counts["foreign id"]
    arm.inject_fault("motors", FaultKind.WRONG_ID, device=1)
    arm.ticks_until(lambda m: bool(arm.problem), most=10)
    assert counts["foreign id"] > before
    assert "joint 2 (node 1): nothing valid" in arm.problem


def test_unconfirmed_torque_off_is_an_error(make_robot):
    arm = make_robot().start()
    arm.inject_fault("motors", FaultKind.DROP, device=1)
    arm.ticks(2, PUSH_NM)
    with pytest.raises(DeviceError, match=r"idle state is not confirmed by joint 2 \(node 1\)"):
        arm.robot.deactivate()
    assert not arm.drive_torque_nm.any()  # they were told all the same


def test_all_reachable_axes_are_switched_off(make_robot):
    arm = make_robot().start()
    line = arm.robot.buses["motors"].line
    send = line.send

    def torn(frame, deadline_s):
        if frame.can_id >> 5 == 0:
            raise DeviceError("no room in the adapter")
        send(frame, deadline_s)

    line.send = torn
    with pytest.raises(DeviceError, match="no room in the adapter"):
        arm.robot.deactivate()
    arm.clock.sleep_until(arm.clock.now_s() + 1e-3)
    assert [node.state for node in arm.arm.wires["motors"]._nodes] == [8, 1, 1]


def test_babbling_node_does_not_block_the_loop(make_robot):
    arm = make_robot().start()
    arm.intrude(*[(0x7F0, bytes(8))] * 5000)
    assert len(arm.robot.buses["motors"].line.drain(arm.clock.now_s())) <= 1000
    arm.ticks(8)
    assert not arm.problem


def test_configure_switches_off_an_active_axis(make_robot):
    arm = make_robot()
    node = arm.motors[1]
    node.state, node._control_mode, node._input_torque_nm = 8, 1, 0.5
    node._fed_s = arm.clock.now_s()
    node._drive()
    arm.robot.configure()
    assert node.state == 1
    assert not arm.drive_torque_nm.any()


def test_old_heartbeat_confirms_nothing(make_robot):
    """The last one said IDLE, but that was before it was told so."""
    arm = make_robot()
    arm.robot.configure()
    arm.inject_fault("motors", FaultKind.DROP, device=0)
    with pytest.raises(DeviceError, match=r"idle state is not confirmed by joint 1 \(node 0\)"):
        arm.robot.deactivate()


def test_flushing_does_not_repeat_an_old_command(make_robot):
    arm = make_robot().start()
    arm.tick(PUSH_NM)
    for _ in range(60):
        arm.tick(None)
        arm.robot.buses["motors"].flush(arm.clock.now_s())
    assert not arm.drive_torque_nm.any()


def test_staged_command_is_cleared_by_power_off(make_robot):
    arm = make_robot().start()
    arm.robot.torque.stage_torque(np.array(PUSH_NM))
    arm.robot.deactivate()
    arm.robot.activate()
    arm.robot.buses["motors"].flush(arm.clock.now_s())
    arm.tick(None)
    assert not arm.drive_torque_nm.any()


def test_silent_axis_is_a_delay_and_no_bus_failure(make_robot):
    arm = make_robot().start()
    arm.inject_fault("motors", FaultKind.DROP, device=2, for_s=0.01)
    assert 3 <= arm.ticks_until(lambda m: bool(arm.problem)) <= 4  # half of the age limit of 5 ms
    assert "joint 3 (node 2): nothing valid for " in arm.robot.bus_delays["motors"]
    assert "node 0" not in arm.problem
    assert arm.ticks(3).encoder_status is Status.STALE
    assert "motors" not in arm.robot.bus_errors


def test_missing_adapter_is_one_line(make_robot):
    arm = make_robot()
    line = CanLine(CanLineSettings(interface="socketcan", channel="can9"), arm.clock)
    with pytest.raises(DeviceError, match="cannot be opened"):
        line.open()
    with pytest.raises(ValueError, match="no_such_interface is unknown"):
        CanLineSettings(interface="no_such_interface", channel="can9")


TWO = r"joint 1 \(node 0\): two axes have node id 0: "


@pytest.mark.parametrize(
    ("heartbeat_s", "said"), [(0.01, "heartbeats come twice as often"), (0.02, "6 answers to 3 requests")]
)
def test_two_axes_with_one_id_are_refused(make_robot, heartbeat_s, said):
    """The second stands elsewhere: both were armed, and either's position was served."""
    arm = make_robot()
    arm.motors[0]._heartbeat_s = heartbeat_s
    add_twin(arm)
    with pytest.raises(DeviceError, match=TWO + said):
        arm.robot.configure()


def test_axis_that_joins_with_a_used_id_gets_no_power(make_robot):
    arm = make_robot()
    arm.robot.configure()
    add_twin(arm)
    with pytest.raises(DeviceError, match=TWO):
        arm.robot.activate()
    assert {node.state for node in arm.motors} == {1}


@pytest.mark.parametrize(
    ("joint", "off_rad", "supply_v", "most", "said"),
    [
        (2, 0.0, 24.0, 4, "the position jumps by"),
        (0, 1e-3, 24.0, 70, "more than 1400 estimates per second"),
        (0, 0.0, 23.9, 60, "answers requests twice"),
    ],
    ids=["elsewhere", "nearby", "same place"],
)
def test_axis_that_joins_with_a_used_id_is_a_fault(make_robot, joint, off_rad, supply_v, most, said):
    arm = make_robot().start()
    before_rad = arm.tick().joint_position_rad
    add_twin(arm, joint)
    arm.motors[-1]._zero_rad += off_rad
    arm.motors[-1].supply_v = supply_v

    def is_fault(measurement):
        assert measurement.joint_position_rad == pytest.approx(before_rad, abs=0.02)
        return measurement.encoder_status is Status.FAULT

    arm.ticks_until(is_fault, most)
    assert f"joint 1 (node 0): two axes have node id 0: {said}" in arm.problem
    arm.robot.deactivate()
    with pytest.raises(DeviceError, match=TWO):
        arm.robot.activate()


def age_ms(measurement):
    return 1e3 * (measurement.time_s - min(measurement.encoder_at_s, measurement.torque_at_s))


@pytest.mark.parametrize(
    ("late_ms", "torque_nm"), [(4.2, None), (4.2, (0.5, 0.3, 0.1)), (1.2, (0.5, 0.3, 0.1))]
)
def test_frames_that_become_late_are_as_old_as_they_are(make_robot, late_ms, torque_nm):
    """They were dated by the delay at configuration: 30 ms passed for 1.4."""
    arm = make_robot()
    arm.robot.configure()
    if torque_nm:
        arm.robot.activate()
    assert age_ms(arm.ticks(30, torque_nm)) < 1.6
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=late_ms * 1e-3)
    arm.ticks(50 if late_ms > 3.0 else 350, torque_nm)
    ages_ms = [age_ms(arm.tick(torque_nm)) for _ in range(50)]
    assert min(ages_ms) > late_ms - 1e-6
    assert max(ages_ms) < late_ms + 2.6
    assert ("its answers take" in arm.problem) is (late_ms > 3.0)
    arm.faults["motors"].clear()
    arm.ticks(40, torque_nm)
    assert max(age_ms(arm.tick(torque_nm)) for _ in range(20)) < 1.6


@pytest.mark.parametrize("losses", [0.0, 0.01])
def test_healthy_link_with_jitter_and_losses_is_no_fault(make_robot, losses):
    arm = make_robot().start()
    arm.arm.wires["motors"].stalls = True  # frames arrive in order, as on CAN
    arm.inject_fault("motors", FaultKind.DELAY, delay_s=2.5e-3, probability=0.1)
    if losses:
        arm.inject_fault("motors", FaultKind.DROP, probability=losses)
        arm.inject_fault("motors", FaultKind.DUPLICATE, probability=losses)
    for tick in range(1000):
        measurement = arm.tick((6.0 * np.sin(tick / 30.0), -4.0, 1.0))
        assert measurement.encoder_status is not Status.FAULT
        assert losses or measurement.time_s - measurement.encoder_at_s < 5e-3


def test_estimates_that_piled_up_during_a_pause_are_those_of_one_axis(make_robot):
    arm = make_robot()
    arm.robot.configure()
    arm.clock.sleep_until(arm.clock.now_s() + 1.0)
    arm.ticks(200, None)
    assert not arm.problem
    arm.robot.activate()


@pytest.mark.parametrize("first_s", [0.005, 0.02, 0.06])
def test_rare_heartbeats_are_refused_with_the_needed_setting(make_robot, first_s):
    """As delivered, every 100 ms; activation failed without a reason."""
    arm = make_robot()
    arm.motors[1]._heartbeat_s, arm.motors[1]._next_heartbeat_s = 0.1, first_s
    said = r"joint 2 \(node 1\): .*heartbeat.* set .*\.can\.heartbeat_msg_rate_ms = 10"
    with pytest.raises(DeviceError, match=said):
        arm.robot.configure()


@pytest.mark.parametrize(
    ("changes", "setting"), [((), "bus_voltage_msg_rate_ms"), (V0_5, "bus_vi_rate_ms")], ids=["0.6", "0.5"]
)
def test_voltages_without_a_request_are_refused(make_robot, changes, setting):
    arm = make_robot(changes=changes)
    motor = arm.motors[1]
    torque = motor._torque
    motor._torque = lambda: motor._answer(0x17)[0] if arm.clock.now_s() % 0.01 < 1e-3 else torque()
    with pytest.raises(
        DeviceError, match=rf"joint 2 \(node 1\): .* without a request.*set .*\.{setting} = 0"
    ):
        arm.robot.configure()


def test_requests_do_not_feed_the_watchdog_of_an_arm_without_commands(make_robot):
    arm = make_robot().start()
    arm.ticks(60, None)
    assert [node.state for node in arm.motors] == [1, 1, 1]
