"""Waits for an arm at rest, and for hands that are away from it, before anything else happens to it."""

from collections.abc import Callable, Iterator

import numpy as np

from palpate.doctor.finding import Finding, fail, ok
from palpate.doctor.hand import Hand
from robot_io.robot import Robot
from robot_io.types import FloatArray, Measurement, Status

_STEP_S, _PATIENCE_S = 1e-3, 0.02  # without power nothing waits for a reading; slow buses may take their time
_STILL_S = 0.5  # so long nothing may have moved
_STILL_RAD = 0.02  # a hand that turns a joint does so within a tenth of that time
_TOUCHED_N = 1.0  # half of what counts as pressed
_COUNT_S = 3
_DEVICES = ("encoder_status", "force_status")

UNQUIET = fail("rest", "the arm does not come to rest", "let it lie or hang by itself, and hold still")


def read_for(robot: Robot, duration_s: float) -> list[Measurement]:
    """Every measurement of a while, one a millisecond or as fast as the bus is; at least one."""
    measurements: list[Measurement] = []
    end_s = robot.clock.now_s() + duration_s
    while robot.clock.now_s() < end_s or not measurements:
        robot.clock.sleep_until(robot.clock.now_s() + _STEP_S)
        measurements.append(robot.read(robot.clock.now_s() + _PATIENCE_S))
    return measurements


def wait_until(robot: Robot, hand: Hand, is_so: Callable[[list[Measurement]], bool]) -> bool:
    """Whether something is so of the last half second, before the hand's patience is at its end."""
    begun_s = robot.clock.now_s()
    newest: list[Measurement] = []
    while (elapsed_s := robot.clock.now_s() - begun_s) < _STILL_S + hand.patience_s:
        hand.go_on(elapsed_s)
        newest += read_for(robot, 0.02)
        newest = [m for m in newest if m.time_s > newest[-1].time_s - _STILL_S]
        if elapsed_s >= _STILL_S and is_so(newest):
            return True
    return False


def is_still(measurements: list[Measurement]) -> bool:
    """Whether no joint has moved, as far as good samples tell; none tell nothing."""
    return all_good(measurements) and bool((_range(measurements) < _STILL_RAD).all())


def all_good(measurements: list[Measurement]) -> bool:
    """Whether encoders and force have sampled anew meanwhile, and none of them reports a fault."""
    fresh = all(any(getattr(m, device) is Status.OK for m in measurements) for device in _DEVICES)
    return fresh and all(
        max(m.encoder_status, m.force_status) < Status.FAULT and np.isfinite(m.force_n) for m in measurements
    )


def hands_away(robot: Robot, hand: Hand, rest_n: float) -> Finding:
    """Wait until the force is what it was before somebody pressed."""
    hand.leave()
    if wait_until(robot, hand, lambda newest: abs(_force_n(newest) - rest_n) < _TOUCHED_N):
        return ok("hands away", f"the force is back at {rest_n:+.2f} N")
    force_n = _force_n(read_for(robot, 0.1))
    value = f"{force_n:+.2f} N are left of the press; it was {rest_n:+.2f} N before"
    return fail("hands away", value, "take every hand off the arm; if it stays, the sensor sticks")


def count_down(robot: Robot, hand: Hand) -> Iterator[Finding]:
    """Some seconds in which nobody may touch the arm; what shows that somebody does is a failure."""
    if not wait_until(robot, hand, is_still):
        yield UNQUIET
        return
    before = read_for(robot, 0.1)
    for left_s in range(_COUNT_S, 0, -1):
        hand.count(left_s)
        now = read_for(robot, 1.0)
        touched = max(abs(_force_n(now) - _force_n(before)), _forces_n(now).std()) > _TOUCHED_N
        if touched or not is_still(now) or not is_still([*before, *now]):
            value = "somebody touches the arm, or it moves: it gets no power"
            yield fail("hands away", value, "let it rest by itself, everybody clear of it, and start again")
            return


def _range(measurements: list[Measurement]) -> FloatArray:
    return np.asarray(np.ptp([m.joint_position_rad for m in measurements], axis=0))


def _forces_n(measurements: list[Measurement]) -> FloatArray:
    return np.array([m.force_n for m in measurements])


def _force_n(measurements: list[Measurement]) -> float:
    return float(_forces_n(measurements).mean())
