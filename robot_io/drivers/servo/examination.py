"""Looks at the servos of a line, and for those that are not where the robot file has them."""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, get_args

from palpate.robot_io.drivers.servo.access import RegisterAccess
from palpate.robot_io.drivers.servo.line import TWO_SERVOS, ServoLine, Survey, listed
from palpate.robot_io.drivers.servo.settings import ServoBusSettings
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError
from palpate.robot_io.examination import Finding, fail, warn
from palpate.robot_io.serial_port import SerialPort

TOO_HOT = "let it cool down; see what it pushes against, and lower its load"


def examine_line(
    settings: ServoBusSettings[Any], line: ServoLine, examine_servo: Callable[[int, str], Iterable[Finding]]
) -> list[Finding]:
    """Find out who is on the line, and look at every servo of the robot file.

    Args:
        settings: What the robot file says.
        line: The line, whose port is open and stays so.
        examine_servo: Looks at one servo that answers, by its id and label.

    Raises:
        DeviceError: The port failed.
    """
    answers, damaged = _ask_everybody(line, line.port)
    if not any(answers[servo_id] for servo_id in line.ids) and not damaged:
        return [_nobody(settings, line, answers)]
    strangers = sorted(answers.keys() - set(line.ids))
    others = f", but {_ids(strangers)}, which the robot file does not have" if strangers else ""
    findings: list[Finding] = []
    for servo_id, label in zip(line.ids, settings.labels, strict=True):
        if answers[servo_id] > 1:
            findings.append(fail(label, "answers twice", TWO_SERVOS))
        elif servo_id in damaged:
            findings.append(
                fail(label, "its answers are damaged", f"check cable and ground; or {TWO_SERVOS}")
            )
        elif not answers[servo_id]:
            remedy = "check its cable and power, or set its id"
            findings.append(fail(label, f"does not answer{others}", remedy))
        else:
            findings += _look_at(servo_id, label, examine_servo)
    if strangers:
        remedy = "take it off the line, or correct the ids"
        findings.append(warn("other servos", f"{_ids(strangers)} on the line too", remedy))
    return findings


def _look_at(
    servo_id: int, label: str, examine_servo: Callable[[int, str], Iterable[Finding]]
) -> list[Finding]:
    try:
        return list(examine_servo(servo_id, label))
    except DeviceTimeoutError as error:
        return [fail(label, f"answers now and then: {error}", "check plugs, cable and ground")]
    except DeviceError as error:
        return [fail(label, str(error), "correct the model or the id, or set the servo up")]


def _ask_everybody(line: ServoLine, port: SerialPort) -> Survey:
    """Ping all at once, and those of the robot file by themselves: some firmware answers only the latter."""
    port.read_all()
    request = line.dialect.ping_all()
    reader, answers = line.dialect.packet_reader(request), Counter[int]()
    port.write(request)
    deadline_s = line.clock.now_s() + line.ping_all_s
    while line.clock.now_s() < deadline_s:
        answers.update(packet.servo_id for packet in reader.feed(port.wait(deadline_s)))
    own = line.survey(RegisterAccess(line.dialect, port, line.clock))
    return Survey(answers | own.answers, own.damaged)  # the larger number of each


def _nobody(settings: ServoBusSettings[Any], line: ServoLine, answers: Counter[int]) -> Finding:
    """None of the servos answers: others may, or all of them at another baud rate."""
    if answers:
        value = f"{_ids(line.ids)} silent, on the line are {_ids(sorted(answers))}"
        return fail("servos", value, "correct the ids in the robot file or in the servos")
    for baud_rate in get_args(type(settings).model_fields["baud_rate"].annotation):
        there = _heard_at(line, baud_rate) if baud_rate != settings.baud_rate else []
        if there:
            value = f"silent at {settings.baud_rate} bit/s; at {baud_rate} bit/s: {_ids(there)}"
            return fail("servos", value, f"set baud_rate: {baud_rate}, or change it in the servos")
    return fail("servos", "nobody answers at any baud rate", "check power supply, cable and adapter")


def _heard_at(line: ServoLine, baud_rate: int) -> list[int]:
    line.port.close()
    port = SerialPort(line.port.path, baud_rate, line.clock)
    try:
        port.open()
        return sorted(+_ask_everybody(line, port).answers)
    except DeviceError:  # the adapter does not know this rate
        return []
    finally:
        port.close()
        line.port.open()


def _ids(ids: Iterable[int]) -> str:
    known = list(ids)
    return f"id{'s' if len(known) > 1 else ''} {listed(known)}"
