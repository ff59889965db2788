"""Signs: each joint and the force sensor, moved by hand without torque."""

from collections.abc import Callable, Iterator

import numpy as np

from control.arm.rigid_body import RigidBody
from palpate.doctor.clearance import UNQUIET, hands_away, is_still, read_for, wait_until
from palpate.doctor.finding import Finding, Level, fail, ok
from palpate.doctor.hand import Hand
from robot_io.robot import Robot
from robot_io.types import FloatArray, Measurement, Status

_MOVED_RAD = 0.12  # of a turn that is asked to be twice that
_PRESSED_N = 2.0
_SHOWN_RAD = 0.25
_PLAIN_M = 0.3  # share of the tip's motion along an axis that is worth a word
_DIRECTIONS = (("forwards", "backwards"), ("to the left", "to the right"), ("up", "down"))
_START_S = 0.1

Amounts = Callable[[Measurement], FloatArray]


def examine_signs(robot: Robot, body: RigidBody, hand: Hand) -> Iterator[Finding]:
    """Ask a hand to turn each joint and to press on the tool, and see what the arm shows.

    Args:
        robot: configured, not active.
        body: the same arm.
        hand: who moves it.
    """
    for joint in range(robot.joint_count):
        if not wait_until(robot, hand, is_still):
            yield UNQUIET
            return
        angles_rad = read_for(robot, _START_S)[-1].joint_position_rad
        hand.turn(joint, _in_words(body, angles_rad, joint))
        moved_rad = _watch(robot, hand, lambda m: m.joint_position_rad, _MOVED_RAD)
        yield _joint_finding(joint, moved_rad)
    if not wait_until(robot, hand, is_still):
        yield UNQUIET
        return
    rest_n = float(np.mean([m.force_n for m in read_for(robot, _START_S)]))
    hand.press("against the tip of the tool, towards the arm")
    pressed_n = _watch(robot, hand, lambda m: np.array([m.force_n]), _PRESSED_N)
    yield _force_finding(float(pressed_n[0]))
    yield hands_away(robot, hand, rest_n)


def _in_words(body: RigidBody, angles_rad: FloatArray, joint: int) -> str:
    """What a positive turn of a joint looks like at the tip, such as "the tip goes up and forwards"."""
    turned_rad = angles_rad.copy()
    turned_rad[joint] += _SHOWN_RAD
    way_m = body.tip_pose(turned_rad)[0] - body.tip_pose(angles_rad)[0]
    length_m = float(np.linalg.norm(way_m))
    if length_m < 1e-3:
        return "to its positive side"
    order = np.argsort(-np.abs(way_m))
    words = [
        _DIRECTIONS[axis][int(way_m[axis] < 0)] for axis in order if abs(way_m[axis]) > _PLAIN_M * length_m
    ]
    return f"the tip goes {' and '.join(words)}"


def _watch(robot: Robot, hand: Hand, amounts: Amounts, enough: float) -> FloatArray:
    """By how much each amount has changed once one has changed enough, or at the end of the patience."""
    before: FloatArray = np.mean([amounts(m) for m in read_for(robot, _START_S)], axis=0)
    begun_s = robot.clock.now_s()
    change = np.zeros_like(before)
    while (elapsed_s := robot.clock.now_s() - begun_s) < hand.patience_s:
        hand.go_on(elapsed_s)
        newest = read_for(robot, 0.02)[-1]
        if max(newest.encoder_status, newest.force_status) < Status.FAULT:
            change = amounts(newest) - before
        if np.abs(change).max() >= enough:
            break
    hand.rest()
    return change


def _joint_finding(joint: int, moved_rad: FloatArray) -> Finding:
    subject, own_rad = f"sign of joint {joint + 1}", float(moved_rad[joint])
    most = int(np.argmax(np.abs(moved_rad)))
    value = f"{own_rad:+.2f} rad when turned forwards"
    if abs(moved_rad[most]) < _MOVED_RAD:
        return Finding(
            subject, Level.FAIL, f"{value}: no joint moved", "turn it further, or check its encoder"
        )
    if most != joint:
        other = f"{value}, but joint {most + 1} moved by {moved_rad[most]:+.2f} rad"
        return fail(subject, other, "the drives' ids are in the wrong order: correct the robot file")
    if own_rad < 0:
        return fail(subject, value, "change its 'reversed' in the robot file, then its zero_rad")
    return ok(subject, value)


def _force_finding(pressed_n: float) -> Finding:
    subject, value = "sign of the force", f"{pressed_n:+.2f} N when pressed"
    if abs(pressed_n) < _PRESSED_N:
        return fail(subject, f"{value}: too little to tell", "press harder; if it stays, check the sensor")
    if pressed_n < 0:
        return fail(subject, value, "change 'reversed' of the force sensor in the robot file")
    return ok(subject, value)
