"""Who is at the other end of each bus, as far as its driver can tell. Nothing is powered."""

from collections.abc import Iterator, Set

from palpate.doctor.finding import Finding, Level, fail
from robot_io.errors import DeviceError, PalpateError, in_words
from robot_io.examination import Examinable, Observation, Verdict
from robot_io.interfaces import Component
from robot_io.lifecycle import undo_all
from robot_io.robot import Robot
from robot_io.robot_file import RobotFile

_REMEDY = "see docs/hardware.md, 'Wiring'"


def examine_devices(robot: Robot, robot_file: RobotFile, closed: Set[str]) -> Iterator[Finding]:
    """Configure each part by itself and ask it what it found; everything is closed at the end.

    Args:
        robot: a new one, for this examination alone.
        robot_file: the same arm.
        closed: buses whose port cannot be opened, which has been said.
    """
    parts: list[tuple[str, Component, str | None]] = [
        *((f"bus {name}", bus, name) for name, bus in robot.buses.items()),
        ("encoder", robot.encoder, robot_file.encoder.bus),
        ("force sensor", robot.force, robot_file.force.bus),
        ("drives", robot.torque, robot_file.torque.bus),
    ]
    broken = set(closed)
    try:
        for label, component, bus in parts:
            if bus in broken:
                continue  # its bus has said why
            findings = list(_examine(label, component))
            if bus is not None and any(finding.level is Level.FAIL for finding in findings):
                broken.add(bus)
            yield from findings
    finally:
        _let_go(parts)


def _examine(label: str, component: Component) -> Iterator[Finding]:
    problem = ""
    observations: tuple[Observation, ...] = ()
    try:
        component.configure()
    except Exception as error:  # a driver of somebody's own may fail with anything: that is a finding
        problem = _in_words(error)
    if isinstance(component, Examinable):
        try:
            observations = component.examine()
        except Exception as error:
            problem = problem or _in_words(error)
    if problem and not any(seen.verdict is Verdict.FAIL for seen in observations):
        yield fail(label, problem, _REMEDY)
    yield from map(_finding, observations)


def _in_words(error: Exception) -> str:
    return str(error) if isinstance(error, PalpateError) else f"its driver fails, {in_words(error)}"


def _finding(seen: Observation) -> Finding:
    return Finding(seen.subject, Level(seen.verdict.value), seen.value, seen.remedy)


def _let_go(parts: list[tuple[str, Component, str | None]]) -> None:
    """Close everything; what does not let itself be closed has been found broken already."""
    try:
        undo_all([(label, component) for label, component, _ in parts], "close")
    except DeviceError:
        return
