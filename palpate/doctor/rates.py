"""How fast the arm can be read, computed from bytes and measured, and what it then shows of itself."""

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass

import numpy as np

from control.loop.loop import READ_SHARE
from robot_io.clock import SimulatedClock
from robot_io.examination import Examinable, Finding, Level, fail, graded, warn
from robot_io.robot import Robot
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray, Measurement, Status

_WATCH_S = 0.5
_FULL_SHARE = 0.8  # of a tick; a bus that needs more has no time left for a late byte
_REST_SHARE = 0.05  # of the force limit; more without touching anything is a wrong zero
_FAR_RAD = 0.3
_VALUES = {
    "encoder": ("joint_position_rad", "joint_velocity_rad_s"),
    "torque": ("joint_torque_nm",),
    "force": ("force_n",),
}
_MICRO, _MILLI = 1e6, 1e3
_WARN, _FAIL = Level.WARN, Level.FAIL


@dataclass(frozen=True)
class _Watched:
    """What the arm showed in some ticks."""

    reading_s: FloatArray  # how long each reading took, shape (n,)
    measurements: tuple[Measurement, ...]
    failed: tuple[Set[str], ...]  # buses that failed in each tick
    complaints: Mapping[str, str]  # what each bus said of itself last


def examine_rates(robot: Robot, robot_file: RobotFile) -> Iterator[Finding]:
    """Read a configured robot for half a second at its control rate, without power."""
    period_s, limits = 1.0 / robot_file.control_rate_hz, robot_file.limits
    computed = list(_computed(robot, period_s))
    yield from computed
    if any(finding.level is Level.FAIL for finding in computed):
        return
    clock = robot.clock
    reading_s, measurements, failed = [], [], []
    complaints: dict[str, str] = {}
    next_s = clock.now_s()
    for _ in range(max(20, round(_WATCH_S / period_s))):
        next_s = max(next_s + period_s, clock.now_s())
        clock.sleep_until(next_s)
        begun_s = clock.now_s()
        measurements.append(robot.read(begun_s + READ_SHARE * period_s))
        reading_s.append(clock.now_s() - begun_s)
        failed.append(set(robot.bus_errors))
        complaints |= robot.bus_errors | robot.bus_delays
    skipped = min(10, len(measurements) // 2)  # the first samples are on their way
    watched = _Watched(
        np.array(reading_s[skipped:]), tuple(measurements[skipped:]), tuple(failed[skipped:]), complaints
    )
    yield _reading(watched, period_s, "simulated" if isinstance(robot.clock, SimulatedClock) else "real")
    for device in ("encoder", "torque", "force"):
        bus = getattr(robot_file, device).bus
        yield _device(watched, device, bus, getattr(limits, f"{device}_age_s"))
    position_rad = np.mean([m.joint_position_rad for m in watched.measurements], axis=0)
    if np.isfinite(position_rad).all():  # else there are no samples, which has been said
        yield from _joints(position_rad, robot_file)
        away_rad = position_rad - robot_file.home_rad
        joint = int(np.argmax(np.abs(away_rad)))
        value = f"joint {joint + 1} is {away_rad[joint]:+.2f} rad from home_rad, no joint is farther"
        remedy = (
            "nothing drives it there: bring it by hand; a run starts where it stands, and returns to that"
        )
        yield graded("home", value, (_WARN, abs(away_rad[joint]) > _FAR_RAD, remedy))
    if np.isfinite([m.force_n for m in watched.measurements]).all():
        yield _force(watched, limits.force_n)


def _computed(robot: Robot, period_s: float) -> Iterator[Finding]:
    for name, bus in robot.buses.items():
        wire_s = bus.tick_wire_s() if isinstance(bus, Examinable) else None
        if wire_s is None:
            continue
        most_hz = _FULL_SHARE / wire_s
        value = (
            f"{wire_s * _MICRO:.0f} us of each {period_s * _MICRO:.0f} us on the wire, by its bytes: "
            f"good for {most_hz:.0f} Hz"
        )
        remedy = f"raise the bit rate, lower control_rate_hz to {most_hz:.0f}, or have less sent in a tick"
        too_much, nearly = wire_s > period_s, wire_s > _FULL_SHARE * period_s
        yield graded(f"rate of {name}", value, (_FAIL, too_much, remedy), (_WARN, nearly, remedy))


def _reading(watched: _Watched, period_s: float, kind: str) -> Finding:
    median_s, most_s = np.median(watched.reading_s), np.quantile(watched.reading_s, 0.99)
    value = (
        f"takes {median_s * _MICRO:.0f} us, and up to {most_s * _MICRO:.0f} us in 99 of 100 ticks, "
        f"of {kind} time"
    )
    remedy = f"the loop waits {READ_SHARE * period_s * _MICRO:.0f} us: see the rates"
    return graded("reading the arm", value, (_WARN, most_s > READ_SHARE * period_s, remedy))


def _device(watched: _Watched, device: str, bus: str | None, limit_s: float) -> Finding:
    """What a device's samples show; a robot calls all devices faulty where the bus of one has failed."""
    complaint = watched.complaints.get(bus or "")
    subject, because = f"{device} samples", f": {complaint}" if complaint else ""
    at_s = np.array([getattr(m, f"{device}_at_s") for m in watched.measurements])
    ages_s = np.array([m.time_s for m in watched.measurements]) - at_s
    if not np.isfinite(ages_s).all():
        return fail(subject, "none came" + because, "check its wiring")
    new_s = np.unique(at_s)
    rate_hz = (len(new_s) - 1) / max(float(new_s[-1] - new_s[0]), 1e-9)
    value = (
        f"{rate_hz:.0f} a second, the oldest {ages_s.max() * _MILLI:.1f} ms old (limit {limit_s * _MILLI:g})"
    )
    if not all(np.isfinite(getattr(m, name)).all() for m in watched.measurements for name in _VALUES[device]):
        return fail(subject, f"some are not a number{because}", "check its wiring and its driver")
    ticks = zip(watched.measurements, watched.failed, strict=True)
    statuses = {getattr(m, f"{device}_status") for m, failed in ticks if not failed or bus in failed}
    if ages_s.max() > limit_s or Status.FAULT in statuses:
        return fail(subject, value + because, "raise its rate, or see what holds it up")
    if saturated := Status.SATURATED in statuses:
        value += "; at the end of its range"
    return graded(subject, value, (_FAIL, saturated, "check its wiring and its range"))


def _joints(position_rad: FloatArray, robot_file: RobotFile) -> Iterator[Finding]:
    limits = robot_file.limits
    ranges = zip(position_rad, limits.position_min_rad, limits.position_max_rad, strict=True)
    for joint, (angle, low, high) in enumerate(ranges, 1):
        value = f"at {angle:+.3f} rad (limits {low:+.2f} to {high:+.2f})"
        remedy = "move it inside by hand, or correct its zero_rad and reversed"
        yield graded(f"joint {joint}", value, (_FAIL, not low < angle < high, remedy))


def _force(watched: _Watched, limit_n: float) -> Finding:
    forces_n = np.array([m.force_n for m in watched.measurements])
    value = f"{forces_n.mean():+.3f} N without touching anything, noise {forces_n.std():.3f} N"
    beyond = abs(forces_n.mean()) > _REST_SHARE * limit_n
    if not beyond and np.ptp(forces_n) == 0.0:
        return warn("force at rest", f"{value}: never changes", "tap the tool; if nothing moves, it is stuck")
    remedy = "take load off the tool, or tare the sensor; then calibrate it"
    return graded("force at rest", value, (_WARN, beyond, remedy))
