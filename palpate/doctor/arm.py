"""Check an arm before it gets power, then check the signs of its joints and force sensor."""

from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.loop.loop import READ_SHARE
from palpate.doctor.limits import examine_limits
from palpate.doctor.machine import can_interface, serial_port
from palpate.doctor.signs import ArmOperator, EmulatedOperator, examine_powered, examine_signs
from palpate.robot_io.calibration.applied import find_large_zero_shift, load_calibrations
from palpate.robot_io.clock import Clock, MonotonicClock, SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import DeviceError, InputError, PalpateError, describe_error
from palpate.robot_io.examination import Examinable, Finding, Level, fail, graded, skip, warn
from palpate.robot_io.interfaces import Component, undo_all
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import Measurement, Status
from palpate.runs.robots import DEFAULT_SCENARIO, emulate, is_simulated
from palpate.runs.session import SIMULATED_DRIVERS
from palpate.sim_backend.scenario import load_scenario

_HELP = "see docs/how-to/hardware.md, 'First power-up'"
_WIRING = "see docs/how-to/hardware.md, 'Wiring'"
NOT_POWERED = warn(
    "drives",
    "not examined: the arm has no power",
    "run palpate doctor --move, and answer its question with yes",
)

_UNCHECKED = {  # by the calibration that checks it
    "encoder": skip("zeros", "checked only indirectly, by the torques above", "palpate calibrate encoder"),
    "force": skip(
        "scale of the force", "not checked: the press had no known force", "palpate calibrate force"
    ),
    "": skip("lengths of the links", "not checked: no command measures them", "measure from axis to axis"),
}


@dataclass(frozen=True)
class ArmCheck:
    """Which arm to examine, and which checks to run."""

    robot_file: RobotFile
    wired: bool = False  # whether its devices are emulated
    as_built: RobotFile | None = None  # how the emulated arm is built; None: as its robot file says
    move: bool = False  # whether the signs are checked too
    may_power: Callable[[], bool] = lambda: False  # asked before the arm gets power
    drivers: tuple[str, ...] = ()  # packages with further drivers


def examine_arm(check: ArmCheck) -> Iterator[Finding]:
    """Check limits, ports, devices and rates, then signs by hand and under power; stop after a failed stage.

    The torque stays off until `may_power` returns True, and it is off at the end.

    Args:
        check: the arm and the checks to run.

    Raises:
        InputError: the robot file names a part that does not exist or has invalid gains, or the arm cannot
            be emulated or moved by hand.
    """
    with ExitStack() as stack:
        drivers = DriverCatalog(SIMULATED_DRIVERS, *check.drivers)
        gains_of(check.robot_file)  # checked because every run needs them
        calibrations = load_calibrations(check.robot_file, emulated=check.wired)
        # Raises if the robot file is not valid.
        build_robot(check.robot_file, drivers, SimulatedClock(), calibrations)
        clock, robot_file, hand = _set_up(check, stack)
        body = RigidBody.of_robot(check.robot_file, calibrations)
        make = partial(build_robot, robot_file, drivers, clock, calibrations)
        shift_warning = find_large_zero_shift(calibrations.encoder) if calibrations.encoder else None

        def unpowered() -> Iterator[Finding]:
            robot = make()
            yield from examine_limits(robot_file, body)
            if shift_warning:
                remedy = "compare the angles in a known pose; if they differ, run palpate calibrate encoder"
                yield warn("zeros", shift_warning, remedy)
            ports = dict(_examine_ports(robot_file))
            yield from ports.values()
            closed = {bus for bus, finding in ports.items() if finding.level is Level.FAIL}
            yield from _examine_devices(robot, robot_file, closed)

        def powered(robot: Robot) -> Iterator[Finding]:
            return examine_powered(robot, robot_file, body, hand)

        stages: list[Callable[[], Iterator[Finding]]] = [
            unpowered,
            lambda: _with_robot(make, lambda robot: _examine_rates(robot, robot_file)),
        ]
        if check.move:
            stages += [
                lambda: _with_robot(make, lambda robot: examine_signs(robot, robot_file, body, hand)),
                lambda: _with_robot(make, powered) if check.may_power() else iter([NOT_POWERED]),
                lambda: (finding for kind, finding in _UNCHECKED.items() if kind not in calibrations.kinds),
            ]
        for stage in stages:
            failed = False
            for finding in stage():
                failed = failed or finding.level is Level.FAIL or finding is NOT_POWERED
                yield finding
            if failed:
                return


def _set_up(check: ArmCheck, stack: ExitStack) -> tuple[Clock, RobotFile, ArmOperator]:
    """Return the clock, the robot file of the devices, and the hand that moves the arm."""
    if check.wired:
        clock, scenario = SimulatedClock(), load_scenario(DEFAULT_SCENARIO)
        arm = emulate(check.robot_file, scenario, clock, as_built=check.as_built)
        stack.callback(arm.emulator.close)
        return clock, arm.robot_file, EmulatedOperator(arm.plant, arm.robot_file)
    if not is_simulated(check.robot_file):
        return MonotonicClock(), check.robot_file, ArmOperator()
    if check.move:
        raise InputError(f"--move: robot '{check.robot_file.name}' has no devices that can be moved by hand")
    return SimulatedClock(), check.robot_file, ArmOperator()


def _with_robot(make: Callable[[], Robot], look: Callable[[Robot], Iterator[Finding]]) -> Iterator[Finding]:
    """Open the whole arm for one stage, without torque, and close it afterwards."""
    try:
        with make() as robot:
            yield from look(robot)
    except InputError:
        raise
    except PalpateError as error:
        yield fail("arm", str(error), _HELP)
    except Exception as error:  # a user's driver may raise any exception, which is a finding
        yield fail("arm", describe_error(error), "correct the driver")


def _examine_ports(robot_file: RobotFile) -> Iterator[tuple[str, Finding]]:
    """Check serial ports (setting `port`) and SocketCAN interfaces (`channel`); yield bus and finding."""
    for name, bus in robot_file.buses.items():
        subject, port, channel = f"port of {name}", bus.settings.get("port"), bus.settings.get("channel")
        if isinstance(port, str) and port.startswith("/"):
            if not Path(port).exists():
                adapters = sorted(Path("/dev/serial/by-id").glob("*"))
                others = ", ".join(map(str, adapters)) or "none"
                remedy = f"plug the adapter in, or correct the robot file (connected adapters: {others})"
                yield name, fail(subject, f"{port}: is not there", remedy)
            elif not Path(port).is_char_device():
                yield name, fail(subject, f"{port}: is not a serial port", "correct the robot file")
            else:
                yield name, serial_port(subject, Path(port), Level.FAIL)
        elif bus.settings.get("interface") == "socketcan" and isinstance(channel, str):
            yield name, can_interface(subject, channel, Level.FAIL)


def _examine_devices(robot: Robot, robot_file: RobotFile, closed: Set[str]) -> Iterator[Finding]:
    """Configure each part of a new robot and yield its findings; close everything afterwards."""
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
                continue  # the finding of its bus says why
            problem, findings = "", list[Finding]()
            try:
                component.configure()
            except Exception as error:  # a user's driver may raise any exception, which is a finding
                problem = _error_text(error)
            if isinstance(component, Examinable):
                try:
                    findings += component.examine()
                except Exception as error:
                    problem = problem or _error_text(error)
            if problem and not any(finding.level is Level.FAIL for finding in findings):
                findings.insert(0, fail(label, problem, _WIRING))
            if bus is not None and any(finding.level is Level.FAIL for finding in findings):
                broken.add(bus)
            yield from findings
    finally:
        with suppress(DeviceError):  # a device that cannot be closed was reported before
            undo_all([(label, component) for label, component, _ in parts], "close")


def _error_text(error: Exception) -> str:
    return str(error) if isinstance(error, PalpateError) else f"its driver fails, {describe_error(error)}"


_WATCH_S = 0.5
_FULL_SHARE = 0.8  # share of a tick that a bus may use, so that late bytes have time
_REST_SHARE = 0.05  # share of the force limit; a larger reading in free air means a wrong zero
_FAR_RAD = 0.3
_VALUES = {
    "encoder": ("joint_position_rad", "joint_velocity_rad_s"),
    "torque": ("joint_torque_nm",),
    "force": ("force_n",),
}
_MICRO, _MILLI = 1e6, 1e3
_WARN, _FAIL = Level.WARN, Level.FAIL


def _examine_rates(robot: Robot, robot_file: RobotFile) -> Iterator[Finding]:
    """Read a configured robot for half a second at its control rate, without power, and check its samples."""
    period_s, limits = 1.0 / robot_file.control_rate_hz, robot_file.limits
    computed = list(_computed(robot, period_s))
    yield from computed
    if any(finding.level is Level.FAIL for finding in computed):
        return
    clock = robot.clock
    reading_s = list[float]()  # duration of each reading
    ticks = list[tuple[Measurement, Set[str]]]()  # measurements, each with the buses that failed
    bus_problems: dict[str, str] = {}  # last message of each bus
    next_s = clock.now_s()
    for _ in range(max(20, round(_WATCH_S / period_s))):
        next_s = max(next_s + period_s, clock.now_s())
        clock.sleep_until(next_s)
        begun_s = clock.now_s()
        measurement = robot.read(begun_s + READ_SHARE * period_s)
        reading_s.append(clock.now_s() - begun_s)
        ticks.append((measurement, set(robot.bus_errors)))
        bus_problems |= robot.bus_errors | robot.bus_delays
    skipped = min(10, len(ticks) // 2)  # the first samples may arrive late
    del reading_s[:skipped], ticks[:skipped]
    measurements = [measurement for measurement, _ in ticks]
    median_s, most_s = np.median(reading_s), np.quantile(reading_s, 0.99)
    value = (
        f"takes {median_s * _MICRO:.0f} us (median) of "
        f"{'simulated' if isinstance(clock, SimulatedClock) else 'real'} time, and at most "
        f"{most_s * _MICRO:.0f} us in 99 of 100 ticks"
    )
    remedy = (
        f"the control loop waits at most {READ_SHARE * period_s * _MICRO:.0f} us for a reading; see the "
        "lines 'rate of ...'"
    )
    yield graded("reading the arm", value, (_WARN, most_s > READ_SHARE * period_s, remedy))
    for device in ("encoder", "torque", "force"):
        bus = getattr(robot_file, device).bus
        yield _device(ticks, bus_problems.get(bus or ""), device, bus, getattr(limits, f"{device}_age_s"))
    position_rad = np.mean([m.joint_position_rad for m in measurements], axis=0)
    if np.isfinite(position_rad).all():  # missing samples were reported before
        ranges = zip(position_rad, limits.position_min_rad, limits.position_max_rad, strict=True)
        for number, (angle, low, high) in enumerate(ranges, 1):
            value = f"at {angle:+.3f} rad (limits {low:+.2f} to {high:+.2f})"
            remedy = (
                "move the joint inside its limits by hand, or correct its zero_rad and reversed in the "
                "robot file"
            )
            yield graded(f"joint {number}", value, (_FAIL, not low < angle < high, remedy))
        away_rad = position_rad - robot_file.home_rad
        joint = int(np.argmax(np.abs(away_rad)))
        value = f"joint {joint + 1} is farthest from home_rad, by {away_rad[joint]:+.2f} rad"
        remedy = (
            "bring the arm home by hand, because no command does; a run starts and ends where the arm stands"
        )
        yield graded("home", value, (_WARN, abs(away_rad[joint]) > _FAR_RAD, remedy))
    if np.isfinite([m.force_n for m in measurements]).all():
        forces_n = np.array([m.force_n for m in measurements])
        value = f"{forces_n.mean():+.3f} N without touching anything, noise {forces_n.std():.3f} N"
        beyond = abs(forces_n.mean()) > _REST_SHARE * limits.force_n
        if not beyond and np.ptp(forces_n) == 0.0:
            remedy = "tap the tool; if the reading does not change, the sensor is stuck"
            yield warn("force at rest", f"{value}: never changes", remedy)
        else:
            remedy = "remove any load from the tool, or tare the sensor; then calibrate it"
            yield graded("force at rest", value, (_WARN, beyond, remedy))


def _computed(robot: Robot, period_s: float) -> Iterator[Finding]:
    for name, bus in robot.buses.items():
        wire_s = bus.tick_wire_s() if isinstance(bus, Examinable) else None
        if wire_s is None:
            continue
        most_hz = _FULL_SHARE / wire_s
        value = (
            f"the bytes of a tick take {wire_s * _MICRO:.0f} us on the wire, and a tick lasts "
            f"{period_s * _MICRO:.0f} us; the wire allows at most {most_hz:.0f} Hz"
        )
        remedy = f"raise the bit rate, lower control_rate_hz to {most_hz:.0f}, or send less in each tick"
        too_much, nearly = wire_s > period_s, wire_s > _FULL_SHARE * period_s
        yield graded(f"rate of {name}", value, (_FAIL, too_much, remedy), (_WARN, nearly, remedy))


def _device(
    ticks: Sequence[tuple[Measurement, Set[str]]],
    fault_text: str | None,
    device: str,
    bus: str | None,
    limit_s: float,
) -> Finding:
    """Check a device's samples; a robot reports all devices of a failed bus as faulty."""
    measurements = [measurement for measurement, _ in ticks]
    subject, because = f"{device} samples", f": {fault_text}" if fault_text else ""
    at_s = np.array([getattr(m, f"{device}_at_s") for m in measurements])
    ages_s = np.array([m.time_s for m in measurements]) - at_s
    if not np.isfinite(ages_s).all():
        return fail(subject, "none came" + because, "check its wiring")
    new_s = np.unique(at_s)
    rate_hz = (len(new_s) - 1) / max(float(new_s[-1] - new_s[0]), 1e-9)
    value = (
        f"{rate_hz:.0f} samples per second, the oldest {ages_s.max() * _MILLI:.1f} ms old (limit "
        f"{limit_s * _MILLI:g} ms)"
    )
    if not all(np.isfinite(getattr(m, name)).all() for m in measurements for name in _VALUES[device]):
        return fail(
            subject, f"some values are not finite numbers{because}", "check its wiring and its driver"
        )
    statuses = {getattr(m, f"{device}_status") for m, failed in ticks if not failed or bus in failed}
    if ages_s.max() > limit_s or Status.FAULT in statuses:
        return fail(
            subject, value + because, "raise the device's sample rate, or find what delays its samples"
        )
    if saturated := Status.SATURATED in statuses:
        value += "; at the end of its range"
    return graded(subject, value, (_FAIL, saturated, "check its wiring and its range"))
