"""A robot file that states what its devices cannot be is refused before a port is opened."""

import pytest

from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.errors import InputError
from robot_io.robot import build_robot
from robot_io.robot_file import parse_robot_file
from tests.wire.parts import CUBEMARS, DAMIAO, DYNAMIXEL, LINES, MOTEUS, ODRIVE, ROBSTRIDE


@pytest.mark.parametrize(
    ("path", "old", "new", "problem"),
    [
        (ODRIVE, "node_id: 1", "node_id: 0", "not all different"),
        (ODRIVE, "node_id: 1", "zero_rad: 1e6, node_id: 1", r"zero_rad: give -25 to 25 rad \(is 1000000.0\)"),
        (
            ODRIVE,
            "channel: can0",
            "channel: ' '",
            "buses.motors.channel: give the channel's name, such as can0",
        ),
        (DYNAMIXEL, "zero_rad: 3.14159265", "zero_rad: -26", r"zero_rad: give -25 to 25 rad \(is -26"),
        (ODRIVE, 'firmware: "0.6"', 'firmware: "0.7"', "firmware"),
        (ODRIVE, 'firmware: "0.6"', 'firmware: "0.5"', "torque_constant_nm_a"),
        (ODRIVE, "      - {node_id: 2, gear_ratio: 9, max_torque_nm: 2.2}\n", "", "one per joint"),
        (ODRIVE, "odrive_encoder, bus: motors", "odrive_encoder, bus: load_cell", "odrive_bus"),
        (ODRIVE, *(LINES[0], LINES[1].replace("?P<value>", "?P<force>")), "value"),
        (ODRIVE, *(LINES[0], LINES[1].replace(r"(?P<unit>\w+)", "((a+)+)")), "for ever"),
        (CUBEMARS, "model: AK60-6", "model: AK60-7", "AK60-6"),
        (CUBEMARS, "motor_id: 2", "motor_id: 1", "not all different"),
        (CUBEMARS, "motor_id: 2,", "motor_id: 2, answer_id: 18,", "'answer_id' is Damiao's"),
        (CUBEMARS, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 3", "3 is a motor's id"),
        (DAMIAO, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 0", "host_id"),
        (DAMIAO, "motor_id: 1,", "motor_id: 1, answer_id: 2,", "2 is a motor's id"),
        (DAMIAO, "motor_id: 1,", "motor_id: 1, answer_id: 18,", "18 is .* two motors"),
        (DAMIAO, "motor_id: 1,", "motor_id: 1, answer_id: 0x7ff,", "answer_id"),
        (DAMIAO, "motor_id: 1,", "motor_id: 16,", "'damiao' has at most 15"),
        (MOTEUS, "motor_id: 2", "motor_id: 1", "not all different"),
        (MOTEUS, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 3", "host_id 3 are not all different"),
        (MOTEUS, "socketcan", "slcan", "slcan carries no CAN FD"),
        (ROBSTRIDE, "motor_id: 1,", "motor_id: 128,", "'robstride' has at most 127"),
        (ROBSTRIDE, "watchdog_s: 0.1", "watchdog_s: 0.1\n    host_id: 256", "at most 255"),
        (
            MOTEUS,
            "gear_ratio: 2",
            "gear_ratio: 1e308",
            r"gear_ratio: give 0.001 to 10000 turns \(is 1e\+308\)",
        ),
        (DAMIAO, "watchdog_s: 0.1", "watchdog_s: 0.00002", "watchdog_s"),
        (CUBEMARS, "watchdog_s: 0.1", "watchdog_s: 0.1\n    check_watchdog: false", "check_watchdog"),
        (DAMIAO, "watchdog_s: 0.1", "ask_with: enter", "would power motors of 'damiao' in whatever mode"),
        (ROBSTRIDE, "watchdog_s: 0.1", "ask_with: enter", "would power motors of 'robstride'"),
        (CUBEMARS, "unit: N", "unit: bar", "not a known unit"),
        (CUBEMARS, "load_code: 100", "load_code: 100, rate_hz: 999", "1000"),
    ],
)
def test_a_wrong_robot_file_is_refused(path, old, new, problem):
    text = path.read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(InputError, match=problem):
        build_robot(parse_robot_file(text.replace(old, new, 1), path), DriverCatalogue(), SimulatedClock())
