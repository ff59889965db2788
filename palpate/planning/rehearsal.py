"""What a plan would make an arm do: the probing task on an arm without faults, pressing a known object.

It is the task that the robot runs, with its own checks and the force law that reacts to the object, so a plan
that the arm cannot do is refused here as it would be there. The arm has the masses of its URDF and lags
behind as under the robot's controller: one that turned round at once would promise to show what no arm
shows. No device is opened.
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context

import numpy as np

from control.arm.rigid_body import RigidBody
from control.loop.task import TaskOutput
from control.loop.tick_record import tick_stream
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from estimation.design.next_experiment import LONGEST_S
from estimation.end_workers import end_when_told, end_workers
from robot_io.errors import InputError, PalpateError
from robot_io.robot_file import RobotFile, parse_robot_file
from robot_io.session import Samples
from robot_io.types import Measurement, Status

_KEPT = 64  # rehearsals that are kept: those asked for longest ago would come out the same again


@dataclass(frozen=True)
class ArmText:
    """An arm as a session keeps it."""

    robot: str  # text of its robot file
    urdf: str  # text of its URDF
    gravity_m_s2: tuple[float, float, float]  # fall acceleration in the axes of its base [m/s^2]
    # Where these come from, for errors.
    origin: str = field(compare=False)  # the same arm of another session moves alike

    @property
    def robot_file(self) -> RobotFile:
        """Limits, gains and rate; `InputError` if the text is not valid."""
        return parse_robot_file(self.robot, f"{self.origin}, its robot file")

    @property
    def body(self) -> RigidBody:
        """Kinematics and masses; `InputError` if the text is not valid."""
        tip = self.robot_file.tip_frame
        return RigidBody.from_urdf(self.urdf, tip, self.gravity_m_s2, origin=f"{self.origin}, its URDF")


@dataclass(frozen=True)
class KnownObject:
    """A spring and damper with a flat surface, as a fit has it."""

    stiffness_n_m: float  # k [N/m]
    damping_n_s_m: float  # c [N s/m]
    surface_m: float  # where it begins, along its normal in world coordinates [m]
    normal_world: tuple[float, float, float]  # unit vector into the object

    def force_n(self, along_m: float, speed_m_s: float) -> float:
        """Normal force [N] on a tip at a place and speed along the normal; it never pulls."""
        depth_m = along_m - self.surface_m
        return max(self.stiffness_n_m * depth_m + self.damping_n_s_m * speed_m_s, 0.0) if depth_m > 0 else 0.0


@dataclass(frozen=True)
class Rehearsal:
    """What is rehearsed: two that are equal come out the same."""

    arm: ArmText  # limits, gains, rate and masses
    plan_json: str  # what is done
    known: KnownObject  # what is pressed
    start_rad: tuple[float, ...]  # joint positions at the start [rad]


_known: OrderedDict[Rehearsal, Samples | None] = OrderedDict()


def rehearse_all(rehearsals: Sequence[Rehearsal], processes: int = 1) -> Iterator[Samples | None]:
    """What `rehearse` says of each, in this order; None where the arm cannot do it.

    What was rehearsed before is remembered. The work of several processes comes out the same.
    """
    known = {one: _known[one] for one in rehearsals if one in _known}
    new = [one for one in rehearsals if one not in known]
    if processes == 1 or len(new) < 2:
        for one in rehearsals:
            yield _remembered(one, known[one] if one in known else _tried(one))
        return
    context = get_context("fork")
    with ProcessPoolExecutor(min(processes, len(new)), context, initializer=end_when_told) as pool:
        coming = {one: pool.submit(_tried, one) for one in new}
        try:
            for one in rehearsals:
                yield _remembered(one, coming[one].result() if one in coming else known[one])
        except BaseException:  # whoever asked wants no more, or a signal came: nobody waits for the others
            end_workers(pool)
            raise


def _remembered(rehearsal: Rehearsal, ticks: Samples | None) -> Samples | None:
    _known[rehearsal] = ticks
    _known.move_to_end(rehearsal)
    if len(_known) > _KEPT:
        _known.popitem(last=False)
    return ticks


def _tried(rehearsal: Rehearsal) -> Samples | None:
    try:
        return rehearse(rehearsal)
    except PalpateError:
        return None


def rehearse(rehearsal: Rehearsal) -> Samples:
    """The ticks of a probing of this arm, without noise: what channels are made of.

    Raises:
        InputError: the arm cannot do it within its limits.
        SafetyTripError: the task would stop.
    """
    known, robot_file, body = rehearsal.known, rehearsal.arm.robot_file, rehearsal.arm.body
    plan = ProbingPlan.model_validate_json(rehearsal.plan_json)
    task = ProbingTask.from_robot_file(robot_file, plan, body=body)
    push = np.array(plan.press_direction_world)
    normal = np.array(known.normal_world)
    dt_s, time_s = 1.0 / robot_file.control_rate_hz, 0.0
    position = np.array(rehearsal.start_rad)
    velocity, torque = np.zeros_like(position), body.gravity(position)
    rows: list[tuple[object, ...]] = []
    output: TaskOutput | None = None
    while output is None or not output.done:
        tip = body.tip_motion(position, velocity)
        along_m, speed_m_s = float(tip.position_world_m @ normal), float(tip.velocity_world_m_s @ normal)
        pushed_n = known.force_n(along_m, speed_m_s)
        force_n = pushed_n * float(push @ normal)
        measured = Measurement(time_s, position, velocity, torque, force_n, time_s, time_s, time_s)
        _check(measured, robot_file)
        if output is None:
            task.start(measured)
        output = task.step(measured, dt_s)
        torque = output.command.joint_torque_nm
        rows.append(
            (time_s, output.run, output.phase, position, torque, force_n, output.tip_position_world_m)
        )
        lever_m = tip.jacobian_world[:3].T @ normal
        mass = body.mass_matrix(position)
        if pushed_n:  # the damper pushes back within the step
            mass = mass + known.damping_n_s_m * dt_s * np.outer(lever_m, lever_m)
        free = torque - body.bias(position, velocity) - lever_m * pushed_n
        velocity = velocity + dt_s * np.linalg.solve(mass, free)
        position = position + dt_s * velocity
        time_s += dt_s
    if task.failures:
        raise InputError(task.failures[0])
    # Ticks with what channels are made of; all devices sample at the same time and are well.
    names = ("time_s", "run", "phase", "joint_position_rad", "torque_measured_nm", "force_n")
    values = zip((*names, "tip_position_world_m"), zip(*rows, strict=True), strict=True)
    columns = {name: np.array(column) for name, column in values}
    for device in ("encoder", "torque", "force"):
        columns[f"{device}_at_s"] = columns["time_s"]
        columns[f"{device}_status"] = np.full(len(rows), Status.OK)
    columns["press_direction_world"] = np.tile(push, (len(rows), 1))
    return Samples(tick_stream(columns["joint_position_rad"].shape[1]), columns)


def _check(measured: Measurement, robot_file: RobotFile) -> None:
    """Refuse what the guard would trip on, or what takes too long."""
    limits = robot_file.limits
    if measured.force_n > limits.force_n:
        raise InputError(f"the force would exceed {limits.force_n:g} N (limits.force_n)")
    beyond = np.abs(measured.joint_torque_nm) > np.array(limits.torque_nm)
    if beyond.any():
        raise InputError(f"joint {int(beyond.argmax()) + 1} would exceed its torque (limits.torque_nm)")
    if measured.time_s > LONGEST_S:
        raise InputError(f"takes more than {LONGEST_S:.0f} s")
