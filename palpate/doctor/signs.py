"""Signs: each joint and the force sensor, moved by hand without torque; and hands away before power."""

from collections.abc import Callable, Iterator

import numpy as np

from control.arm.rigid_body import RigidBody
from palpate.doctor.hand import Hand
from robot_io.examination import Finding, Level, fail, graded, ok
from robot_io.robot import Robot
from robot_io.types import FloatArray, Measurement, Status

_MOVED_RAD = 0.12  # of a turn that is asked to be twice that
_PRESSED_N = 2.0
_SHOWN_RAD = 0.25
_PLAIN_M = 0.3  # share of the tip's motion along an axis that is worth a word
_DIRECTIONS = (("forwards", "backwards"), ("to the left", "to the right"), ("up", "down"))
_START_S = 0.1
_STEP_S, _PATIENCE_S = 1e-3, 0.02  # without power nothing waits for a reading; slow buses may take their time
_STILL_S = 0.5  # so long nothing may have moved
_STILL_RAD = 0.02  # a hand that turns a joint does so within a tenth of that time
_TOUCHED_N = 1.0  # half of what counts as pressed
_COUNT_S = 3
_DEVICES = ("encoder_status", "force_status")
_FAIL = Level.FAIL

RESTLESS = fail("rest", "the arm does not come to rest", "let it lie or hang by itself, and hold still")


def examine_signs(robot: Robot, body: RigidBody, hand: Hand) -> Iterator[Finding]:
    """Ask a hand to turn each joint of a configured robot and to press on its tool, and see what it shows."""
    for joint in range(robot.joint_count):
        if not _wait_until(robot, hand, is_still):
            yield RESTLESS
            return
        angles_rad = _read_for(robot, _START_S)[-1].joint_position_rad
        hand.turn(joint, _in_words(body, angles_rad, joint))
        yield _joint_finding(joint, _watch(robot, hand, lambda m: m.joint_position_rad, _MOVED_RAD))
    if not _wait_until(robot, hand, is_still):
        yield RESTLESS
        return
    rest_n = _force_n(_read_for(robot, _START_S))
    hand.press("against the tip of the tool, towards the arm")
    pressed_n = float(_watch(robot, hand, lambda m: np.array([m.force_n]), _PRESSED_N)[0])
    yield _force_finding(pressed_n)
    yield _hands_away(robot, hand, rest_n)


def count_down(robot: Robot, hand: Hand) -> Iterator[Finding]:
    """Some seconds in which nobody may touch the arm; what shows that somebody does is a failure."""
    if not _wait_until(robot, hand, is_still):
        yield RESTLESS
        return
    before = _read_for(robot, 0.1)
    for left_s in range(_COUNT_S, 0, -1):
        hand.count(left_s)
        now = _read_for(robot, 1.0)
        spread_n = float(np.std([m.force_n for m in now]))
        touched = max(abs(_force_n(now) - _force_n(before)), spread_n) > _TOUCHED_N
        if touched or not is_still(now) or not is_still([*before, *now]):
            value = "somebody touches the arm, or it moves: it gets no power"
            yield fail("hands away", value, "let it rest by itself, everybody clear of it, and start again")
            return


def is_still(measurements: list[Measurement]) -> bool:
    """Whether no joint has moved, as far as good samples tell; none tell nothing.

    Good are samples if encoders and force have sampled anew meanwhile, and none of them reports a fault.
    """
    fresh = all(any(getattr(m, device) is Status.OK for m in measurements) for device in _DEVICES)
    good = fresh and all(
        max(m.encoder_status, m.force_status) < Status.FAULT and np.isfinite(m.force_n) for m in measurements
    )
    return good and bool((np.ptp([m.joint_position_rad for m in measurements], axis=0) < _STILL_RAD).all())


def _in_words(body: RigidBody, angles_rad: FloatArray, joint: int) -> str:
    """What a positive turn of a joint looks like at the tip, such as "the tip goes up and forwards"."""
    turned_rad = angles_rad.copy()
    turned_rad[joint] += _SHOWN_RAD
    way_m = body.tip_pose(turned_rad)[0] - body.tip_pose(angles_rad)[0]
    length_m = float(np.linalg.norm(way_m))
    if length_m < 1e-3:
        return "to its positive side"
    axes = [axis for axis in np.argsort(-np.abs(way_m)) if abs(way_m[axis]) > _PLAIN_M * length_m]
    return f"the tip goes {' and '.join(_DIRECTIONS[axis][int(way_m[axis] < 0)] for axis in axes)}"


def _watch(
    robot: Robot, hand: Hand, amounts: Callable[[Measurement], FloatArray], enough: float
) -> FloatArray:
    """By how much each amount has changed once one has changed enough, or at the end of the patience."""
    before: FloatArray = np.mean([amounts(m) for m in _read_for(robot, _START_S)], axis=0)
    begun_s = robot.clock.now_s()
    change = np.zeros_like(before)
    while (elapsed_s := robot.clock.now_s() - begun_s) < hand.patience_s:
        hand.go_on(elapsed_s)
        newest = _read_for(robot, 0.02)[-1]
        if max(newest.encoder_status, newest.force_status) < Status.FAULT:
            change = amounts(newest) - before
        if np.abs(change).max() >= enough:
            break
    hand.rest()
    return change


def _wait_until(robot: Robot, hand: Hand, is_so: Callable[[list[Measurement]], bool]) -> bool:
    """Whether something is so of the last half second, before the hand's patience is at its end."""
    begun_s = robot.clock.now_s()
    newest: list[Measurement] = []
    while (elapsed_s := robot.clock.now_s() - begun_s) < _STILL_S + hand.patience_s:
        hand.go_on(elapsed_s)
        newest += _read_for(robot, 0.02)
        newest = [m for m in newest if m.time_s > newest[-1].time_s - _STILL_S]
        if elapsed_s >= _STILL_S and is_so(newest):
            return True
    return False


def _read_for(robot: Robot, duration_s: float) -> list[Measurement]:
    """Every measurement of a while, one a millisecond or as fast as the bus is; at least one."""
    measurements: list[Measurement] = []
    end_s = robot.clock.now_s() + duration_s
    while robot.clock.now_s() < end_s or not measurements:
        robot.clock.sleep_until(robot.clock.now_s() + _STEP_S)
        measurements.append(robot.read(robot.clock.now_s() + _PATIENCE_S))
    return measurements


def _force_n(measurements: list[Measurement]) -> float:
    return float(np.mean([m.force_n for m in measurements]))


def _hands_away(robot: Robot, hand: Hand, rest_n: float) -> Finding:
    """Wait until the force is what it was before somebody pressed."""
    hand.leave()
    if _wait_until(robot, hand, lambda newest: abs(_force_n(newest) - rest_n) < _TOUCHED_N):
        return ok("hands away", f"the force is back at {rest_n:+.2f} N")
    force_n = _force_n(_read_for(robot, 0.1))
    value = f"{force_n:+.2f} N are left of the press; it was {rest_n:+.2f} N before"
    return fail("hands away", value, "take every hand off the arm; if it stays, the sensor sticks")


def _joint_finding(joint: int, moved_rad: FloatArray) -> Finding:
    subject, own_rad = f"sign of joint {joint + 1}", float(moved_rad[joint])
    most = int(np.argmax(np.abs(moved_rad)))
    value = f"{own_rad:+.2f} rad when turned forwards"
    if not abs(moved_rad[most]) >= _MOVED_RAD:  # nor for NaN
        return fail(subject, f"{value}: no joint moved", "turn it further, or check its encoder")
    if most != joint:
        other = f"{value}, but joint {most + 1} moved by {moved_rad[most]:+.2f} rad"
        return fail(subject, other, "the drives' ids are in the wrong order: correct the robot file")
    remedy = "change its 'reversed' in the robot file, then its zero_rad"
    return graded(subject, value, (_FAIL, own_rad < 0, remedy))


def _force_finding(pressed_n: float) -> Finding:
    subject, value = "sign of the force", f"{pressed_n:+.2f} N when pressed"
    if not abs(pressed_n) >= _PRESSED_N:  # nor for NaN
        return fail(subject, f"{value}: too little to tell", "press harder; if it stays, check the sensor")
    remedy = "change 'reversed' of the force sensor in the robot file"
    return graded(subject, value, (_FAIL, pressed_n < 0, remedy))
