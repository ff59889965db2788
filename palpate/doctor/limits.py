"""Check that the limits of a robot file suit its arm: neither too tight nor too wide."""

from collections.abc import Iterator

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.drivers.serial_force.stream import newtons_per
from palpate.robot_io.examination import Finding, Level, fail, graded, ok
from palpate.robot_io.guard import Limits
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray

POSES = 400
_AGE_TICKS = 2.0  # age of a velocity when the arm acts on it, in ticks
_LONG_WATCHDOG_S = 0.2
_WEIGHTS = 10.0  # multiple of the arm's largest gravity torque, enough for all tasks
_SPEEDS = 2.0  # multiple of the URDF's speed, above the speed that a servo can reach
_WIDE_TRACKING_RAD, _NO_TRACKING_RAD = 0.3, 1.0
_ROUNDING_RAD = 1e-3
_STILL_M, _OUTWARDS = 1e-3, 0.5  # motion per rad, and cosine between the tool's direction and its last link
_PLAIN_SHARE = 0.3  # share of a direction from which an axis is mentioned
_DIRECTIONS = (("forwards", "backwards"), ("to the left", "to the right"), ("up", "down"))
_LATCHES = ("unresponsive_drive_s", "stuck_encoder_s", "stuck_force_s")
_LONG_LATCH_S, _NO_LATCH_S = 0.1, 1.0
_WARN, _FAIL = Level.WARN, Level.FAIL


def examine_limits(robot_file: RobotFile, body: RigidBody) -> Iterator[Finding]:
    """Check torque, brake, ages, watchdogs and the other limits of a robot file.

    Args:
        robot_file: robot file of the arm.
        body: rigid-body model of the arm.
    """
    if joint := body.weightless_joint:
        remedy = "give its links an <inertial>; gravity compensation needs it, even during a stop"
        yield fail("masses", f"{robot_file.urdf_path}: joint '{joint}' moves no mass", remedy)
        return
    limits, tick_s = robot_file.limits, 1.0 / robot_file.control_rate_hz
    poses_rad = np.vstack([robot_file.home_rad, random_poses_rad(limits)])
    weight_nm = np.abs([body.gravity(pose) for pose in poses_rad])
    limit_nm, worst_nm, home_nm = np.array(limits.torque_nm), weight_nm.max(axis=0), weight_nm[0]
    value = f"{_listed(limit_nm)} N m allowed; the arm's weight needs up to {_listed(worst_nm)} N m"
    if (home_nm >= limit_nm).any():
        remedy = "raise torque_nm, or correct the URDF's masses"
        yield fail("torque limits", f"{value}, and {_listed(home_nm)} N m at home", remedy)
    else:
        remedy = "raise torque_nm, or narrow the position limits"
        yield graded("torque limits", value, (_WARN, (worst_nm >= limit_nm).any(), remedy))
    # With too much gain for its delay, the brake shakes the arm (see `SafeState`).
    effective = [1.0 / np.diag(np.linalg.inv(body.mass_matrix(pose))) for pose in poses_rad]
    stable = np.array(effective) / ((1 + _AGE_TICKS) * tick_s)  # largest stable damping in each pose
    most = stable.min(axis=0)
    damping = np.array(robot_file.safe_state.damping_nms_rad)
    shakes = "lower safe_state.damping_nms_rad, otherwise braking shakes the arm"
    yield graded(
        "braking",
        f"damping {_listed(damping)} N m s/rad, stable up to {_listed(most)}",
        (_FAIL, (damping > stable.max(axis=0)).any(), shakes),
        (
            _FAIL,
            (damping == 0).all(),
            "no joint is braked in a stop: raise safe_state.damping_nms_rad above 0",
        ),
        (_WARN, (damping > most).any(), shakes),
        (
            _WARN,
            (damping == 0).any(),
            "a joint without damping is not braked in a stop: raise its safe_state.damping_nms_rad above 0",
        ),
    )
    ages_s = {name: getattr(limits, f"{name}_age_s") for name in ("encoder", "torque", "force")}
    lost = f"a single lost sample stops the arm: raise the limit to {2e3 * tick_s:g} ms or more"
    old = "the arm would act on old samples: lower the limit"
    yield graded(
        "age limits",
        ", ".join(f"{device} {1e3 * age_s:g} ms" for device, age_s in ages_s.items()),
        (_FAIL, max(ages_s.values()) > _NO_LATCH_S, old),
        (_WARN, min(ages_s.values()) < 2 * tick_s, lost),
        (_WARN, max(ages_s.values()) > 50 * tick_s, old),
    )
    for name, bus in robot_file.buses.items():
        watchdog_s = bus.settings.get("watchdog_s")
        if isinstance(watchdog_s, int | float):
            long = (
                f"the drive holds its last torque for this long: lower watchdog_s to {_LONG_WATCHDOG_S:g} "
                "or less"
            )
            yield graded(
                f"watchdog of {name}",
                f"according to the robot file, the drives switch off {1e3 * watchdog_s:g} ms after the last "
                "command",
                (
                    _WARN,
                    watchdog_s < 5 * tick_s,
                    f"a late tick cuts the torque: raise watchdog_s to {5 * tick_s:g} (5 ticks) or more",
                ),
                (_WARN, watchdog_s > _LONG_WATCHDOG_S, long),
            )
    yield _force(robot_file)
    yield _sensor_axis(robot_file, body)
    yield _torque(limits, body, float(weight_nm.max()))
    yield _position(limits, body)
    limit_rad_s, urdf_rad_s = np.array(limits.velocity_rad_s), body.velocity_limits_rad_s
    beyond = _exceeds_any(limit_rad_s, _SPEEDS * urdf_rad_s)
    value = f"{_listed(limit_rad_s)} rad/s; the URDF states {_listed(urdf_rad_s)} rad/s"
    remedy = "the guard would never stop the arm; lower velocity_rad_s"
    yield graded("velocity limits", value, (_FAIL, beyond, remedy))
    widest_rad = max(limits.tracking_rad)
    remedy = "lower tracking_rad: a well-tuned arm stays within 0.1 rad"
    yield graded(
        "tracking limits",
        f"the guard allows up to {widest_rad:g} rad from the path",
        (_FAIL, widest_rad > _NO_TRACKING_RAD, remedy),
        (_WARN, widest_rad > _WIDE_TRACKING_RAD, remedy),
    )
    for name in _LATCHES:  # how long a faulty device is tolerated; within less than a tick it answers once
        limit_s, usual_s = float(getattr(limits, name)), float(Limits.model_fields[name].default)
        value, too_short = f"{1e3 * limit_s:g} ms", limit_s < tick_s * (1.0 - 1e-9)
        if too_short:
            value += f", less than a tick of {1e3 * tick_s:g} ms, too short to detect anything"
        late = f"the guard would react too late: lower it to {usual_s:g} s, or leave it out of the robot file"
        yield graded(
            name,
            value,
            (_FAIL, too_short, f"raise it to several ticks: {max(usual_s, 5 * tick_s):g} s"),
            (_FAIL, limit_s > _NO_LATCH_S, late),
            (
                _WARN,
                limit_s > _LONG_LATCH_S,
                f"a fault would act for too long: lower it to {usual_s:g} s, the usual value",
            ),
        )


def random_poses_rad(limits: Limits) -> FloatArray:
    """Draw poses over the joints' ranges, shape (poses, n) [rad].

    Args:
        limits: limits with the joints' ranges [rad].
    """
    low, high = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
    return np.random.default_rng(0).uniform(low, high, (POSES, len(low)))


def _force(robot_file: RobotFile) -> Finding:
    """Check the force limit against the sensor's `capacity_n`, or `nominal_load` in `unit`."""
    limit_n, settings = robot_file.limits.force_n, robot_file.force.settings
    capacity_n, load, unit = (settings.get(key) for key in ("capacity_n", "nominal_load", "unit"))
    if isinstance(load, int | float) and isinstance(unit, str) and not isinstance(capacity_n, int | float):
        capacity_n = load * newtons_per(unit)
    if not isinstance(capacity_n, int | float):
        return ok("force limit", f"{limit_n:g} N; the robot file does not state the sensor's range")
    remedy = "the sensor saturates before the guard stops the arm; lower force_n, or correct the capacity"
    value = f"{limit_n:g} N, but the sensor's range ends at {capacity_n:g} N"
    return graded("force limit", value, (_FAIL, limit_n >= capacity_n, remedy))


def _sensor_axis(robot_file: RobotFile, body: RigidBody) -> Finding:
    """Check that the tool pushes away from its last joint, in a direction in which the joints move it."""
    home_rad, axis = np.array(robot_file.home_rad), np.array(robot_file.sensor_axis_tip)
    push = body.tip_pose(home_rad)[1] @ axis
    at_zero_m, zero_rotation = body.tip_pose(np.zeros_like(home_rad))
    lever_m = at_zero_m - body.joint_axes()[-1].origin_world_m
    outwards = float(zero_rotation @ axis @ lever_m) / max(float(np.linalg.norm(lever_m)), 1e-9)
    moved_m = np.abs(push @ body.tip_jacobian(home_rad)[:3]).max()  # by a turn of 1 rad of each joint
    return graded(
        "sensor_axis_tip",
        f"the tool pushes {describe_direction(push)} when the arm is at home",
        (_FAIL, moved_m < _STILL_M, "no joint moves the tool in this direction; correct the axis"),
        (_FAIL, outwards < -_OUTWARDS, "the axis points back to the arm; reverse it, or correct tip_frame"),
        (
            _WARN,
            outwards < _OUTWARDS,
            "the axis is perpendicular to the last link; correct the axis, unless the tool pushes in this "
            "direction",
        ),
    )


def describe_direction(vector: FloatArray) -> str:
    """Describe a direction in the world, such as "up and forwards".

    Args:
        vector: shape (3,), of any length above 0.
    """
    shares = np.abs(vector) / np.linalg.norm(vector)
    axes = [axis for axis in np.argsort(-shares) if shares[axis] > _PLAIN_SHARE]
    return " and ".join(_DIRECTIONS[axis][int(vector[axis] < 0)] for axis in axes)


def _torque(limits: Limits, body: RigidBody, heaviest_nm: float) -> Finding:
    limit_nm, effort_nm = np.array(limits.torque_nm), body.torque_limits_nm
    value = f"{_listed(limit_nm)} N m; the URDF's effort is {_listed(effort_nm)} N m"
    beyond = _exceeds_any(limit_nm, effort_nm)
    loose = 0.1 < _WEIGHTS * heaviest_nm < limit_nm.max()
    if loose and not beyond:
        value += f", and the arm's weight needs {heaviest_nm:.3g} N m"
    return graded(
        "highest torques",
        value,
        (_FAIL, beyond, "lower torque_nm, or correct the URDF's effort"),
        (_WARN, loose, "lower torque_nm: begin with enough to carry the arm and to press"),
    )


def _position(limits: Limits, body: RigidBody) -> Finding:
    low_rad, high_rad = body.position_limits_rad
    low, high = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
    beyond = (low < low_rad - _ROUNDING_RAD) | (high > high_rad + _ROUNDING_RAD)
    if not beyond.any():
        return ok("position limits", "within the URDF's")
    joint = int(np.argmax(beyond))
    value = (
        f"joint {joint + 1} from {low[joint]:g} to {high[joint]:g} rad, "
        f"in the URDF from {low_rad[joint]:g} to {high_rad[joint]:g}"
    )
    remedy = "the joint could hit its stop: narrow position_min_rad and position_max_rad"
    return fail("position limits", value, remedy)


def _exceeds_any(limits: FloatArray, most: FloatArray) -> bool:
    """Return whether any limit exceeds the stated one; 0 means that none is stated."""
    return bool(((most > 0) & (limits > most)).any())


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
