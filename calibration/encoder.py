"""Calibration of the joints' zeros from hard stops or a known pose."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Self

import numpy as np

from palpate.calibration import arm_motion
from palpate.calibration.standstill import few_sample_factor
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import TrackingGains
from palpate.control.loop.task import NO_RUN, Phase, TaskEvent, TaskOutput
from palpate.control.paths.trajectory import JointMotion, JointMove
from palpate.robot_io.errors import InputError, SafetyTripError
from palpate.robot_io.guard import Limits
from palpate.robot_io.session import Session
from palpate.robot_io.types import FloatArray, Measurement, Status, clip

_NEAR_RAD = 0.12  # distance to the stop at which the approach begins
_LIMIT_MARGIN_RAD = 0.1  # distance of poses from the position limits
_ALTERNATIVE = "or calibrate in a known pose instead, without power: --pose home"
_COUNT = 5  # number of tried positions of each other joint


@dataclass(frozen=True)
class StopApproach:
    """Approach of one joint to its stop."""

    joint: int  # from 0
    stop_rad: float  # nominal position of the stop [rad]
    side: int  # 1 for the upper stop, -1 for the lower
    posture_rad: FloatArray  # start of the approach, shape (n,) [rad]


def plan_stops(
    body: RigidBody,
    start_rad: FloatArray,
    limits: Limits,
    stops_rad: tuple[FloatArray, FloatArray],
    reach_rad: float,
) -> tuple[FloatArray, tuple[StopApproach, ...]]:
    """Plan a raised pose, shape (n,) [rad], and the approaches that start from it.

    For each joint, choose the side and pose with the largest ground clearance among those that the torque
    limits can hold. No part goes lower than in the start pose.

    Args:
        body: model of the arm.
        start_rad: present joint positions, shape (n,) [rad].
        limits: limits of the guard.
        stops_rad: lower and upper stops, shape (n,) each [rad], NaN where there is none.
        reach_rad: largest apparent motion of a joint beyond its stop [rad].

    Raises:
        InputError: a joint has no stop that can be reached without touching the ground.
    """
    floor_m = arm_motion.lowest_m(body, [start_rad])
    low, high = arm_motion.joint_range(limits, _LIMIT_MARGIN_RAD)
    up = arm_motion.highest_posture(body, low, high)
    arm_motion.check_lift_path(body, start_rad, up, limits)
    approaches = []
    for joint in range(body.joint_count):
        ways = _candidates(body, up, joint, bounds=(low, high), stops_rad=stops_rad, reach_rad=reach_rad)
        at_rest = np.zeros(body.joint_count)
        candidates = (
            (arm_motion.lowest_m(body, way), approach)
            for way, approach in ways
            if arm_motion.overloaded_joint(body, (JointMotion(q, at_rest, at_rest) for q in way), limits)
            is None
        )
        lowest, approach = max(candidates, key=lambda candidate: candidate[0], default=(None, None))
        if lowest is None or approach is None:
            raise InputError(
                f"joint {joint + 1}: its stops are not stated, or limits.torque_nm is too small to carry the "
                "arm there; state the stops (--lower-stops, --upper-stops), raise limits.torque_nm, "
                f"{_ALTERNATIVE}"
            )
        if lowest < floor_m - arm_motion.MARGIN_M:
            raise InputError(
                f"joint {joint + 1}: on the way to its stops the arm would come {floor_m - lowest:.2g} m "
                f"closer to the ground than it is now; raise the arm by as much, {_ALTERNATIVE}"
            )
        approaches.append(approach)
    return up, tuple(approaches)


def widen_limits_for_stops(limits: Limits, approaches: Iterable[StopApproach], beyond_rad: float) -> Limits:
    """Widen the position limits so that each joint can reach its stop.

    Args:
        limits: limits of the guard.
        approaches: approaches to the stops.
        beyond_rad: largest apparent motion of a joint beyond its stop [rad].
    """
    low, high = list(limits.position_min_rad), list(limits.position_max_rad)
    for approach in approaches:
        joint, end_rad = approach.joint, approach.stop_rad + approach.side * beyond_rad
        if approach.side > 0:
            high[joint] = max(high[joint], end_rad)
        else:
            low[joint] = min(low[joint], end_rad)
    return limits.model_copy(update={"position_min_rad": tuple(low), "position_max_rad": tuple(high)})


def _candidates(
    body: RigidBody,
    up: FloatArray,
    joint: int,
    *,
    bounds: tuple[FloatArray, FloatArray],
    stops_rad: tuple[FloatArray, FloatArray],
    reach_rad: float,
) -> Iterator[tuple[FloatArray, StopApproach]]:
    """Yield each approach to a joint's two stops with its path (k, n), over postures of the outer joints."""
    low, high = bounds
    behind = [np.linspace(0.6 * low[j], 0.6 * high[j], _COUNT) for j in range(joint + 1, body.joint_count)]
    for side, stops in ((-1, stops_rad[0]), (1, stops_rad[1])):
        if not np.isfinite(stops[joint]):
            continue
        for angles in product(*behind):
            posture = up.copy()
            posture[joint + 1 :] = angles
            posture[joint] = np.clip(stops[joint] - side * _NEAR_RAD, low[joint], high[joint])
            end = posture.copy()
            end[joint] = stops[joint] + side * reach_rad
            way = np.concatenate(
                [arm_motion.straight_path(up, posture), arm_motion.straight_path(posture, end)]
            )
            yield way, StopApproach(joint, float(stops[joint]), side, posture)


EVENT = "stop_touched"
PUSH_SHARE = 0.075  # share of the torque limit, below the guard's threshold for a stuck encoder
_PRESS_RAD_S = 0.05
_LEAD_RAD = 0.03
# A joint is at a stop if it moves less than this distance while it is pushed for this time.
_STILL_RAD, _STILL_S = 0.003, 0.3
_BACK_RAD = 0.08  # retreat between two touches
_SETTLE_S = 0.3


@dataclass(frozen=True)
class StopSettings:
    """Settings of the touches of stops."""

    # Torque beyond the arm's weight that pushes a joint against its stop, shape (n,) [N m].
    push_nm: FloatArray
    lead_rad: FloatArray  # largest lead of the reference over the joint, shape (n,) [rad]
    travel_rad_s: float  # speed of the moves to the stops and back [rad/s]
    speed_rad_s: float  # speed of the approach [rad/s]
    touches: int = 3  # number of touches of each stop
    hold_s: float = 0.25  # duration of the reading at the stop [s]
    reach_rad: float = 0.15  # largest distance from the nominal position of the stop [rad]

    @classmethod
    def within(cls, limits: Limits) -> Self:
        """Choose settings that stay well below the guard's limits of torque, speed and tracking."""
        return cls(
            push_nm=PUSH_SHARE * np.array(limits.torque_nm),
            lead_rad=np.minimum(_LEAD_RAD, arm_motion.SHARE * np.array(limits.tracking_rad)),
            travel_rad_s=arm_motion.travel_speed_rad_s(limits),
            speed_rad_s=float(arm_motion.cap_speed(_PRESS_RAD_S, limits).min()),
        )


class StopTask:
    """Touches every stop several times; see `palpate.control.loop.task.Task`.

    The ticks at a stop are in phase HOLD. Each touch is a run; runs are numbered over all joints.
    """

    def __init__(
        self,
        body: RigidBody,
        gains: TrackingGains,
        up_rad: FloatArray,
        approaches: Sequence[StopApproach],
        settings: StopSettings,
    ) -> None:
        self._free, self._body = arm_motion.FreeMotion(body, gains), body
        self._up_rad, self._approaches, self._settings = up_rad, tuple(approaches), settings
        self._touches = len(approaches) * settings.touches

    def start(self, measurement: Measurement) -> None:
        """Plan the move from the measured pose to the first stop.

        Args:
            measurement: state of the arm.
        """
        self._free.start(measurement)
        self._start_rad = measurement.joint_position_rad.copy()
        self._touch = 0
        self._pressing = False
        self._held_s = self._still_s = self._still_rad = 0.0
        self._move_along([self._start_rad, self._up_rad, self._approaches[0].posture_rad])

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Move to the next stop, or press against it; see `palpate.control.loop.task.Task.step`.

        Raises:
            SafetyTripError: a stop is too far from its nominal position.
        """
        return self._press(measurement, dt_s) if self._pressing else self._move(measurement, dt_s)

    @property
    def _approach(self) -> StopApproach:
        return self._approaches[min(self._touch, self._touches - 1) // self._settings.touches]

    def _move_along(self, postures: Sequence[FloatArray]) -> None:
        speed_rad_s = self._settings.travel_rad_s
        self._moves = [
            JointMove(a, b, speed_rad_s, arm_motion.ACCELERATION_RAD_S2) for a, b in pairwise(postures)
        ]
        self._move_s = 0.0

    def _move(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        self._move_s += dt_s
        motion = self._moves[0].at(self._move_s)
        torque_nm = self._free.torque_nm(measurement, motion, dt_s)
        phase = Phase.MOVE
        over_s = self._move_s - self._moves[0].duration_s - _SETTLE_S
        if over_s >= 0.0:
            if len(self._moves) > 1:
                self._moves, self._move_s = self._moves[1:], 0.0
            elif self._touch < self._touches:
                self._pressing, self._reference_rad = True, motion.position_rad.copy()
                self._held_s = self._still_s = 0.0
                self._still_rad = float(motion.position_rad[self._approach.joint])
            elif self._free.at_rest(measurement, over_s):
                phase = Phase.IDLE
        return self._free.output(measurement, motion, torque_nm, phase, done=phase is Phase.IDLE)

    def _press(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        approach, settings = self._approach, self._settings
        joint, position = approach.joint, float(measurement.joint_position_rad[approach.joint])
        lead_rad = approach.side * (self._reference_rad[joint] - position)
        speed = np.zeros(self._body.joint_count)
        if lead_rad < settings.lead_rad[joint]:
            speed[joint] = approach.side * settings.speed_rad_s
            self._reference_rad = self._reference_rad + speed * dt_s
        motion = JointMotion(self._reference_rad.copy(), speed, np.zeros_like(speed))
        torque_nm = self._pushing_torque_nm(measurement, motion, dt_s)
        pushed = lead_rad >= 0.9 * settings.lead_rad[joint]
        if pushed and abs(position - self._still_rad) < _STILL_RAD:
            self._still_s += dt_s
        else:
            self._still_s, self._still_rad = 0.0, position
        at_stop = self._still_s >= _STILL_S
        self._held_s += dt_s if at_stop else 0.0
        phase, run = (Phase.HOLD, self._touch) if at_stop else (Phase.APPROACH, NO_RUN)
        events: tuple[TaskEvent, ...] = ()
        beyond_rad, reach = position - approach.stop_rad, settings.reach_rad
        if abs(beyond_rad) > reach and (at_stop or approach.side * beyond_rad > reach):
            push_nm = float(settings.push_nm[joint])
            what = f"stopped under a push of {push_nm:.2g} N m" if at_stop else "reached no stop"
            remedy = "remove any obstacle, " if at_stop else ""
            held = "friction holds the joint or " if at_stop else ""
            option = "--upper-stops" if approach.side > 0 else "--lower-stops"
            raise SafetyTripError(
                f"joint {joint + 1} {what} at {position:.3f} rad, but its stop should be at "
                f"{approach.stop_rad:.3f} rad (within {reach:g} rad); {remedy}give the true stop with "
                f"{option}, or, if {held}the joint's zero is wrong by this difference, calibrate in a known "
                "pose first (--pose)"
            )
        if self._held_s >= settings.hold_s:
            text = f"joint {joint + 1} touches its stop; its encoder reads {position:.5f} rad"
            stop = {"run": self._touch, "joint": joint, "stop_rad": approach.stop_rad, "shown_rad": position}
            events = (TaskEvent(EVENT, text, stop),)
            # Back off, and continue with the next touch, the next stop, or the return.
            here_rad = self._reference_rad.copy()
            here_rad[joint] = position
            back_rad = here_rad.copy()
            back_rad[joint] -= approach.side * _BACK_RAD
            self._touch += 1
            self._pressing = False
            self._free.reset()
            if self._touch >= self._touches:
                self._move_along([here_rad, back_rad, self._up_rad, self._start_rad])
            elif self._approach is approach:
                self._move_along([here_rad, back_rad])
            else:
                self._move_along([here_rad, back_rad, self._up_rad, self._approach.posture_rad])
        return self._free.output(measurement, motion, torque_nm, phase, run, events=events)

    def _pushing_torque_nm(self, measurement: Measurement, motion: JointMotion, dt_s: float) -> FloatArray:
        """Compute torques that hold the other joints and push this one towards its reference."""
        # The tracking of this joint must not act on the others through the mass matrix, because a stop would
        # shake them.
        joint = self._approach.joint
        position, speed = measurement.joint_position_rad[joint], measurement.joint_velocity_rad_s[joint]
        own_position, own_speed = motion.position_rad.copy(), motion.velocity_rad_s.copy()
        own_position[joint], own_speed[joint] = position, speed
        free_joints = JointMotion(own_position, own_speed, motion.acceleration_rad_s2)
        torque_nm = self._free.torque_nm(measurement, free_joints, dt_s).copy()
        max_push_nm = float(self._settings.push_nm[joint])
        lead_rad, speed_error = motion.position_rad[joint] - position, motion.velocity_rad_s[joint] - speed
        inertia = float(self._body.mass_matrix(measurement.joint_position_rad)[joint, joint])
        # Pulls the joint towards its reference.
        spring_nm_rad = max_push_nm / float(self._settings.lead_rad[joint])
        damping_nms_rad = 2.0 * math.sqrt(inertia * spring_nm_rad)  # critical damping
        push_nm = spring_nm_rad * float(lead_rad) + damping_nms_rad * float(speed_error)
        torque_nm[joint] += clip(push_nm, -max_push_nm, max_push_nm)
        return torque_nm


_ROUNDING_RAD = 1e-12  # rounding error of a mean of equal numbers
_UNIFORM = np.sqrt(12.0)  # ratio of the resolution to the standard deviation of its rounding


@dataclass(frozen=True)
class EncoderFit:
    """Zeros of n joints."""

    offset_rad: FloatArray  # to be added to the encoders' readings, shape (n,) [rad]
    std_rad: FloatArray  # standard uncertainties, shape (n,) [rad]
    shown_rad: tuple[FloatArray, ...]  # mean reading of each touch by joint, or one mean for the pose [rad]
    repeatability_rad: FloatArray  # standard deviation of the touches, shape (n,); 0 for a pose [rad]


def fit_encoder(
    session: Session, joint_count: int, pose_rad: Sequence[float] | None, known_std_rad: float
) -> EncoderFit:
    """Fit zeros to touches of hard stops, as `StopTask` logs them, or to a pose in which the arm was held.

    Args:
        session: session of the stops or of the pose.
        joint_count: number of joints n.
        pose_rad: pose in which the arm was held, shape (n,) [rad]; None if stops were touched.
        known_std_rad: standard uncertainty of stops or pose [rad].

    Raises:
        InputError: a joint's stop was not touched at least twice, the session has no samples of the pose, or
            the arm moved in it.
    """
    ticks = session.samples("tick")
    valid = ticks.select(ticks["encoder_status"] == Status.OK)
    position = valid.vector("joint_position_rad")
    changes = np.abs(np.diff(ticks.vector("joint_position_rad"), axis=0)).ravel()
    # The encoders' resolution is the smallest change between ticks [rad]; 0 without a change.
    resolution = float(np.min(changes[changes > _ROUNDING_RAD], initial=np.inf))
    resolution = resolution if np.isfinite(resolution) else 0.0
    rounding_rad = resolution / _UNIFORM
    if pose_rad is not None:
        if not len(position):
            raise InputError(f"{session.path}: holds no fresh encoder samples")
        range_rad = np.ptp(position, axis=0)
        if np.any(range_rad > max(10 * resolution, 2e-3)):
            joint = int(np.argmax(range_rad))
            raise InputError(
                f"joint {joint + 1} moved by {range_rad[joint]:.2g} rad: the arm must stand still"
            )
        means = position.mean(axis=0)
        half_ranges = 0.5 * range_rad / np.sqrt(3.0)
        std = np.sqrt(half_ranges**2 + rounding_rad**2 + known_std_rad**2)
        offset_rad = np.array(pose_rad) - means
        _check_offsets(offset_rad)
        return EncoderFit(offset_rad, std, tuple(means[:, None]), np.zeros(len(means)))
    shown: list[list[float]] = [[] for _ in range(joint_count)]
    nominal_rad = np.full(joint_count, np.nan)
    for event in session.events:
        if event.kind == EVENT and event.data:
            joint = int(event.data["joint"])
            nominal_rad[joint] = float(event.data["stop_rad"])
            shown[joint].append(float(position[valid["run"] == event.data["run"], joint].mean()))
    missing = [joint + 1 for joint, touches in enumerate(shown) if len(touches) < 2]
    if missing:
        raise InputError(
            f"{session.path}: joint {missing[0]} was not held against its stop at least twice; if the arm "
            "was held in a pose, give this pose with --pose"
        )
    means = np.array([np.mean(touches) for touches in shown])
    scatter = np.array([np.std(touches, ddof=1) for touches in shown])
    scatter[scatter < _ROUNDING_RAD] = 0.0
    counts = np.array([len(touches) for touches in shown])
    errors = np.array([few_sample_factor(count - 1) for count in counts]) * scatter / np.sqrt(counts)
    std = np.sqrt(errors**2 + rounding_rad**2 + known_std_rad**2)
    _check_offsets(nominal_rad - means)
    return EncoderFit(nominal_rad - means, std, tuple(np.array(t) for t in shown), scatter)


def _check_offsets(offset_rad: FloatArray) -> None:
    """Raise `InputError` for the first joint whose zero is off by more than half a turn."""
    for joint, by_rad in enumerate(offset_rad.tolist(), 1):
        if abs(by_rad) > np.pi:
            raise InputError(
                f"joint {joint}: its zero is off by {by_rad:+.4g} rad, more than half a turn; correct "
                "zero_rad or `reversed` in the robot file, or turn the joint to less than half a turn from "
                "its zero before the drive starts"
            )
