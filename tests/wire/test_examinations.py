"""Self-descriptions of devices, and impossible settings of robot files."""

import re
from contextlib import nullcontext

import pytest

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import DeviceError, InputError
from palpate.robot_io.examination import Level
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import parse_robot_file
from palpate.sim_backend.emulators import dynamixel_servo as table
from tests.wire.parts import CUBEMARS, DAMIAO, DYNAMIXEL, LINES, MOTEUS, ODRIVE, ROBSTRIDE, SO101

LONG, SHORT, EMPTY = (
    111e-6,
    79e-6,
    47e-6,
)  # CAN frames with 8, 4 and no bytes of data at 1 Mbit/s, without stuffing


@pytest.mark.parametrize(
    ("path", "count", "said", "force", "wire_s"),
    [
        (
            *(ODRIVE, 3, "firmware 0.6.10, 24.0 V, IDLE", "DI-1000, counts in lb"),
            3 * (2 * LONG + SHORT + (LONG + EMPTY) / 13),
        ),
        (CUBEMARS, 3, "answers, at .* tested at act", "serial number 123456, 100 N, 1000 s", 3 * 2 * LONG),
        (DAMIAO, 3, "answers, at .* set and read back at act", "nau7802, 320 samples/s", 3 * 2 * LONG),
        (
            *(ROBSTRIDE, 3, "at .* set, read back and tested at act", "nau7802, 320 samples/s"),
            3 * 2 * (LONG + 20e-6),
        ),
        (MOTEUS, 3, "mode 0, 24.0 V, 31 °C, position reference: the output", "nau7802, 320", 3 * 200.4e-6),
        (
            SO101,
            5,
            "answers, and holds|STS3215-12V, firmware 3.9, 12.0 V, 30 °C.*; no watchdog: it holds",
            "nau7802, 320",
            None,
        ),
    ],
)
def test_healthy_devices_describe_themselves(make_robot, path, count, said, force, wire_s):
    arm = make_robot(path)
    assert arm.robot.force.examine() == ()  # it has not been asked yet
    arm.robot.configure()
    motors = arm.robot.buses["motors"]
    found = [one for one in motors.examine() if one.subject != "set over USB"]
    assert len(found) == count
    assert {one.level for one in found} == {Level.OK}
    assert all(re.search(said, one.text) for one in found)
    (sensor,) = arm.robot.force.examine()
    assert sensor.level is Level.OK
    assert sensor.text.startswith(force)
    assert wire_s is None or motors.tick_wire_s() == pytest.approx(wire_s)


def put(address, value):
    return lambda arm: arm.servos[2].memory.put(address, value)


def renumber(**ids):
    """Other ids for the servos on joints, such as j2=9."""

    def change(arm):
        for joint, servo_id in ids.items():
            servo = arm.servos.pop(int(joint[1:]))
            servo.id, arm.servos[servo_id] = servo_id, servo

    return change


@pytest.mark.parametrize(
    ("spoil", "level", "said", "refused"),  # what its examination says, and its configuring
    [
        (put(144, 96), Level.OK, "9.6 V (its limits 9.5 to 16.0 V), 32 °C", ""),
        (put(144, 94), Level.FAIL, "9.4 V (its limits 9.5 to 16.0 V)", ""),
        (put(144, 161), Level.FAIL, "16.1 V (its limits 9.5 to 16.0 V)", ""),
        (put(table.HARDWARE_ERROR, 0x24), Level.FAIL, "hardware error: overheating, overload", ""),
        (put(table.DRIVE_MODE, 0x04), Level.OK, "firmware", ""),
        (put(table.DRIVE_MODE, 0x01), Level.FAIL, "drive mode: reversed", "servo 2.*reversed"),
        (put(table.DRIVE_MODE, 0x08), Level.FAIL, "by itself", "servo 2.*by itself"),
        # As in arms that are sold with two servos on the shoulder: one with the other's sense would fight it.
        (put(table.SECONDARY_ID, 252), Level.FAIL, "252: the servo also obeys commands", "servo 2: sec.*252"),
        (put(table.SECONDARY_ID, 253), Level.OK, "firmware", ""),
        (put(6, 38), Level.OK, "firmware 38", ""),
        (put(6, 37), Level.FAIL, "firmware 37, without a bus watchdog", "servo 2 has firmware 37"),
        (
            *(lambda arm: arm.servos.pop(2), Level.FAIL, "does not answer"),
            r"no answer from servo 2 at 4000000 bit/s \(answering: 1, 3\)",
        ),
    ],
)
def test_unhealthy_dynamixel_is_named(make_robot, spoil, level, said, refused):
    arm = make_robot(DYNAMIXEL)
    spoil(arm)
    motors = arm.robot.buses["motors"]
    with pytest.raises(DeviceError, match=refused) if refused else nullcontext():
        motors.configure()
    found = motors.examine()
    mine = [one for one in found if one.subject == "servo 2 (joint 2)"]
    assert any(said in one.text and one.level is level for one in mine), mine
    assert {one.level for one in found if one not in mine} == {Level.OK}
    assert all(bool(one.remedy) == (one.level is not Level.OK) for one in found)


@pytest.mark.parametrize(
    ("spoil", "subject", "level", "said", "refused"),
    [
        (
            renumber(j2=9),
            *("servo 2 (joint 2)", Level.FAIL, "but id 9, which the robot file"),
            "no answer from servo 2",
        ),
        (
            lambda arm: vars(arm.servos[2]).update(_model=table.MODELS["XM430-W350"]),
            *("servo 2 (joint 2)", Level.FAIL, "XM430-W350, firmware 46, but the robot file states"),
            "servo 2 is a XM430-W350, but the robot file states XM540-W270",
        ),
        (renumber(j2=9), "other servos", Level.WARN, "id 9 also on the line", "no answer from servo 2"),
        (
            renumber(j1=7, j2=8, j3=9),
            *("servos", Level.FAIL, "ids 1, 2, 3 silent; found on the line: ids 7, 8, 9", "no answer"),
        ),
    ],
)
def test_servos_with_other_ids_are_detected(make_robot, spoil, subject, level, said, refused):
    arm = make_robot(DYNAMIXEL)
    spoil(arm)
    motors = arm.robot.buses["motors"]
    with pytest.raises(DeviceError, match=refused):
        motors.configure()
    found = motors.examine()
    assert any((one.subject, one.level) == (subject, level) and said in one.text for one in found)


@pytest.mark.parametrize(
    ("path", "old", "new", "problem"),
    [
        (ODRIVE, "node_id: 1", "node_id: 0", "not all different"),
        (ODRIVE, "node_id: 1", "zero_rad: 1e6, node_id: 1", r"zero_rad: give -25 to 25 rad \(is 1000000.0\)"),
        (ODRIVE, "channel: can0", "channel: ' '", "motors.channel: give the channel's name, such as can0"),
        (DYNAMIXEL, "zero_rad: 3.14159265", "zero_rad: -26", r"zero_rad: give -25 to 25 rad \(is -26"),
        (DYNAMIXEL, "model: XM430-W350", "model: XM430-W999", "XM430-W350"),
        (DYNAMIXEL, "id: 2, model", "id: 1, model", "twice"),
        (DYNAMIXEL, "model: XM430-W350", "model: XL330-M288", "two buses"),
        (DYNAMIXEL, "baud_rate: 4000000", "baud_rate: 1234", "57600"),
        (ODRIVE, 'firmware: "0.6"', 'firmware: "0.7"', "firmware"),
        (ODRIVE, 'firmware: "0.6"', 'firmware: "0.5"', "torque_constant_nm_a"),
        (ODRIVE, "      - {node_id: 2, gear_ratio: 9, max_torque_nm: 2.2}\n", "", "one per joint"),
        (ODRIVE, "odrive_encoder, bus: motors", "odrive_encoder, bus: load_cell", "odrive_bus"),
        (ODRIVE, *(LINES[0], LINES[1].replace("?P<value>", "?P<force>")), "value"),
        (ODRIVE, *(LINES[0], LINES[1].replace(r"(?P<unit>\w+)", "((a+)+)")), "may never end"),
        (CUBEMARS, "model: AK60-6", "model: AK60-7", "AK60-6"),
        (CUBEMARS, "motor_id: 2", "motor_id: 1", "not all different"),
        (CUBEMARS, "motor_id: 2,", "motor_id: 2, answer_id: 18,", "only Damiao motors have an 'answer_id'"),
        (CUBEMARS, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 3", "host_id 3 is already in use"),
        (DAMIAO, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 0", "host_id"),
        (DAMIAO, "motor_id: 1,", "motor_id: 1, answer_id: 2,", "answer_id 2 is already in use"),
        (DAMIAO, "motor_id: 1,", "motor_id: 1, answer_id: 18,", "18 is .* for another motor"),
        (DAMIAO, "motor_id: 1,", "motor_id: 16,", "'damiao' is 15"),
        (MOTEUS, "motor_id: 2", "motor_id: 1", "not all different"),
        (MOTEUS, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 3", "host_id 3 are not all different"),
        (MOTEUS, "socketcan", "slcan", "slcan carries no CAN FD"),
        (ROBSTRIDE, "motor_id: 1,", "motor_id: 128,", "'robstride' is 127"),
        (ROBSTRIDE, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 256", "at most 255"),
        (MOTEUS, "gear_ratio: 2", "gear_ratio: 1e308", r"give 0.001 to 10000 turns \(is 1e\+308\)"),
        (DAMIAO, "watchdog_s: 0.1", "ask_with: enter", "would power motors of 'damiao'"),
        (ROBSTRIDE, "watchdog_s: 0.1", "ask_with: enter", "would power motors of 'robstride'"),
        (CUBEMARS, "unit: N", "unit: bar", "not a known unit"),
        (CUBEMARS, "load_code: 100", "load_code: 100, rate_hz: 999", "1000"),
    ],
)
def test_invalid_robot_file_is_refused(path, old, new, problem):
    text = path.read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(InputError, match=problem):
        build_robot(parse_robot_file(text.replace(old, new, 1), path), DriverCatalog(), SimulatedClock())
