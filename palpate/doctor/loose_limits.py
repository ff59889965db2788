"""Limits that are none: so wide that the guard would never stop the arm, or only too late."""

from collections.abc import Iterator

import numpy as np

from control.arm.rigid_body import RigidBody
from palpate.doctor.finding import Finding, fail, ok, warn
from robot_io.drivers.serial_force.text import newtons_per
from robot_io.guard import Limits
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray

_WEIGHTS = 10.0  # times the largest torque of the arm's own weight: no task of palpate's needs more
_SPEEDS = 2.0  # times the URDF's speed: a servo that is driven, not one that drives
_WIDE_TRACKING_RAD, _NO_TRACKING_RAD = 0.3, 1.0
_ROUNDING_RAD = 1e-3
_WITNESSES = ("deaf_drive_s", "stuck_encoder_s", "stuck_force_s")
_LONG_WITNESS_S, _NO_WITNESS_S = 0.1, 1.0


def examine_loose_limits(robot_file: RobotFile, body: RigidBody, heaviest_nm: float) -> Iterator[Finding]:
    """Force against the sensor; torque, position and speed against the URDF; tracking; lying devices.

    Args:
        robot_file: the arm.
        body: the same arm.
        heaviest_nm: largest torque of its own weight [N m].
    """
    yield _force(robot_file)
    yield _torque(robot_file, body, heaviest_nm)
    yield _position(robot_file, body)
    yield _velocity(robot_file, body)
    yield _tracking(robot_file)
    yield from (_witness(name, robot_file) for name in _WITNESSES)


def _force(robot_file: RobotFile) -> Finding:
    limit_n, capacity_n = robot_file.limits.force_n, _capacity_n(robot_file)
    if capacity_n is None:
        return ok("force limit", f"{limit_n:g} N; the robot file does not say how much the sensor can take")
    value = f"{limit_n:g} N, the sensor ends at {capacity_n:g} N"
    if limit_n >= capacity_n:
        return fail(
            "force limit", value, "the guard would never see it: lower force_n, or correct the capacity"
        )
    return ok("force limit", value)


def _capacity_n(robot_file: RobotFile) -> float | None:
    """By the settings of the sensor's driver: `capacity_n`, or `nominal_load` in `unit`."""
    settings = robot_file.force.settings
    capacity_n, load, unit = (settings.get(key) for key in ("capacity_n", "nominal_load", "unit"))
    if isinstance(capacity_n, int | float):
        return float(capacity_n)
    if isinstance(load, int | float) and isinstance(unit, str):
        return load * newtons_per(unit)
    return None


def _torque(robot_file: RobotFile, body: RigidBody, heaviest_nm: float) -> Finding:
    limit_nm, effort_nm = np.array(robot_file.limits.torque_nm), body.torque_limits_nm
    value = f"{_listed(limit_nm)} N m, the URDF's effort is {_listed(effort_nm)} N m"
    if _beyond(limit_nm, effort_nm):
        return fail("highest torques", value, "lower torque_nm, or correct the URDF's effort")
    if 0.1 < _WEIGHTS * heaviest_nm < limit_nm.max():
        value += f", and the weight needs {heaviest_nm:.3g} N m"
        return warn("highest torques", value, "lower torque_nm: begin with what carries the arm and presses")
    return ok("highest torques", value)


def _position(robot_file: RobotFile, body: RigidBody) -> Finding:
    low_rad, high_rad = body.position_limits_rad
    low, high = np.array(robot_file.limits.position_min_rad), np.array(robot_file.limits.position_max_rad)
    beyond = (low < low_rad - _ROUNDING_RAD) | (high > high_rad + _ROUNDING_RAD)
    if not beyond.any():
        return ok("position limits", "within the URDF's")
    joint = int(np.argmax(beyond))
    value = (
        f"joint {joint + 1} from {low[joint]:g} to {high[joint]:g} rad, "
        f"in the URDF from {low_rad[joint]:g} to {high_rad[joint]:g}"
    )
    return fail(
        "position limits", value, "it would meet its stop: narrow position_min_rad and position_max_rad"
    )


def _velocity(robot_file: RobotFile, body: RigidBody) -> Finding:
    limit_rad_s, urdf_rad_s = np.array(robot_file.limits.velocity_rad_s), body.velocity_limits_rad_s
    value = f"{_listed(limit_rad_s)} rad/s, the URDF's are {_listed(urdf_rad_s)} rad/s"
    if _beyond(limit_rad_s, _SPEEDS * urdf_rad_s):
        return fail("velocity limits", value, "the guard would stop nothing: lower velocity_rad_s")
    return ok("velocity limits", value)


def _tracking(robot_file: RobotFile) -> Finding:
    widest_rad = max(robot_file.limits.tracking_rad)
    value = f"up to {widest_rad:g} rad from the path"
    remedy = "lower tracking_rad: 0.1 rad is what a well-tuned arm keeps"
    if widest_rad > _NO_TRACKING_RAD:
        return fail("tracking limits", value, remedy)
    if widest_rad > _WIDE_TRACKING_RAD:
        return warn("tracking limits", value, remedy)
    return ok("tracking limits", value)


def _witness(name: str, robot_file: RobotFile) -> Finding:
    """How long a device may go on answering and be wrong; in less than a tick it answers once at most."""
    limit_s, tick_s = float(getattr(robot_file.limits, name)), 1.0 / robot_file.control_rate_hz
    usual_s = float(Limits.model_fields[name].default)
    value = f"{1e3 * limit_s:g} ms"
    if limit_s < tick_s * (1.0 - 1e-9):
        value += f", less than a tick of {1e3 * tick_s:g} ms, in which nothing can be told"
        return fail(name, value, f"raise it to some ticks: {max(usual_s, 5 * tick_s):g} s")
    if limit_s > _NO_WITNESS_S:
        return fail(name, value, f"the guard would come too late: lower it to {usual_s:g} s, or leave it out")
    if limit_s > _LONG_WITNESS_S:
        return warn(name, value, f"the arm would long act on what is wrong: {usual_s:g} s is usual")
    return ok(name, value)


def _beyond(limits: FloatArray, most: FloatArray) -> bool:
    """Whether a limit is above what is stated; 0 states nothing."""
    return bool(((most > 0) & (limits > most)).any())


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
