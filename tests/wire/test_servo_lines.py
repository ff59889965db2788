"""Servo lines that contradict the robot file: ids, baud rate, temperature."""

import pytest

from palpate.robot_io.errors import DeviceError
from palpate.robot_io.examination import Level
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import DYNAMIXEL, SO101

LINES = pytest.mark.parametrize("path", [DYNAMIXEL, SO101], ids=["dynamixel", "feetech"])


def examined(arm):
    return {finding.subject: finding for finding in arm.robot.buses["motors"].examine()}


@LINES
@pytest.mark.parametrize(
    ("kind", "refused", "examined_as"),
    [
        (FaultKind.DUPLICATE, "servo 3 answers twice: two servos have this id", "answers twice"),
        (FaultKind.CORRUPT, "damaged answers from servo 3: do two servos have", "its answers are damaged"),
    ],
)
def test_two_servos_with_one_id_are_hinted_at(make_robot, path, kind, refused, examined_as):
    """One answers after the other, or both at once, which spoils both answers."""
    arm = make_robot(path)
    arm.inject_fault("motors", kind, device=3)
    with pytest.raises(DeviceError, match=refused):
        arm.robot.buses["motors"].configure()
    (finding,) = [found for subject, found in examined(arm).items() if subject.startswith("servo 3 ")]
    assert (finding.level, finding.text) == (Level.FAIL, examined_as)
    assert "two servos have this id" in finding.remedy


@LINES
def test_servos_at_another_baud_rate_are_detected(make_robot, path):
    arm = make_robot(path)
    line, rate = arm.arm.wires["motors"], 115_200
    line._port.baud_rate, stated = rate, line._port.baud_rate
    with pytest.raises(DeviceError, match=f"at {stated} bit/s"):
        arm.robot.buses["motors"].configure()
    (finding,) = examined(arm).values()
    ids = ", ".join(map(str, sorted(line.servos)))
    assert finding.text == f"silent at {stated} bit/s; answering at {rate} bit/s: ids {ids}"
    assert finding.remedy.startswith(f"set baud_rate: {rate}")
    assert {finding.text for finding in examined(arm).values()} == {finding.text}  # the port is open again


def test_unpowered_line_is_distinguished_from_wrong_baud_rate(make_robot):
    arm = make_robot(SO101)
    arm.inject_fault("motors", FaultKind.DROP)
    with pytest.raises(DeviceError, match="no answer from servo 2, 3, 4, 1, 5"):
        arm.robot.buses["motors"].configure()
    assert examined(arm)["servos"].text == "no servo answers at any baud rate"


def test_feetech_servos_missing_from_the_robot_file_are_detected(make_robot):
    arm = make_robot(SO101)
    line = arm.arm.wires["motors"]
    stranger = line.servos.pop(3)
    stranger.id = 9
    line.servos[9] = stranger
    with pytest.raises(DeviceError, match="no answer from servo 3"):
        arm.robot.buses["motors"].configure()
    findings = examined(arm)
    said = "does not answer, but id 9, which the robot file does not list"
    assert findings["servo 3 (joint 2)"].text == said
    assert findings["other servos"].level is Level.WARN


@LINES
@pytest.mark.parametrize(("celsius", "level"), [(70, Level.OK), (81, Level.WARN)])
def test_overheated_servo_is_a_warning(make_robot, path, celsius, level):
    """As delivered, 80 degrees for these Dynamixel servos and 70 for Feetech's."""
    arm = make_robot(path)
    arm.robot.configure()
    servo = arm.servos[3]
    if path is DYNAMIXEL:
        servo.memory.put(146, celsius)
    else:
        servo.put(63, celsius, 1)
    (finding,) = [
        found
        for found in arm.robot.buses["motors"].examine()
        if found.subject.startswith("servo 3 ") and f"{celsius} °C" in found.text
    ]
    assert finding.level is level
    assert ("cool down" in finding.remedy) == (level is Level.WARN)
