"""The probing task: several speeds, repeats and targets, one run after the other.

MOVE -> FREE_AIR -> APPROACH -> LOADING -> HOLD -> UNLOADING -> RETRACT -> MOVE -> ... -> IDLE

Before a run the arm may swing up and down in free air, a MOVE as well (`free_air_swing_m`).
The last move returns to the start pose, in which the arm was at rest without torque.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from palpate.control.arm.inverse_kinematics import PlanarArm
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.disturbance_observer import DisturbanceObserver
from palpate.control.laws.gains import Gains, gains_of
from palpate.control.laws.hybrid import ControlOutput, HybridController
from palpate.control.laws.touch import free_air_problem
from palpate.control.loop.task import NO_RUN, Phase, TaskEvent, TaskOutput, make_output
from palpate.control.loop.tick_record import Estimates
from palpate.control.paths.trajectory import JointBrake, JointPath
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.routes import RouteEnd, Routes, Swing
from palpate.control.probing.run import ProbingRun
from palpate.control.probing.sites import check_against_guard, probing_sites
from palpate.robot_io.calibration.applied import Calibrations
from palpate.robot_io.errors import InputError, SafetyTripError
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray, Measurement, frozen_array

_OBSTACLE_SHARE = 0.5  # share of the force limit that counts as an obstacle while moving
_LEAVING_SHARE = 1.5  # likewise while moving away from an obstacle
_OBSTACLE_TICKS = 3
_BRAKE_FACTOR = 5.0  # braking at an obstacle, as a multiple of a move's acceleration
_OUTWARD = (Phase.UNLOADING, Phase.RETRACT)  # not monitored, because friction acts in the other direction
_IN_FREE_AIR = (Phase.IDLE, Phase.MOVE, Phase.FREE_AIR)
_REST_RAD_S = 0.05  # fastest joint of an arm at rest
_REST_WAIT_S = 2.0  # longest wait for rest after a move


class ProbingTask:
    """Task that executes a `ProbingPlan`; see `palpate.control.loop.task.Task`.

    Args:
        body: model of the arm.
        sensor_axis_tip: direction in which the tool pushes, tip frame, shape (3,).
        gains: gains of all laws.
        plan: plan of the probing.
        position_limits_rad: lowest and highest joint positions, shape (n,) each [rad]; None for the URDF's.
        velocity_limits_rad_s: the guard's velocity limits, shape (n,) [rad/s]; None for no check.
        torque_limits_nm: largest torques, shape (n,) [N m]; None for no check.
        estimated: returns the online estimate for the plan's hold law, see `HybridController`.

    Attributes:
        failures: one line for each run that gave no data.
        runs_done: number of runs that gave data.
        cancelled: whether the task was canceled.

    Raises:
        InputError: the arm is not planar, or the tool does not lie in its plane.
    """

    def __init__(
        self,
        body: RigidBody,
        sensor_axis_tip: FloatArray,
        gains: Gains,
        plan: ProbingPlan,
        *,
        position_limits_rad: tuple[FloatArray, FloatArray] | None = None,
        velocity_limits_rad_s: FloatArray | None = None,
        torque_limits_nm: FloatArray | None = None,
        estimated: Callable[[], Estimates] | None = None,
    ) -> None:
        self._body = body
        self._arm = PlanarArm(body, sensor_axis_tip)
        axis_tip = frozen_array(sensor_axis_tip, (3,))
        self._control = HybridController(body, axis_tip, gains, plan.hold_law, estimated)
        feedforward = gains.contact.force_feedforward
        self._disturbance = DisturbanceObserver(
            body, gains.disturbance_observer, plan.force_limit_n, feedforward
        )
        self._gains = gains
        self._plan = plan
        self._limits_rad = position_limits_rad or body.position_limits_rad
        self._velocity_limits_rad_s, self._torque_limits_nm = velocity_limits_rad_s, torque_limits_nm
        self._direction = frozen_array(plan.press_direction_world)
        self._phase = Phase.IDLE
        self.failures: tuple[str, ...] = ()
        self.runs_done = 0
        self.cancelled = False

    @classmethod
    def from_robot_file(
        cls,
        robot_file: RobotFile,
        plan: ProbingPlan,
        calibrations: Calibrations | None = None,
        body: RigidBody | None = None,
        estimated: Callable[[], Estimates] | None = None,
    ) -> "ProbingTask":
        """Make the task for the arm of a robot file.

        Args:
            robot_file: arm, gains and limits.
            plan: plan of the probing.
            calibrations: calibrations, as for `RigidBody.of_robot`.
            body: model of the arm; None to build it.
            estimated: returns the online estimate for the plan's hold law.

        Raises:
            InputError: URDF or gains are invalid, the arm is not planar, or its guard trips on the plan.
        """
        check_against_guard(plan, robot_file)
        body = body or RigidBody.of_robot(robot_file, calibrations)
        limits = robot_file.limits
        return cls(
            body,
            np.array(robot_file.sensor_axis_tip),
            gains_of(robot_file),
            plan,
            position_limits_rad=(np.array(limits.position_min_rad), np.array(limits.position_max_rad)),
            velocity_limits_rad_s=np.array(limits.velocity_rad_s),
            torque_limits_nm=np.array(limits.torque_nm),
            estimated=estimated,
        )

    def start(self, measurement: Measurement) -> None:
        """Begin from the measured posture, at rest and clear of everything.

        Args:
            measurement: state of the arm.

        Raises:
            InputError: a target cannot be probed from here or at the plan's speeds, or the force is too large
                for a bias of the sensor.
        """
        touch = self._gains.touch
        if problem := free_air_problem(
            measurement.force_n, touch.touch_force_n, self._plan.force_limit_n, touch
        ):
            raise InputError(f"before the arm moves: {problem}")
        position_rad = measurement.joint_position_rad
        self._start = self._place = RouteEnd(position_rad.copy())
        tip, _ = self._body.tip_pose(position_rad)
        most_rad_s = self._velocity_limits_rad_s
        self._sites = probing_sites(
            self._arm, self._plan, tip, position_rad, self._limits_rad, velocity_limits_rad_s=most_rad_s
        )
        self._routes = Routes(self._arm, self._plan)
        self._routes.check(self._start, self._sites, self._body, self._torque_limits_nm)
        self._control.start(measurement)
        self._disturbance.restart()
        self._specs = deque(self._plan.runs())
        self._run: ProbingRun | None = None
        self._events: list[TaskEvent] = []
        self.runs_done = 0
        self.failures, self.cancelled = (), False
        self._obstacle_share = _OBSTACLE_SHARE
        self._begin_route()

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Compute one tick; see `palpate.control.loop.task.Task.step`.

        Raises:
            SafetyTripError: force sensor and joint torques contradict each other, an obstacle blocks the way
                back, or the arm does not come to rest.
        """
        self._events = []
        run = self._run
        if run is not None:
            output, phase = run.step(measurement, dt_s), run.phase
            self._events.extend(run.events)
            if run.finished:  # begin the next; a target without a touch is dropped
                if run.failure:
                    self.failures += (run.failure,)
                    self._drop_target(run.spec.target)
                else:
                    self.runs_done += 1
                self._run = None
                self._place = RouteEnd(self._control.reference_rad, self._sites[run.spec.target])
                self._begin_route()
        else:
            output = self._move(measurement, dt_s)
            phase = self._phase
        if phase in _OUTWARD:
            self._disturbance.pause()
        else:
            self._disturbance.update(measurement, output, dt_s, in_free_air=phase in _IN_FREE_AIR)
        return make_output(
            output.command,
            output.motion,
            output.tip,
            self._direction,
            phase,
            desired_force_n=run.desired_force_n if run else math.nan,
            run=run.spec.run if run else NO_RUN,
            done=phase is Phase.IDLE,
            events=tuple(self._events),
        )

    def cancel(self, why: str) -> None:
        """Drop the current and all remaining runs, and return to the start pose.

        Args:
            why: reason, for the failure.
        """
        returning = self._run is None and not self._specs
        if self.cancelled or returning:
            return
        self.cancelled = True
        self._specs.clear()
        if self._run is not None:
            self._run.cancel(why)
        else:
            self._fail("cancelled", why)
            self._turn_back()

    def _begin_route(self) -> None:
        """Move to the next run's approach start, or back to the start pose."""
        self._swings: deque[Swing] = deque()
        route = None
        while self._specs and route is None:
            target = self._specs[0].target
            site = self._sites[target]
            place = RouteEnd(site.joint_position_rad(self._place.position_rad), site)
            route = self._routes.find(self._place, place)
            if route.clearance_deficit_m > 0.0:
                self._fail("no_way", route.problem(f"to target {target + 1}"))
                self._drop_target(target)
                route = None
                continue
            self._swings.extend(self._routes.swings_at(site, place.position_rad))
            if self._plan.free_air_swing_m and not self._swings:
                text = f"no swing before target {target + 1}: the tip would come too close to the object"
                self._events.append(TaskEvent("no_swing", text))
        if route is None:
            route = self._routes.find(self._place, self._start)
        self._follow(route.points_rad)

    def _fail(self, kind: str, text: str) -> None:
        self.failures += (text,)
        self._events.append(TaskEvent(kind, text))

    def _drop_target(self, target: int) -> None:
        self._specs = deque(spec for spec in self._specs if spec.target != target)

    def _follow(self, points_rad: Sequence[FloatArray], speed_rad_s: float | None = None) -> None:
        plan = self._plan
        self._phase = Phase.MOVE
        self._move_s = 0.0
        self._blocked_ticks = 0
        self._path = JointPath(
            points_rad, speed_rad_s or plan.joint_speed_rad_s, plan.joint_acceleration_rad_s2
        )
        self._brake: JointBrake | None = None

    def _move(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        self._move_s += dt_s
        current_path = self._brake or self._path
        output = self._control.step_joints(measurement, current_path.at(self._move_s), dt_s)
        share = abs(output.force_n) / self._plan.force_limit_n
        if share < _OBSTACLE_SHARE:
            self._obstacle_share = _OBSTACLE_SHARE
        is_touch = abs(output.force_n) > self._control.switch.touch_force_n  # rather than sensor noise
        is_strong = share > self._obstacle_share
        self._blocked_ticks = self._blocked_ticks + 1 if is_strong and is_touch else 0
        is_blocked = self._blocked_ticks >= _OBSTACLE_TICKS
        if is_blocked:
            # Return without the remaining runs; if already returning, trip the guard.
            reason = f"{output.force_n:.1f} N on the way"
            if not self._specs:
                raise SafetyTripError(f"{reason} back to the start of the task: something is in the way")
            text = f"{reason} to a target: something is in the way"
            self._fail("obstacle", text)
            self._specs.clear()
            self._obstacle_share = _LEAVING_SHARE
            self._turn_back()
        elif self._brake:
            if self._move_s >= self._brake.duration_s:
                home = self._routes.find(self._place, self._start).points_rad
                self._follow((self._control.reference_rad, *self._passed_rad, *home[1:]))
        elif self._swings:
            if self._move_s >= self._path.duration_s:
                swing = self._swings.popleft()
                self._place = swing.start
                self._follow(swing.points_rad, swing.speed_rad_s)
        elif self._move_s >= self._path.duration_s + self._plan.settle_s:
            if self._specs:
                spec = self._specs.popleft()
                site = self._sites[spec.target]
                self._control.set_line(site.line, site.approach_travel_m)
                self._run = ProbingRun(self._control, site, spec, self._plan, self._gains)
            else:
                fastest_rad_s = float(np.abs(measurement.joint_velocity_rad_s).max())
                if fastest_rad_s < _REST_RAD_S:
                    self._phase = Phase.IDLE
                    text = f"{self.runs_done} runs done, {len(self.failures)} failures"
                    self._events.append(TaskEvent("probing_done", text, {"runs": self.runs_done}))
                elif self._move_s > self._path.duration_s + self._plan.settle_s + _REST_WAIT_S:
                    raise SafetyTripError(
                        f"{_REST_WAIT_S} s after the return to the start, a joint still moves at "
                        f"{fastest_rad_s:.3g} rad/s, so the arm does not come to rest"
                    )
        return output

    def _turn_back(self) -> None:
        """Brake, and return along the path that the arm came."""
        self._swings.clear()
        self._blocked_ticks = 0
        self._passed_rad = self._path.passed_rad(self._move_s)
        limit_rad_s2 = _BRAKE_FACTOR * self._plan.joint_acceleration_rad_s2
        self._brake, self._move_s = self._path.brake_at(self._move_s, limit_rad_s2), 0.0
