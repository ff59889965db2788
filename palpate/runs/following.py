"""Let an arm's joints follow goals of another program, such as LeRobot, at that program's own rate.

The arm runs in a separate process at its full control rate, with its guard and its session, so that neither
a slow program nor Python's GIL delays a tick. The program controls it through `FollowingArm`: each goal is
answered by the newest measurement. When the program stops the arm, or dies, the arm returns to its start pose
and its torque is switched off.
"""

import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.laws.hybrid import HybridController
from palpate.control.loop.task import Phase, TaskOutput, make_output
from palpate.control.loop.tick_record import NO_ESTIMATE
from palpate.control.paths.trajectory import JointMotion
from palpate.robot_io.calibration.applied import load_calibrations
from palpate.robot_io.errors import InputError, LifecycleError, PalpateError, error_text
from palpate.robot_io.types import FloatArray, Measurement, frozen_array
from palpate.runs.session import ArmJob, arm_session

_RATE_1_S = 20.0  # rate at which a goal is approached; both poles of the reference lie at twice this rate
_LONGEST_S = 0.2  # longest interval between goals that slows the approach
_BRAKE_SHARE = 0.8  # share of the acceleration limit used to plan the braking before a goal
_AT_REST_RAD, _AT_REST_RAD_S = 1e-3, 1e-3
_READY_S = 0.5  # time from torque on until the program is told that the arm is ready
_END_S = 60.0  # time limit of the process after the arm has ended


@dataclass(frozen=True)
class FollowingJob(ArmJob):
    """Settings of a following run: the arm, and the speed and acceleration of its reference."""

    speed_share: float = 0.5  # largest speed of the reference, as a share of the guard's limits
    acceleration_rad_s2: float = 10.0  # largest acceleration of the reference

    def __post_init__(self) -> None:
        """Raise an error for invalid limits of the reference, after the checks of `ArmJob`."""
        super().__post_init__()
        if not 0.0 < self.speed_share <= 1.0:
            raise InputError(f"speed_share {self.speed_share}: must be above 0 and at most 1")
        if not 0.0 < self.acceleration_rad_s2 < np.inf:
            raise InputError(f"acceleration_rad_s2 {self.acceleration_rad_s2}: must be above 0 and finite")


class GoalReference:
    """Reference that moves to a changing goal within limits of speed and acceleration.

    The reference moves to a new goal in a straight line, over the time that has passed since the previous
    goal, so that goals at a program's own rate cause no steps.

    Args:
        position_rad: start, shape (n,) [rad].
        speed_rad_s: largest speed, shape (n,) [rad/s].
        acceleration_rad_s2: largest acceleration [rad/s^2].
    """

    def __init__(self, position_rad: FloatArray, speed_rad_s: FloatArray, acceleration_rad_s2: float) -> None:
        self._position, self._velocity = position_rad.copy(), np.zeros_like(position_rad)
        self._speed, self._acceleration = speed_rad_s, acceleration_rad_s2
        self._goal = self._way_point = self._position
        self._since_s, self._left_s = 0.0, 0.0  # time since the last goal; time left to reach the current one

    def aim(self, goal_rad: FloatArray) -> None:
        """Set a new goal.

        Args:
            goal_rad: shape (n,) [rad].
        """
        self._goal, self._left_s, self._since_s = goal_rad, min(self._since_s, _LONGEST_S), 0.0

    def step(self, dt_s: float) -> JointMotion:
        """Advance by one step.

        Args:
            dt_s: length of the step [s].
        """
        share = dt_s / self._left_s if self._left_s > dt_s else 1.0
        self._way_point = self._way_point + share * (self._goal - self._way_point)
        self._left_s, self._since_s = self._left_s - dt_s, self._since_s + dt_s
        way = self._way_point - self._position
        braking = np.sqrt(2.0 * _BRAKE_SHARE * self._acceleration * np.abs(way))
        speed = np.minimum(np.minimum(_RATE_1_S * np.abs(way), braking), self._speed)
        change = 4.0 * _RATE_1_S * (np.copysign(speed, way) - self._velocity)
        acceleration = np.clip(change, -self._acceleration, self._acceleration)
        self._velocity = self._velocity + dt_s * acceleration
        self._position = self._position + dt_s * self._velocity
        return JointMotion(self._position, self._velocity, acceleration)

    @property
    def arrived(self) -> bool:
        """Whether the reference rests at the goal."""
        away, speed = np.abs(self._goal - self._position).max(), np.abs(self._velocity).max()
        return bool(away < _AT_REST_RAD and speed < _AT_REST_RAD_S)


class JointFollowingTask:
    """Task that follows goals from a line; see `palpate.control.loop.task.Task`.

    Args:
        controller: controller of the arm.
        line: connection to the program. The task first sends a `Measurement` when the arm is ready. Each
            received array of shape (n,) [rad] is a goal; an empty array sets no goal. Both are answered by
            the newest `Measurement`. None or a closed connection ends the task.
        speed_rad_s: largest speed of the reference, shape (n,) [rad/s].
        acceleration_rad_s2: largest acceleration of the reference [rad/s^2].
    """

    def __init__(
        self,
        controller: HybridController,
        line: Connection,
        speed_rad_s: FloatArray,
        acceleration_rad_s2: float,
    ) -> None:
        self._controller, self._line = controller, line
        self._limits = speed_rad_s, acceleration_rad_s2
        self._direction = np.array((0.0, 0.0, -1.0))
        self._ending = False

    def start(self, measurement: Measurement) -> None:
        """Hold the measured posture.

        Args:
            measurement: state of the arm.
        """
        self._rest = measurement.joint_position_rad.copy()
        self._reference = GoalReference(self._rest, *self._limits)
        self._controller.start(measurement)
        self._wait_s = _READY_S

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Compute one tick.

        Args:
            measurement: state of the arm.
            dt_s: time since the last tick [s].

        Returns:
            Command and reference; done once the task was told to end and the arm is back at its start.
        """
        try:
            if self._wait_s > 0.0:
                self._wait_s -= dt_s
                if self._wait_s <= 0.0:
                    self._line.send(measurement)
            while not self._ending and self._wait_s <= 0.0 and self._line.poll():
                goal = self._line.recv()
                if goal is None:
                    self._end()
                else:
                    if goal.size:
                        self._reference.aim(goal)
                    self._line.send(measurement)
        except (EOFError, OSError):  # the program has died
            self._end()
        control = self._controller.step_joints(measurement, self._reference.step(dt_s), dt_s)
        phase = Phase.IDLE if self._reference.arrived else Phase.MOVE
        done = self._ending and self._reference.arrived
        return make_output(control.command, control.motion, control.tip, self._direction, phase, done=done)

    def _end(self) -> None:
        self._ending = True
        self._reference.aim(self._rest)


def run_following(job: FollowingJob, line: Connection) -> None:
    """Follow goals until the program ends or the guard trips; the session is then complete.

    Args:
        job: the arm and its speed.
        line: see `JointFollowingTask`.

    Raises:
        InputError: robot file, drivers and scenario do not fit each other; nothing has moved.
        PalpateError: the arm was stopped; states the reason.
    """
    robot_file = job.robot_file
    calibrations = load_calibrations(robot_file, emulated=job.wired)
    body = RigidBody.of_robot(robot_file, calibrations)
    controller = HybridController(body, np.array(robot_file.sensor_axis_tip), gains_of(robot_file))
    speed_rad_s = job.speed_share * np.array(robot_file.limits.velocity_rad_s)
    task = JointFollowingTask(controller, line, speed_rad_s, job.acceleration_rad_s2)
    with arm_session(job, calibrations, {}) as arm:
        result = arm.run(task, lambda *_: NO_ESTIMATE)
    result.raise_for_trip()
    if result.cause:
        raise PalpateError(f"the arm was stopped: {result.cause}")


class FollowingArm:
    """Client of an arm that runs in a separate process.

    Args:
        job: the arm and its speed.

    Attributes:
        low_rad: lowest goals that are followed, shape (n,) [rad].
        high_rad: highest goals that are followed, shape (n,) [rad].

    Raises:
        InputError: no physics engine is installed for a simulated arm, or a limit of the reference is
            invalid.
    """

    def __init__(self, job: FollowingJob) -> None:
        limits = job.robot_file.limits
        low_rad, high_rad = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
        margin_rad = np.minimum(np.array(limits.tracking_rad), 0.1 * (high_rad - low_rad))
        self.low_rad, self.high_rad = low_rad + margin_rad, high_rad - margin_rad
        self._job = job
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: PalpateError | None = None

    @property
    def running(self) -> bool:
        """Whether the arm was started and not stopped since; True even after the guard has stopped it."""
        return self._process is not None

    def start(self) -> Measurement:
        """Open the devices, switch the torque on, and hold the arm's current pose.

        Returns:
            The first measurement.

        Raises:
            LifecycleError: the arm is already running.
            PalpateError: a device could not be opened, or the arm was stopped; states the reason.
        """
        if self.running:
            raise LifecycleError("the arm is already running")
        self._line, child_line = Pipe()
        self._ended = None
        # In a new process session, Ctrl-C in the terminal reaches only the program, which then stops the arm.
        program = f"from palpate.runs.following import main; main({child_line.fileno()})"
        self._process = subprocess.Popen(  # noqa: S603 (this interpreter, this module)
            [sys.executable, "-c", program],
            pass_fds=[child_line.fileno()],
            start_new_session=True,
            stdin=subprocess.DEVNULL,
        )
        child_line.close()
        try:
            return self._ask(self._job)
        except PalpateError:
            self.stop()
            raise

    def follow(self, goal_rad: FloatArray) -> Measurement:
        """Set the goal of the joints, clipped to `low_rad` and `high_rad`.

        Args:
            goal_rad: shape (n,) [rad].

        Returns:
            The newest measurement, at most one tick old.

        Raises:
            InputError: the goal is not one finite number per joint; the arm keeps its last goal.
            LifecycleError: the arm is not running.
            PalpateError: the arm was stopped; states the reason, again in every later call.
        """
        goal = frozen_array(goal_rad, self.low_rad.shape, what="goal of the joints")
        return self._ask(goal.clip(self.low_rad, self.high_rad))

    def measure(self) -> Measurement:
        """Return the newest measurement, at most one tick old.

        Raises:
            LifecycleError: the arm is not running.
            PalpateError: the arm was stopped; states the reason, again in every later call.
        """
        return self._ask(np.empty(0))

    def stop(self) -> None:
        """Return the arm to its start and switch its torque off; can be called repeatedly.

        This does not move an arm that the guard has stopped.

        Raises:
            PalpateError: the arm was stopped on its way back; states the reason.
        """
        if self._process is None:
            return
        try:
            if self._ended is None:
                self._ask(None)
        except EOFError:
            return  # it ended as requested
        finally:
            self._line.close()
            self._process.wait(_END_S)
            self._process = None

    def _ask(self, what: FollowingJob | FloatArray | None) -> Measurement:
        if not self.running:
            raise LifecycleError("the arm is not running")
        if self._ended is not None:
            raise self._ended
        with suppress(OSError):  # the process has ended, and its message can be read
            self._line.send(what)
        try:
            answer = self._line.recv()
        except EOFError:
            if what is None:
                raise
            answer = PalpateError("the arm's process has ended unexpectedly; its last output is above")
        if isinstance(answer, PalpateError):
            self._ended = answer
            raise answer
        reading: Measurement = answer
        return reading


def main(descriptor: int) -> None:
    """Run the arm of `FollowingArm` at the other end of a pipe, in this process."""
    with Connection(descriptor) as line:
        try:
            run_following(line.recv(), line)
        except PalpateError as error:
            print(f"error: {error_text(error)}", file=sys.stderr, flush=True)
            with suppress(OSError):  # the program has died
                line.send(error)
