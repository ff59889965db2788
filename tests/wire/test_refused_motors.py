"""Motors that differ from the robot file or lack a watchdog are refused without torque."""

from contextlib import nullcontext

import numpy as np
import pytest

from palpate.robot_io.errors import DeviceError, InputError
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from palpate.sim_backend.emulators.mit import ROBSTRIDE_TIMEOUT
from tests.wire.parts import CUBEMARS, DAMIAO, MOTEUS, ODRIVE, ROBSTRIDE, SO101, V0_5

TIMEOUT, MODE, VMAX = 9, 10, 22  # registers of a Damiao motor
MODEL, PHASE = 3, 18  # addresses in a Feetech servo


def has(**values):
    """A motor of which that is true."""
    return lambda motor: [setattr(motor, name, value) for name, value in values.items()]


def stubborn(kept, number=None, **more):
    """One whose registers keep no number, or another than it was sent."""

    class Stubborn(dict):
        def __setitem__(self, key, value):
            if number not in (None, key):
                super().__setitem__(key, value)

    return lambda motor: setattr(motor, kept, Stubborn(getattr(motor, kept) | more.get("but", {})))


def ignores_its_timeout(motor):
    motor.timeout_s = None
    motor.__class__ = type("Deaf", (type(motor),), {"timeout_s": property(lambda _: None, lambda *_: None)})


def stays_hot(motor):
    motor._drive = lambda: setattr(motor, "mode", 1) or setattr(motor, "fault", 38)


def shows_version(motor):
    motor._answer = lambda _: [motor._message(0, bytes((2, 3, 6, 56, 0, 5, 6, 0)))]


def knows_no_position(motor):
    motor._encoder_estimates = lambda: motor._message(0x09, 2 * bytes((0, 0, 0xC0, 0x7F)))


AT_CONFIGURING = [  # robot file, its changes, the second motor or servo 3, what is said
    (ODRIVE, (), has(_firmware="0.5"), "Get_Version"),
    (ODRIVE, V0_5, has(_firmware="0.6"), r"has firmware 0\.6\.10, but the robot file states 0\.5"),
    (ODRIVE, (), shows_version, r"joint 2 \(node 1\): has firmware 0\.5\.6"),
    (ODRIVE, (), has(_cyclic_s=0.01), r"joint 2 \(node 1\): .* every 0.005 s; set .*encoder_msg_rate_ms = 1"),
    (
        ODRIVE,
        (),
        knows_no_position,
        "sends no valid encoder estimates .encoder estimates: nan",
    ),
    # The same bits would mean other speeds.
    (
        DAMIAO,
        (),
        lambda motor: motor.registers.update({VMAX: 45.0}),
        "VMAX is 45, but the robot file states 8",
    ),
    # States end at four turns of the output.
    (
        *(ROBSTRIDE, (), has(_zero_rad=8.0)),
        r"joint 2 .*: its mechPos is .* rad at the joint, but its messages report",
    ),
    (MOTEUS, (), has(home=0), "joint 2 .motor 2.: has no reference for its position"),
    (MOTEUS, (), has(known=False), "motor 2.: does not know its position: its position is nan"),
    (SO101, (), lambda servo: servo.put(MODEL, 2825), "servo 3 .* number 2825, .* states STS3215-12V"),
    (SO101, (), lambda servo: servo.put(PHASE, 28, 1), "servo 3 counts over several turns: clear bit 4"),
    # 1.49 rad/s was read as 0.031, and one that was armed never moved.
    (SO101, (), lambda servo: servo.put(PHASE, 8, 1), r"servo 3 shows speeds in steps of 50 .*: set bit 2"),
    (SO101, (), lambda servo: servo.put(PHASE, 4, 1), r"stands still at a goal speed of 0.*: set bit 3"),
    (SO101, (), has(supply_v=7.4), r"servo 3: is supplied with 7.4 V, .* needs 12 V"),
    (SO101, (), has(awake_s=float("inf")), r"no answer from servo 3 .*answering: 2, 4, 1, 5\)"),
]
AT_ACTIVATING = [
    *((ODRIVE, has(watchdog_s=one), r"watchdog of joint 2 \(node 1\) did not expire") for one in (None, 5.0)),
    # Such a motor kept its torque for seconds after the program had died.
    *(
        (CUBEMARS, has(timeout_s=one), "still exerts torque .*set its timeout to 0.1 s")
        for one in (None, 2.0)
    ),
    (CUBEMARS, has(_drive=lambda: None), "reports no torque"),
    (DAMIAO, stubborn("registers", TIMEOUT), "CAN timeout is 0 after it was set to 2000"),
    (DAMIAO, stubborn("registers", MODE, but={MODE: 2}), "control mode is 2"),
    (ROBSTRIDE, stubborn("parameters"), "its canTimeout is 0 after"),
    (ROBSTRIDE, lambda motor: motor.parameters.pop(ROBSTRIDE_TIMEOUT), "does not report its canTimeout"),
    (ROBSTRIDE, ignores_its_timeout, "is still in motor mode after 0.15 s .*set its timeout to 0.1 s"),
    (MOTEUS, has(send_unrequested=lambda now_s: []), "is still in position mode after 0.15 s"),
    (MOTEUS, stays_hot, r"does not stop: joint 2 \(motor 2\) \(over temperature\)"),
]


@pytest.mark.parametrize(("path", "changes", "spoil", "problem"), AT_CONFIGURING)
def test_device_that_differs_from_the_robot_file_is_refused(make_robot, path, changes, spoil, problem):
    arm = make_robot(path, changes)
    spoil(arm.servos[3] if path is SO101 else arm.motors[1])
    with pytest.raises(DeviceError, match=problem):
        arm.robot.configure()


@pytest.mark.parametrize(
    ("path", "model", "mounting", "said"),
    [  # ranges and gears in the joint's angle; a stop takes 0.305 s from 6 rad/s, Damiao's from 3.5
        (ROBSTRIDE, "RS03", (3, -2.0), r"position_max_rad entry 1: joint 1 \(motor 1\).* at most 0\.36"),
        (ROBSTRIDE, "RS03", (3, 3.6), r"position_min_rad entry 1: joint 1 \(motor 1\).* at least 1\.24"),
        (ROBSTRIDE, "RS03", (2, 0.0), None),
        (
            CUBEMARS,
            "AK70-10",
            (2.6, 0.0),
            r"reports -4\.81 to 4\.81 rad, .* 1\.83 rad beyond.* at most 2\.98",
        ),
        (CUBEMARS, "AK70-10", (2.5, 0.0), None),
        (CUBEMARS, "AK70-10", (2.6, 0.2), None),
        (DAMIAO, "DM-J4340", (3.2, 0.0), r"line \d+.* at most 2\.84"),
    ],
)
def test_limits_that_a_stop_may_pass_beyond_the_range_of_positions_are_refused(
    make_robot, path, model, mounting, said
):
    """Past the end of its range, a motor within its limits was 8.4 rad from where it reported to be."""
    old = f"motor_id: 1, model: {model}, gear_ratio: 2"
    new = "motor_id: 1, model: {}, gear_ratio: {}, zero_rad: {}".format(model, *mounting)
    with pytest.raises(InputError, match=said) if said else nullcontext():
        make_robot(path, [(old, new)])


@pytest.mark.parametrize(
    ("shown_rad_s", "fits"), [(8.007, True), (8.009, False), (7.993, True), (7.991, False)]
)
def test_range_of_a_motor_may_be_a_thousandth_off(make_robot, shown_rad_s, fits):
    arm = make_robot(DAMIAO)
    arm.motors[1].registers[VMAX] = shown_rad_s
    with nullcontext() if fits else pytest.raises(DeviceError, match=r"VMAX is .*, but .* states 8"):
        arm.robot.configure()


@pytest.mark.parametrize(("path", "spoil", "problem"), AT_ACTIVATING)
def test_motor_without_watchdog_or_control_mode_is_refused(make_robot, path, spoil, problem):
    arm = make_robot(path)
    arm.robot.configure()
    spoil(arm.motors[1])
    with pytest.raises(DeviceError, match=problem) as refused:
        arm.robot.activate()
    assert "joint 2 (" in str(refused.value)
    assert not any(getattr(node, "enabled", False) or getattr(node, "state", 1) > 1 for node in arm.motors)
    arm.clock.sleep_until(arm.clock.now_s() + 0.11)
    assert np.abs(arm.drive_torque_nm).max() < 0.02  # zero on an MIT motor's wire is half a step off


def test_watchdog_trial_exerts_a_hundredth_of_the_torque_range(make_robot):
    arm, exerted = make_robot(CUBEMARS), []
    arm.robot.configure()
    motor = arm.motors[1]
    exert = motor._exert
    motor._exert = lambda torque_nm: exerted.append(abs(torque_nm)) or exert(torque_nm)
    arm.robot.activate()
    assert max(exerted) == pytest.approx(0.01 * 25.0, abs=2 * 25.0 / 4095)  # an AK70-10, in its steps


@pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, ROBSTRIDE, MOTEUS, ODRIVE], ids=lambda path: path.stem)
def test_missing_motor_is_named(make_robot, path):
    arm = make_robot(path)
    arm.inject_fault("motors", FaultKind.DROP, device=2)
    said = r"joint 3 \(node 2\): no heartbeat" if path is ODRIVE else r"no answer in 0.05 s from joint 2"
    with pytest.raises(DeviceError, match=said):
        arm.robot.configure()


@pytest.mark.parametrize("length", [6, 7])
def test_answers_without_an_error_are_accepted(make_robot, length):
    """The seventh byte of the Mini Cheetah's firmware is its supply voltage, not an error."""
    arm = make_robot(CUBEMARS)
    for motor in arm.motors:
        motor.answer_bytes = length
    assert arm.start().tick().torque_status is Status.OK


@pytest.mark.parametrize("path", [CUBEMARS, DAMIAO, ROBSTRIDE, MOTEUS], ids=lambda path: path.stem)
def test_answers_of_a_wrong_length_are_named(make_robot, path):
    """They were reported as none."""
    arm = make_robot(path)
    arm.inject_fault("motors", FaultKind.CORRUPT, device=2)
    said = r"no valid answer in 0.05 s from joint 2 \(motor 2\) \(.* state has 3 bytes, expected"
    with pytest.raises(DeviceError, match=said):
        arm.robot.configure()


@pytest.mark.parametrize("path", [DAMIAO, ROBSTRIDE], ids=lambda path: path.stem)
def test_setting_whose_frame_is_lost_is_sent_again(make_robot, path):
    """A single lost frame was reported as a setting that the motor refuses."""
    arm, lost = make_robot(path), []
    arm.robot.configure()
    motor = arm.motors[1]
    process = motor._process

    def lose_the_first_setting(message, now_s):
        number, data = message.arbitration_id, message.data
        is_setting = number >> 24 == 18 or (number == 0x7FF and data[0] == 2 and data[2] == 0x55)
        if is_setting and not lost:
            lost.append(message)
            return []
        return process(message, now_s)

    motor._process = lose_the_first_setting
    motor.registers = getattr(motor, "registers", {}) | {MODE: 2}
    if path is ROBSTRIDE:
        motor.parameters[0x7005] = 1
    arm.robot.activate()
    assert lost


@pytest.mark.parametrize(("left_rad", "refused"), [(0.3, False), (0.1, True)])
def test_arm_moved_while_it_is_configured_is_not_blamed_on_its_ranges(make_robot, left_rad, refused):
    arm = make_robot(ROBSTRIDE)
    bus, world = arm.robot.buses["motors"], arm.arm.plant.world
    home_rad, ask = np.array(arm.arm.robot_file.home_rad), bus._register

    def move(offset_rad):
        world.place(home_rad + offset_rad)
        arm.clock.sleep_until(arm.clock.now_s() + 0.01)

    def ask_a_moving_motor(*arguments):
        move(0.3)
        shown = ask(*arguments)
        move(left_rad)
        return shown

    bus._register = ask_a_moving_motor
    with (
        pytest.raises(DeviceError, match="the joint moves, so hold the arm still")
        if refused
        else nullcontext()
    ):
        arm.robot.configure()
