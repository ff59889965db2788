"""Check the signs of an arm's joints and force sensor, by hand and under power."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from palpate.calibration.arm_motion import FreeMotion
from palpate.common import console
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import Outcome
from palpate.control.loop.task import Phase, TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates
from palpate.control.paths.trajectory import JointMotion
from palpate.doctor.limits import describe_direction, random_poses_rad
from palpate.robot_io.examination import Finding, Level, fail, graded, ok, skip
from palpate.robot_io.guard import Guard, Limits
from palpate.robot_io.robot import Robot
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray, Measurement, Status
from palpate.runs.probing import TickRecords
from palpate.sim_backend.emulators.hardware import Plant

_MOVED_RAD = 0.12  # half of the requested turn
_PRESSED_N = 2.0
_SHOWN_RAD = 0.25
_START_S = 0.1
_STEP_S, _PATIENCE_S = 1e-3, 0.02  # a long patience is safe, because the arm has no power
_STILL_S = 0.5  # duration without motion after which the arm is at rest
_STILL_RAD = 0.02  # a hand turns a joint this far within a tenth of that time
_TOUCHED_N = 1.0  # half of what counts as pressed
_COUNT_S = 3
_DEVICES = ("encoder_status", "force_status")
_FAIL = Level.FAIL

_TURN_S, _TURN_RAD = 0.4, 0.25  # duration and angle of the emulated hand's turn
_PRESS_S, _PRESS_N = 0.3, 5.0
_AWAY_M = 0.05


NUDGE_RAD = 0.05
_STAY_S, _NUDGE_S = 0.5, 1.2
_TRACKING_RAD = 0.03  # less than the nudge, so that the guard stops a blocked joint before it is pushed hard
_PUSH_SHARE = 0.15  # push beyond the arm's weight, as a share of the torque limit
_FOLLOWED = 0.7  # share of a nudge that the joint must follow
_SPEED_SHARE = 0.2  # error of reported speeds, which some servos round
_SHARES = 0.2, 0.5  # error of a torque, as a share of the smaller one, from which it is a warning, a failure
_FLOOR_SHARE = 0.01  # error of the torque reading, as a share of the joint's torque limit
_CLEAR = (
    3.0  # multiple of friction and reading error from which a torque that is wrong by a factor of 2 shows
)
_STOP_S, _FEWEST_TICKS = 0.1, 10  # part of the motion that is examined after a stop


RESTLESS = fail("rest", "the arm does not come to rest", "let it lie or hang freely, and do not touch it")


class ArmOperator:
    """Person who moves the unpowered arm by printed instructions."""

    patience_s = 30.0

    def say(self, words: str) -> None:
        """Show an instruction."""
        console.stderr().print(words)

    def turn(self, joint: int, words: str) -> None:
        """Ask for a forward turn of a joint, counted from 0."""
        self.say(f"[bold]Turn joint {joint + 1} by hand[/bold], by about 15 degrees: {words}")

    def press(self, words: str) -> None:
        """Ask for a press against the tool."""
        self.say(f"[bold]Press gently with a finger[/bold] {words}")

    def advance(self, elapsed_s: float) -> None:
        """Continue the current action, which began `elapsed_s` ago [s]; a person needs no such call."""

    def rest(self) -> None:
        """Ask to let the arm go back and hold still."""
        self.say("Let it go back, and hold still.")

    def leave(self) -> None:
        """Ask to take every hand off the arm."""
        self.say("[bold]Hands away from the arm[/bold]")

    def count(self, left_s: int) -> None:
        """Announce the seconds left until the arm gets power."""
        self.say(f"[bold]Hands away:[/bold] power in {left_s} s")


class EmulatedOperator(ArmOperator):
    """Emulated hand that moves the simulated arm directly, without printing."""

    patience_s = 1.0

    def __init__(self, plant: Plant, robot_file: RobotFile) -> None:
        self._world = plant.world
        self._home_rad: FloatArray = np.array(robot_file.home_rad)
        self._joint: int | None = None
        self._pressing = False
        self._away_m = self._world.truth().tip_position_world_m[2] - _AWAY_M

    def say(self, words: str) -> None:
        """Print nothing."""

    def turn(self, joint: int, words: str) -> None:
        self._joint, self._pressing = joint, False

    def press(self, words: str) -> None:
        """See `ArmOperator.press`; moves the surface up to the tool, which points down in the home pose."""
        self._joint, self._pressing = None, True

    def advance(self, elapsed_s: float) -> None:
        world = self._world
        world.held = True
        if self._joint is not None:
            angles_rad = self._home_rad.copy()
            angles_rad[self._joint] += _TURN_RAD * min(1.0, elapsed_s / _TURN_S)
            world.place(angles_rad)
        if self._pressing:
            stiffness_n_m = getattr(world.object.law, "stiffness_n_m", 1e3)
            depth_m = _PRESS_N / stiffness_n_m * min(1.0, elapsed_s / _PRESS_S)
            world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)

    def rest(self) -> None:
        self._joint, self._pressing = None, False
        self._world.object.move_surface(self._away_m)
        self._world.place(self._home_rad)


def examine_signs(
    robot: Robot, robot_file: RobotFile, body: RigidBody, hand: ArmOperator
) -> Iterator[Finding]:
    """Ask for a turn of each joint and a press on the tool, and check the measured signs.

    Args:
        robot: configured robot, without power.
        robot_file: robot file of this robot.
        body: the arm's kinematics.
        hand: turns the joints and presses the tool.
    """
    for joint in range(robot.joint_count):
        if not _wait_until(robot, hand, _is_still):
            yield RESTLESS
            return
        angles_rad = _read_for(robot, _START_S)[-1].joint_position_rad
        turned_rad = angles_rad + _SHOWN_RAD * (np.arange(len(angles_rad)) == joint)
        way_m = body.tip_pose(turned_rad)[0] - body.tip_pose(angles_rad)[0]
        is_seen = np.linalg.norm(way_m) >= 1e-3
        hand.turn(
            joint, f"the tip goes {describe_direction(way_m)}" if is_seen else "in the positive direction"
        )
        yield _joint_finding(joint, _watch(robot, hand, lambda m: m.joint_position_rad, _MOVED_RAD))
    if not _wait_until(robot, hand, _is_still):
        yield RESTLESS
        return
    rest_n = _force_n(_read_for(robot, _START_S))
    tip_rotation = body.tip_pose(_read_for(robot, _START_S)[-1].joint_position_rad)[1]
    pressed = -tip_rotation @ robot_file.sensor_axis_tip
    hand.press(f"against the tip of the tool: {describe_direction(pressed)}, opposite to its sensor_axis_tip")
    yield _force_finding(float(_watch(robot, hand, lambda m: np.array([m.force_n]), _PRESSED_N)[0]))
    hand.leave()
    if _wait_until(robot, hand, lambda newest: abs(_force_n(newest) - rest_n) < _TOUCHED_N):
        yield ok("hands away", f"the force is back at {rest_n:+.2f} N")
        return
    force_n = _force_n(_read_for(robot, 0.1))
    value = f"{force_n:+.2f} N remain after the press; before it, the force was {rest_n:+.2f} N"
    yield fail("hands away", value, "take all hands off the arm; if the force stays, the sensor is stuck")


def _joint_finding(joint: int, moved_rad: FloatArray) -> Finding:
    subject, own_rad = f"sign of joint {joint + 1}", float(moved_rad[joint])
    most = int(np.argmax(np.abs(moved_rad)))
    value = f"{own_rad:+.2f} rad when turned forwards"
    if not abs(moved_rad[most]) >= _MOVED_RAD:  # true for NaN as well
        return fail(subject, f"{value}: no joint moved", "turn the joint further, or check its encoder")
    if most != joint:
        other = f"{value}, but joint {most + 1} moved by {moved_rad[most]:+.2f} rad"
        return fail(subject, other, "the drives' ids are in the wrong order: correct the robot file")
    remedy = "change 'reversed' of this joint in the robot file, and then correct its zero_rad"
    return graded(subject, value, (_FAIL, own_rad < 0, remedy))


def _force_finding(pressed_n: float) -> Finding:
    subject, value = "sign of the force", f"{pressed_n:+.2f} N when pressed"
    if not abs(pressed_n) >= _PRESSED_N:  # true for NaN as well
        return fail(
            subject,
            f"{value}: too small to show the sign",
            "press harder; if the force stays small, check the sensor",
        )
    remedy = "change 'reversed' of the force sensor in the robot file"
    return graded(subject, value, (_FAIL, pressed_n < 0, remedy))


def _is_still(measurements: list[Measurement]) -> bool:
    """Return whether no joint moved; False if a sample is faulty or a device has no valid one."""
    fresh = all(any(getattr(m, device) is Status.OK for m in measurements) for device in _DEVICES)
    good = fresh and all(
        max(m.encoder_status, m.force_status) < Status.FAULT and np.isfinite(m.force_n) for m in measurements
    )
    return good and bool((np.ptp([m.joint_position_rad for m in measurements], axis=0) < _STILL_RAD).all())


def _watch(
    robot: Robot, hand: ArmOperator, amounts: Callable[[Measurement], FloatArray], enough: float
) -> FloatArray:
    """Return the changes as soon as one of them is large enough, or at the time-out."""
    before: FloatArray = np.mean([amounts(m) for m in _read_for(robot, _START_S)], axis=0)
    begun_s = robot.clock.now_s()
    change = np.zeros_like(before)
    while (elapsed_s := robot.clock.now_s() - begun_s) < hand.patience_s:
        hand.advance(elapsed_s)
        newest = _read_for(robot, 0.02)[-1]
        if max(newest.encoder_status, newest.force_status) < Status.FAULT:
            change = amounts(newest) - before
        if np.abs(change).max() >= enough:
            break
    hand.rest()
    return change


def _wait_until(robot: Robot, hand: ArmOperator, condition: Callable[[list[Measurement]], bool]) -> bool:
    """Wait until a condition holds for half a second; return False at the time-out."""
    begun_s = robot.clock.now_s()
    newest: list[Measurement] = []
    while (elapsed_s := robot.clock.now_s() - begun_s) < _STILL_S + hand.patience_s:
        hand.advance(elapsed_s)
        newest += _read_for(robot, 0.02)
        newest = [m for m in newest if m.time_s > newest[-1].time_s - _STILL_S]
        if elapsed_s >= _STILL_S and condition(newest):
            return True
    return False


def _read_for(robot: Robot, duration_s: float) -> list[Measurement]:
    """Read measurements for a duration, at least one, each millisecond or as fast as the bus allows."""
    measurements: list[Measurement] = []
    end_s = robot.clock.now_s() + duration_s
    while robot.clock.now_s() < end_s or not measurements:
        robot.clock.sleep_until(robot.clock.now_s() + _STEP_S)
        measurements.append(robot.read(robot.clock.now_s() + _PATIENCE_S))
    return measurements


def _force_n(measurements: list[Measurement]) -> float:
    return float(np.mean([m.force_n for m in measurements]))


class NudgeTask:
    """Hold the arm, and move one joint after the other there and back."""

    def __init__(self, robot_file: RobotFile, body: RigidBody) -> None:
        self._free = FreeMotion(body, gains_of(robot_file).tracking)
        limits = robot_file.limits
        self._middle_rad = (np.array(limits.position_min_rad) + np.array(limits.position_max_rad)) / 2.0

    def start(self, measurement: Measurement) -> None:
        """See `palpate.control.loop.task.Task`; each joint moves to the side with more room."""
        self._elapsed_s = 0.0
        self._start_rad = measurement.joint_position_rad.copy()
        self._towards = np.where(self._start_rad > self._middle_rad, -1.0, 1.0)
        self._free.start(measurement)

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """See `palpate.control.loop.task.Task`; trips if something touches the tool."""
        self._elapsed_s += dt_s
        # Each joint in turn moves along half a cosine wave, with zero velocity at both ends.
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


def examine_powered(
    robot: Robot, robot_file: RobotFile, body: RigidBody, hand: ArmOperator
) -> Iterator[Finding]:
    """Count down, move a configured robot a little and check its signs; the torque is off at the end.

    A movement or force during the countdown is a failure, and the arm gets no power.

    Args:
        robot: configured robot, without power.
        robot_file: robot file of this robot.
        body: rigid-body model of the arm.
        hand: announces the countdown.

    Raises:
        DeviceError: a device failed before the first tick.
        KeyboardInterrupt: the user stopped the check; the arm is at rest.
    """
    if not _wait_until(robot, hand, _is_still):
        yield RESTLESS
        return
    before = _read_for(robot, 0.1)
    for left_s in range(_COUNT_S, 0, -1):
        hand.count(left_s)
        now = _read_for(robot, 1.0)
        spread_n = float(np.std([m.force_n for m in now]))
        touched = max(abs(_force_n(now) - _force_n(before)), spread_n) > _TOUCHED_N
        if touched or not _is_still(now) or not _is_still([*before, *now]):
            value = "the arm moves or is touched, so it gets no power"
            yield fail("hands away", value, "let the arm rest without anyone touching it, and start again")
            return
    limits = _reduced_limits(robot_file.limits, body)
    guard = Guard(limits, robot_file.safe_state, robot_file.joint_count, body.gravity)
    measured: list[Measurement] = []

    def observe(measurement: Measurement, _output: TaskOutput) -> Estimates:
        measured.append(measurement)
        return NO_ESTIMATE

    task, rate_hz = NudgeTask(robot_file, body), robot_file.control_rate_hz
    result = run_loop(robot, guard, task, robot.clock, TickRecords(), rate_hz=rate_hz, observer=observe)
    if result.outcome is Outcome.STOPPED and not result.deactivation_error:
        raise KeyboardInterrupt
    if result.deactivation_error:
        yield fail("torque off", result.deactivation_error, "cut the power supply now")
    floor_nm = _FLOOR_SHARE * np.array(robot_file.limits.torque_nm)
    if result.outcome is not Outcome.FINISHED:
        yield from _stopped(measured, body, floor_nm, result.cause)
        return
    time_s = np.array([m.time_s for m in measured]) - measured[0].time_s - _STAY_S
    for joint in range(robot_file.joint_count):
        begun = np.searchsorted(time_s, [(joint + half) * _NUDGE_S for half in (0.0, 0.5, 1.0)])
        there, back = (MeanMotion.of(measured[first:last], body) for first, last in itertools.pairwise(begun))
        moved_rad = abs(float((there.moved_rad - back.moved_rad)[joint])) / 2
        share = abs(float((there.reported_rad - back.reported_rad)[joint])) / 2 / max(moved_rad, 1e-9)
        is_stuck = moved_rad < _FOLLOWED * NUDGE_RAD
        is_scaled = not is_stuck and not abs(share - 1.0) <= _SPEED_SHARE
        value = f"moved {moved_rad:.3f} of {NUDGE_RAD:g} rad"
        value += f"; the reported speed is {share:.2f} times the rate of change of the position" * is_scaled
        stuck = "the joint does not follow: check friction, torque limit and torque constant"
        model = "the scale of the torque is then wrong, too; correct the drive's model in the robot file"
        remedies = (_FAIL, is_stuck, stuck), (_FAIL, is_scaled, model)
        yield graded(f"drive of joint {joint + 1}", value, *remedies)
        # Friction is half the difference of both ways.
        excess_nm = (there.held_nm - there.required_nm - back.held_nm + back.required_nm)[joint]
        held_nm, required_nm = (there.held_nm + back.held_nm) / 2, (there.required_nm + back.required_nm) / 2
        friction_nm = abs(float(excess_nm)) / 2
        yield _torque_finding(joint, held_nm[joint], required_nm[joint], floor_nm[joint], friction_nm)


class MeanMotion(NamedTuple):
    """Motion of all joints over a while, with its torques; each shape (n,)."""

    moved_rad: FloatArray  # by the positions [rad]
    reported_rad: FloatArray  # integral of the reported velocities [rad]
    held_nm: FloatArray  # mean of the reported torques [N m]
    required_nm: FloatArray  # mean torque that this motion requires without friction [N m]

    @classmethod
    def of(cls, measured: Sequence[Measurement], body: RigidBody) -> "MeanMotion":
        """Compute the means, with the acceleration of a parabola through the positions."""
        time_s = np.array([m.time_s for m in measured])
        position_rad = np.array([m.joint_position_rad for m in measured])
        velocity_rad_s = np.array([m.joint_velocity_rad_s for m in measured])
        acceleration_rad_s2 = 2.0 * np.polyfit(time_s - time_s[0], position_rad, 2)[0]
        middle_rad = position_rad.mean(axis=0)
        return cls(
            position_rad[-1] - position_rad[0],
            velocity_rad_s.mean(axis=0) * (time_s[-1] - time_s[0]),
            np.mean([m.joint_torque_nm for m in measured], axis=0),
            body.inverse_dynamics(middle_rad, np.zeros_like(middle_rad), acceleration_rad_s2),
        )


def _torque_finding(
    joint: int, held_nm: float, required_nm: float, floor_nm: float, friction_nm: float = 0.0
) -> Finding:
    """Compare a joint's mean torque with the URDF's; an error of a factor of 2 must be visible."""
    hidden_nm, off_nm = floor_nm + friction_nm, abs(held_nm - required_nm)
    warn_nm, fail_nm = (share * min(abs(held_nm), abs(required_nm)) + hidden_nm for share in _SHARES)
    subject = f"torque of joint {joint + 1}"
    value = (
        f"{held_nm:+.2f} N m, while the URDF's masses require {required_nm:+.2f} N m (allowed difference "
        f"{warn_nm:.2f} N m, friction {friction_nm:.2f} N m)"
    )
    if off_nm <= warn_nm and abs(required_nm) < _CLEAR * hidden_nm:
        return skip(
            subject, f"not checked, because the torque is too small: {value}", "palpate calibrate torque"
        )
    angles = (
        f"zero_rad and gear ratios of joints 1 to {joint + 1}" if joint else "its zero_rad and gear ratio"
    )
    remedy = (
        f"check the drive's model and torque constant, {angles}, and the URDF's masses and lengths; then run "
        "palpate calibrate torque and palpate calibrate gravity"
    )
    is_wrong, is_off = not off_nm <= fail_nm, not off_nm <= warn_nm  # both true for NaN
    return graded(subject, value, (_FAIL, is_wrong, remedy), (Level.WARN, is_off, remedy))


def _stopped(
    measured: Sequence[Measurement], body: RigidBody, floor_nm: FloatArray, cause: str
) -> Iterator[Finding]:
    """Name the joints whose torques contradict the last motion before the guard stopped the arm."""
    last = [m for m in measured if m.time_s > measured[-1].time_s - _STOP_S]
    last = [m for m in last if max(m.encoder_status, m.torque_status) < Status.FAULT]
    suspects = list[int]()
    # A contact explains any torque.
    if len(last) >= _FEWEST_TICKS and not abs(last[-1].force_n - measured[0].force_n) > _TOUCHED_N:
        motion = MeanMotion.of(last, body)
        for joint in range(body.joint_count):
            finding = _torque_finding(
                joint, motion.held_nm[joint], motion.required_nm[joint], floor_nm[joint]
            )
            if finding.level in {Level.WARN, _FAIL}:
                suspects.append(joint + 1)
                yield finding
    remedy = (
        "see the joints above; check the masses in the URDF, and 'reversed', 'zero_rad' and torque "
        "constants in the robot file"
    )
    if suspects:
        cause = cause.partition(";")[0]
        remedy = (
            f"only the torque of joint {suspects[0]} contradicts the motion; its line above says what to "
            "check"
        )
        if suspects[0] > 1:
            remedy += (
                "; a wrong angle of an earlier joint has the same effect, so compare the pose above with the "
                "arm's real pose"
            )
    if len(suspects) > 1:
        remedy = (
            f"the torques of joints {', '.join(map(str, suspects))} contradict the motion, so the faulty "
            "joint is unknown; compare the pose above with the arm's real pose (zero_rad, gear ratio), then "
            "check drive models and masses"
        )
    yield fail("small motion", f"the guard stopped the arm: {cause}", remedy)


def _reduced_limits(limits: Limits, body: RigidBody) -> Limits:
    """Return limits that trip after little motion or force of a held joint."""
    weight_nm = np.abs([body.gravity(pose) for pose in random_poses_rad(limits)]).max(axis=0)
    torque_nm = np.minimum(limits.torque_nm, weight_nm + _PUSH_SHARE * np.array(limits.torque_nm))
    tracking_rad = np.minimum(limits.tracking_rad, _TRACKING_RAD)
    return limits.model_copy(
        update={"tracking_rad": tuple(tracking_rad.tolist()), "torque_nm": tuple(torque_nm.tolist())}
    )
