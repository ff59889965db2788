"""All that is looked at before an arm gets power, and then its signs, in the order in which it is shown."""

from collections.abc import Callable, Iterator, Set
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from palpate.doctor.hand import EmulatedHand, Hand
from palpate.doctor.limits import examine_limits
from palpate.doctor.machine import can_interface, serial_port
from palpate.doctor.nudge import examine_powered
from palpate.doctor.rates import examine_rates
from palpate.doctor.signs import count_down, examine_signs
from palpate.runs.robots import DEFAULT_SCENARIO, emulate, is_simulated
from palpate.runs.session import SIMULATED_DRIVERS
from robot_io.calibration import doubtful, load_calibrations
from robot_io.clock import Clock, MonotonicClock, SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.errors import DeviceError, InputError, PalpateError, describe_error
from robot_io.examination import Examinable, Finding, Level, fail, warn
from robot_io.interfaces import Component, undo_all
from robot_io.robot import Robot, build_robot
from robot_io.robot_file import RobotFile
from sim_backend.scenario import load_scenario

_HELP = "see docs/how-to/hardware.md, 'First power-up'"
_WIRING = "see docs/how-to/hardware.md, 'Wiring'"
NOT_POWERED = warn(
    "drives", "not examined: the arm got no power", "palpate doctor --move, and a yes to its question"
)


@dataclass(frozen=True)
class ArmCheck:
    """What is to be examined, and how far."""

    robot_file: RobotFile
    wired: bool = False  # emulate its devices
    as_built: RobotFile | None = None  # the emulated arm as it is put together; None: as its robot file says
    move: bool = False  # whether its signs are looked at too
    may_power: Callable[[], bool] = lambda: False  # asked before the arm gets power
    drivers: tuple[str, ...] = ()  # packages with drivers beside palpate's own


def examine_arm(check: ArmCheck) -> Iterator[Finding]:
    """Limits, ports, devices, rates; then signs by hand; then a small motion. A failed stage is the last.

    The torque stays off until `may_power` has said yes, and it is off at the end.

    Raises:
        InputError: the robot file names what does not exist, has gains that no run takes, or cannot be
            emulated or moved by hand.
    """
    with ExitStack() as stack:
        drivers = DriverCatalogue(SIMULATED_DRIVERS, *check.drivers)
        gains_of(check.robot_file)  # nothing here needs them, and every run does
        calibrations = load_calibrations(check.robot_file, emulated=check.wired)
        build_robot(check.robot_file, drivers, SimulatedClock(), calibrations)  # what is replaced is valid
        clock, robot_file, hand = _set_up(check, stack)
        body = RigidBody.of_robot(check.robot_file, calibrations)
        make = partial(build_robot, robot_file, drivers, clock, calibrations)
        doubt = doubtful(calibrations.encoder) if calibrations.encoder else None

        def powered(robot: Robot) -> Iterator[Finding]:
            objections = list(count_down(robot, hand))
            yield from objections or examine_powered(robot, robot_file, body)

        stages: list[Callable[[], Iterator[Finding]]] = [
            lambda: _unpowered(make(), robot_file, body, doubt),
            lambda: _with_robot(make, lambda robot: examine_rates(robot, robot_file)),
        ]
        if check.move:
            stages += [
                lambda: _with_robot(make, lambda robot: examine_signs(robot, body, hand)),
                lambda: _with_robot(make, powered) if check.may_power() else iter([NOT_POWERED]),
            ]
        for stage in stages:
            failed = False
            for finding in stage():
                failed = failed or finding.level is Level.FAIL
                yield finding
            if failed:
                return


def _set_up(check: ArmCheck, stack: ExitStack) -> tuple[Clock, RobotFile, Hand]:
    """The clock, the robot file that leads to the devices, and who moves the arm."""
    if check.wired:
        clock, scenario = SimulatedClock(), load_scenario(DEFAULT_SCENARIO)
        arm = emulate(check.robot_file, scenario, clock, as_built=check.as_built)
        stack.callback(arm.bench.close)
        return clock, arm.robot_file, EmulatedHand(arm.plant, arm.robot_file)
    if not is_simulated(check.robot_file):
        return MonotonicClock(), check.robot_file, Hand()
    if check.move:
        raise InputError(
            f"--move: robot '{check.robot_file.name}' is simulated without devices: no hand can move it"
        )
    return SimulatedClock(), check.robot_file, Hand()


def _unpowered(robot: Robot, robot_file: RobotFile, body: RigidBody, doubt: str | None) -> Iterator[Finding]:
    yield from examine_limits(robot_file, body)
    if doubt:
        yield warn("zeros", doubt, "hold the arm in a known pose and compare; else palpate calibrate encoder")
    ports = dict(examine_ports(robot_file))
    yield from ports.values()
    closed = {bus for bus, finding in ports.items() if finding.level is Level.FAIL}
    yield from examine_devices(robot, robot_file, closed)


def _with_robot(make: Callable[[], Robot], look: Callable[[Robot], Iterator[Finding]]) -> Iterator[Finding]:
    """Open the whole arm for one stage; it is closed, and so without torque, when the stage ends."""
    try:
        with make() as robot:
            yield from look(robot)
    except InputError:
        raise
    except PalpateError as error:
        yield fail("arm", str(error), _HELP)
    except Exception as error:  # a driver of somebody's own may fail with anything: that is a finding
        yield fail("arm", describe_error(error), "correct the driver")


def examine_ports(robot_file: RobotFile) -> Iterator[tuple[str, Finding]]:
    """Serial ports (setting `port`) and SocketCAN interfaces (setting `channel`), with the bus of each.

    They are only looked at, not opened.
    """
    for name, bus in robot_file.buses.items():
        subject, port, channel = f"port of {name}", bus.settings.get("port"), bus.settings.get("channel")
        if isinstance(port, str) and port.startswith("/"):
            yield name, _port(subject, Path(port))
        elif bus.settings.get("interface") == "socketcan" and isinstance(channel, str):
            yield name, can_interface(subject, channel, Level.FAIL)


def _port(subject: str, port: Path) -> Finding:
    if not port.exists():
        there = sorted(Path("/dev/serial/by-id").glob("*"))
        others = ", ".join(map(str, there)) or "no USB adapter is connected"
        return fail(subject, f"{port}: is not there", f"plug it in, or correct the robot file ({others})")
    if not port.is_char_device():
        return fail(subject, f"{port}: is no serial port", "correct the robot file")
    return serial_port(subject, port, Level.FAIL)


def examine_devices(robot: Robot, robot_file: RobotFile, closed: Set[str]) -> Iterator[Finding]:
    """Configure each part of a new robot by itself and ask it what it found; everything is closed at the end.

    Of the `closed` buses the port cannot be opened, which has been said.
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
        with suppress(DeviceError):  # what does not let itself be closed has been found broken already
            undo_all([(label, component) for label, component, _ in parts], "close")


def _examine(label: str, component: Component) -> Iterator[Finding]:
    problem = ""
    seen: tuple[Finding, ...] = ()
    try:
        component.configure()
    except Exception as error:  # a driver of somebody's own may fail with anything: that is a finding
        problem = _in_words(error)
    if isinstance(component, Examinable):
        try:
            seen = component.examine()
        except Exception as error:
            problem = problem or _in_words(error)
    if problem and not any(finding.level is Level.FAIL for finding in seen):
        yield fail(label, problem, _WIRING)
    yield from seen


def _in_words(error: Exception) -> str:
    return str(error) if isinstance(error, PalpateError) else f"its driver fails, {describe_error(error)}"
