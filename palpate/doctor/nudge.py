"""A small motion under power: each joint in turn is moved by 3 degrees and back, under the guard."""

from collections.abc import Iterator

import numpy as np

from calibration.arm_motion import FreeMotion
from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from control.loop.loop import run_loop
from control.loop.result import LoopResult, Outcome
from control.loop.task import Phase, TaskOutput
from control.loop.tick_record import NO_ESTIMATE, Estimates
from control.paths.trajectory import JointMotion
from palpate.doctor.limits import random_poses_rad
from palpate.runs.simulated_probe import TickRecords
from robot_io.examination import Finding, Level, fail, graded
from robot_io.guard import Guard, Limits
from robot_io.robot import Robot
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray, Measurement

NUDGE_RAD = 0.05
_STAY_S, _NUDGE_S = 0.5, 1.2
_TRACKING_RAD = 0.03  # less than the nudge, so that a blocked joint stops it before it is pushed hard
_PUSH_SHARE = 0.15  # of its torque limit, that a joint may be pushed with beyond the arm's weight
_FOLLOWED = 0.7  # share of a nudge
_SHARE, _FLOOR_NM = 0.3, 0.3  # of the weight's torque, that friction and gearing may take


class NudgeTask:
    """Holds the arm where it stands, and moves one joint after the other there and back."""

    def __init__(self, robot_file: RobotFile, body: RigidBody) -> None:
        self._free = FreeMotion(body, gains_of(robot_file).tracking)
        limits = robot_file.limits
        self._middle_rad = (np.array(limits.position_min_rad) + np.array(limits.position_max_rad)) / 2.0

    def start(self, measurement: Measurement) -> None:
        """See `control.loop.task.Task`; each joint is moved to the side with more room."""
        self._elapsed_s = 0.0
        self._start_rad = measurement.joint_position_rad.copy()
        self._towards = np.where(self._start_rad > self._middle_rad, -1.0, 1.0)
        self._free.start(measurement)

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """See `control.loop.task.Task`; trips where something touches the tool."""
        self._elapsed_s += dt_s
        # Half a wave for one joint at a time, at rest at both of its ends.
        joint, within_s = divmod(self._elapsed_s - _STAY_S, _NUDGE_S)
        position, velocity, acceleration = self._start_rad.copy(), *np.zeros((2, len(self._start_rad)))
        if 0 <= joint < len(position):
            rate, number = 2 * np.pi / _NUDGE_S, int(joint)
            half_rad = self._towards[number] * NUDGE_RAD / 2
            position[number] += half_rad * (1 - np.cos(rate * within_s))
            velocity[number] = half_rad * rate * np.sin(rate * within_s)
            acceleration[number] = half_rad * rate**2 * np.cos(rate * within_s)
        motion = JointMotion(position, velocity, acceleration)
        torque_nm = self._free.torque_nm(measurement, motion, dt_s)
        done = self._elapsed_s >= 2 * _STAY_S + len(self._start_rad) * _NUDGE_S
        return self._free.output(measurement, motion, torque_nm, Phase.MOVE, done=done)


def examine_powered(robot: Robot, robot_file: RobotFile, body: RigidBody) -> Iterator[Finding]:
    """Move a configured robot a little; its torque is off at the end, whatever happens.

    Raises:
        DeviceError: a device failed before the first tick.
        KeyboardInterrupt: the user stopped it; the arm has been brought to rest.
    """
    limits = gentle(robot_file.limits, body)
    guard = Guard(limits, robot_file.safe_state, robot_file.joint_count, body.gravity)
    measured: list[Measurement] = []

    def observe(measurement: Measurement, _output: TaskOutput) -> Estimates:
        measured.append(measurement)
        return NO_ESTIMATE

    task, rate_hz = NudgeTask(robot_file, body), robot_file.control_rate_hz
    result = run_loop(robot, guard, task, robot.clock, TickRecords(), rate_hz=rate_hz, observer=observe)
    if result.outcome is Outcome.STOPPED and not result.deactivation_error:
        raise KeyboardInterrupt
    yield from _findings(result, measured, body)


def gentle(limits: Limits, body: RigidBody) -> Limits:
    """The limits with which a joint that is held is let go: little way off its path, little push."""
    weight_nm = np.abs([body.gravity(pose) for pose in random_poses_rad(limits)]).max(axis=0)
    torque_nm = np.minimum(limits.torque_nm, weight_nm + _PUSH_SHARE * np.array(limits.torque_nm))
    tracking_rad = np.minimum(limits.tracking_rad, _TRACKING_RAD)
    return limits.model_copy(
        update={"tracking_rad": tuple(tracking_rad.tolist()), "torque_nm": tuple(torque_nm.tolist())}
    )


def _findings(result: LoopResult, measured: list[Measurement], body: RigidBody) -> Iterator[Finding]:
    if result.deactivation_error:
        yield fail("torque off", result.deactivation_error, "cut the power supply now")
    if result.outcome is not Outcome.FINISHED:
        remedy = "see the joints above; check masses in the URDF, reversed, zero_rad and torque constants"
        yield fail("small motion", f"the guard stopped it: {result.cause}", remedy)
        return
    time_s = np.array([m.time_s for m in measured]) - measured[0].time_s
    position_rad = np.array([m.joint_position_rad for m in measured])
    still = (time_s > 0.5 * _STAY_S) & (time_s < _STAY_S)
    held_nm: FloatArray = np.array([m.joint_torque_nm for m in measured])[still].mean(axis=0)
    weight_nm = body.gravity(position_rad[still].mean(axis=0))
    joints = zip(np.ptp(position_rad, axis=0), held_nm, weight_nm, strict=True)
    for joint, (moved_rad, own_nm, own_weight_nm) in enumerate(joints, 1):
        off_nm = abs(own_nm - own_weight_nm)
        yield graded(
            f"drive of joint {joint}",
            f"moved {moved_rad:.3f} of {NUDGE_RAD:g} rad; holds {own_nm:+.2f} N m, "
            f"its weight is {own_weight_nm:+.2f} N m by the URDF",
            (
                Level.FAIL,
                moved_rad < _FOLLOWED * NUDGE_RAD,
                "it does not follow: friction, a low torque limit, or a wrong torque constant",
            ),
            (
                Level.WARN,
                off_nm > _SHARE * abs(own_weight_nm) + _FLOOR_NM,
                "check masses and torque constants; then palpate calibrate torque, gravity",
            ),
        )
