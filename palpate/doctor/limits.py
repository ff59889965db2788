"""Whether the limits of a robot file suit its arm, by the arm's own masses."""

from collections.abc import Iterator

import numpy as np

from control.arm.rigid_body import RigidBody
from palpate.doctor.finding import Finding, Level, fail, ok, warn
from palpate.doctor.loose_limits import examine_loose_limits
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray

_POSES = 400
_AGE_TICKS = 2.0  # a velocity is about so old when the arm acts on it
_LONG_WATCHDOG_S = 0.2


def examine_limits(robot_file: RobotFile, body: RigidBody) -> Iterator[Finding]:
    """Torque against weight, the brake against inertia, ages against the rate, watchdogs, loose limits."""
    if joint := body.weightless_joint:
        remedy = "give its links an <inertial>: the weight is held up by it, also in a stop"
        yield fail("masses", f"{robot_file.urdf_path}: joint '{joint}' moves no mass", remedy)
        return
    poses = _poses(robot_file)
    yield _weight(robot_file, body, poses)
    yield _brake(robot_file, body, poses)
    yield _ages(robot_file)
    for name, bus in robot_file.buses.items():
        watchdog_s = bus.settings.get("watchdog_s")
        if isinstance(watchdog_s, int | float):
            yield _watchdog(f"watchdog of {name}", watchdog_s, robot_file)
    heaviest_nm = float(np.abs([body.gravity(pose) for pose in poses]).max())
    yield from examine_loose_limits(robot_file, body, heaviest_nm)


def _poses(robot_file: RobotFile) -> FloatArray:
    """Home, and others spread over the joints' ranges, shape (poses, n) [rad]."""
    limits = robot_file.limits
    share = np.random.default_rng(0).uniform(size=(_POSES, robot_file.joint_count))
    low, high = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
    return np.vstack([robot_file.home_rad, low + share * (high - low)])


def _weight(robot_file: RobotFile, body: RigidBody, poses: FloatArray) -> Finding:
    limit_nm = np.array(robot_file.limits.torque_nm)
    needed_nm = np.abs([body.gravity(pose) for pose in poses])
    worst_nm = needed_nm.max(axis=0)
    value = f"{_listed(limit_nm)} N m allowed, the weight needs up to {_listed(worst_nm)} N m"
    if (needed_nm[0] >= limit_nm).any():
        return Finding(
            "torque limits",
            Level.FAIL,
            f"{value}, and {_listed(needed_nm[0])} N m at home",
            "raise torque_nm, or correct the URDF's masses",
        )
    if (worst_nm >= limit_nm).any():
        return warn("torque limits", value, "raise torque_nm, or narrow the position limits")
    return ok("torque limits", value)


def _brake(robot_file: RobotFile, body: RigidBody, poses: FloatArray) -> Finding:
    """See `robot_io.guard.SafeState`: a brake that is too strong for its own delay shakes the arm."""
    delay_s = (1 + _AGE_TICKS) / robot_file.control_rate_hz
    effective = [1.0 / np.diag(np.linalg.inv(body.mass_matrix(pose))) for pose in poses]
    most = np.min(effective, axis=0) / delay_s
    damping = np.array(robot_file.safe_state.damping_nms_rad)
    value = f"damping {_listed(damping)} N m s/rad, steady up to {_listed(most)}"
    if (damping > most).any():
        return warn("braking", value, "lower safe_state.damping_nms_rad, or the brake shakes the arm")
    if (damping == 0).any():
        return warn("braking", value, "a joint without damping is not braked in a stop: give it some")
    return ok("braking", value)


def _ages(robot_file: RobotFile) -> Finding:
    limits, tick_s = robot_file.limits, 1.0 / robot_file.control_rate_hz
    ages_s = {
        "encoder": limits.encoder_age_s,
        "torque": limits.torque_age_s,
        "force": limits.force_age_s,
    }
    value = ", ".join(f"{device} {1e3 * age_s:g} ms" for device, age_s in ages_s.items())
    if min(ages_s.values()) < 2 * tick_s:
        return warn(
            "age limits", value, f"a single lost sample stops the arm: allow {2e3 * tick_s:g} ms or more"
        )
    if max(ages_s.values()) > 50 * tick_s:
        return warn("age limits", value, "the arm would act on old samples: allow less")
    return ok("age limits", value)


def _watchdog(subject: str, watchdog_s: float, robot_file: RobotFile) -> Finding:
    value = f"the drives let go {1e3 * watchdog_s:g} ms after the last command"
    if watchdog_s * robot_file.control_rate_hz < 5:
        return warn(subject, value, "a late tick drops the arm: allow 5 ticks or more")
    if watchdog_s > _LONG_WATCHDOG_S:
        return warn(
            subject, value, f"the last torque acts that long on its own: {_LONG_WATCHDOG_S:g} s is enough"
        )
    return ok(subject, value)


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
