"""Candidate experiments of a probing arm, and their rehearsal in simulation.

A rehearsal runs the robot's own task with its checks and its force law, so it rejects a plan that the arm
cannot do. The simulated arm has the masses of its URDF and the lag of the robot's controller; without that
lag a rehearsal would predict motions that no real arm makes. No device is opened.
"""

import math
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.task import TaskOutput
from palpate.control.loop.tick_record import tick_stream
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.estimation.design.next_experiment import LONGEST_S
from palpate.estimation.workers import worker_pool
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.files.file_model import validate
from palpate.robot_io.robot_file import RobotFile, parse_robot_file
from palpate.robot_io.session import Samples
from palpate.robot_io.types import FloatArray, Measurement, Status

_FORCE_MARGIN = 1.2  # factor by which a press stays below the guard's force
_TILT_RAD = 0.35  # tilt of the tool in the arm's plane
_BESIDE_M = 0.1  # distance to another place on the surface
_ROOM_M = 0.03  # search depth beyond the expected surface at another place
_SHARED = ("speeds_m_s", "hold_s")  # settings that two combined experiments can share
_LOCATION_SETTINGS = frozenset({"press_direction_world", "targets_world_m"})
Settings = dict[str, Any]


@dataclass(frozen=True)
class CandidatePlan:
    """An experiment under consideration."""

    words: str  # what the arm does
    settings: Settings  # what differs from the plan before
    plan: ProbingPlan  # the whole plan

    @property
    def is_new_location(self) -> bool:
        """Whether the plan presses another place of the object, or in another direction."""
        return not _LOCATION_SETTINGS.isdisjoint(self.settings)


def candidates(before: ProbingPlan, robot_file: RobotFile, place_world_m: FloatArray) -> list[CandidatePlan]:
    """Return all experiments with a valid plan; the rehearsal checks whether the arm can do them.

    Args:
        before: the plan that was run first; its targets and all unchanged settings stay.
        robot_file: robot file whose guard limits the force.
        place_world_m: touched point of the surface, shape (3,) [m].
    """
    every = _experiments(before, robot_file, place_world_m)
    return [plan for words, settings in every if (plan := _candidate(before, words, settings)) is not None]


def combine_plans(first: CandidatePlan, second: CandidatePlan, before: ProbingPlan) -> CandidatePlan | None:
    """Combine two experiments into one; None if their settings conflict or the plan is invalid.

    Args:
        first: one experiment.
        second: the other one.
        before: the plan that was run first.
    """
    wants, others = ({k: v for k, v in plan.settings.items() if k not in _SHARED} for plan in (first, second))
    if not wants or not others or any(others.get(name, value) != value for name, value in wants.items()):
        return None
    speeds = {*first.settings.get("speeds_m_s", ()), *second.settings.get("speeds_m_s", ())}
    hold_s = max(plan.settings.get("hold_s", 0.0) for plan in (first, second)) or before.hold_s
    settings = {**wants, **others, "hold_s": hold_s, "speeds_m_s": sorted(speeds, reverse=True)[:3]}
    return _candidate(before, f"{first.words}, and {second.words}", settings)


def _candidate(before: ProbingPlan, words: str, settings: Settings) -> CandidatePlan | None:
    """Return an experiment; None if its plan is not valid, as an approach that is too short for the speed."""
    try:
        plan = validate(ProbingPlan, before.model_dump() | {"repeats": 1, "excitation": None} | settings)
    except InputError:
        return None
    return CandidatePlan(words, settings, plan)


def _experiments(
    before: ProbingPlan, robot_file: RobotFile, place_world_m: FloatArray
) -> Iterator[tuple[str, Settings]]:
    force_n = before.force_limit_n
    hard_n = min(2.0 * force_n, robot_file.limits.force_n / _FORCE_MARGIN)
    speeds = {"speeds_m_s": [0.15, 0.09, 0.06]}
    yield "press again as before, twice", {"repeats": 2, "speeds_m_s": list(before.speeds_m_s)}
    yield "press slowly and fast", {"speeds_m_s": [0.15, 0.05, 0.01], "hold_s": 1.0}
    yield f"press with {hard_n:.3g} N", {"speeds_m_s": [0.1, 0.03], "force_limit_n": hard_n}
    yield f"press with {force_n / 3:.2g} N", {"speeds_m_s": [0.1, 0.03], "force_limit_n": force_n / 3}
    yield "hold for 10 s", {"speeds_m_s": [0.1, 0.02], "hold_s": 10.0}
    yield "press several times in quick succession", {"speeds_m_s": [0.15], "hold_s": 0.1, "repeats": 5}
    yield "record free air before each press", {**speeds, "free_air_s": 4.0}
    for words, quantity, share, low_hz, high_hz, duration_s in (
        ("vary the force while pressing", "force", 0.3, 0.5, 8.0, 6.0),
        ("shake quickly while pressing", "position", 0.15, 2.0, 12.0, 4.0),
        ("move slowly back and forth while pressing", "position", 0.35, 0.1, 0.5, 20.0),
    ):
        wave = {"quantity": quantity, "amplitude_n": share * force_n, "duration_s": duration_s}
        wave |= {"low_hz": low_hz, "high_hz": high_hz}
        yield words, {"speeds_m_s": [0.05], "excitation": wave}
    for words, swing_m, rates in (
        ("swing in free air, slowly and fast", 0.2, [0.3, 3.0]),
        ("swing in free air, very slowly", 0.1, [0.1]),
        ("swing far in free air", 0.25, [0.5, 2.0]),
    ):
        swing = {"free_air_swing_m": swing_m, "free_air_swing_speeds_rad_s": rates}
        swing |= {"joint_acceleration_rad_s2": 8.0}
        yield words, {"speeds_m_s": [0.15, 0.06], **swing, "hold_s": 0.3}
    # Light presses in other postures or at other places of the object.
    lightly = {"speeds_m_s": [0.05], "force_limit_n": before.force_limit_n / 3, "hold_s": 0.3, "repeats": 2}
    lightly |= {"travel_speed_m_s": 0.08}
    for angle in (-2.0 * _TILT_RAD, -_TILT_RAD, _TILT_RAD, 2.0 * _TILT_RAD):
        # The direction turns in the vertical plane of the world's x axis, in which the shipped arms move.
        x, y, z = before.press_direction_world
        cosine, sine = math.cos(angle), math.sin(angle)
        tilted = {"press_direction_world": [cosine * x - sine * z, y, sine * x + cosine * z]}
        yield f"press with the tool tilted by {math.degrees(angle):.0f} degrees", {**tilted, **lightly}
    push = np.array(before.press_direction_world)
    out = np.array([*place_world_m[:2], 0.0])  # the arm's base is the origin
    out -= (out @ push) * push
    if np.linalg.norm(out) < _BESIDE_M:  # "out" is undefined here
        return
    out /= np.linalg.norm(out)
    for steps in (-2, -1, 1, 2):
        target = np.round(place_world_m + steps * _BESIDE_M * out, 4).tolist()
        words = f"press {100.0 * abs(steps) * _BESIDE_M:.0f} cm {'further out' if steps > 0 else 'nearer'}"
        searched = {"search_depth_m": before.approach_clearance_m + _ROOM_M}
        yield words, {"targets_world_m": [target], **searched, **lightly}


_KEPT = 64  # number of cached rehearsals


@dataclass(frozen=True)
class ArmText:
    """An arm as a session stores it."""

    robot: str  # text of its robot file
    urdf: str  # text of its URDF
    gravity_m_s2: tuple[float, float, float]  # fall acceleration in the axes of its base [m/s^2]
    # Origin of the texts, for error messages.
    origin: str = field(compare=False)  # ignored: the same arm moves alike in another session

    @property
    def robot_file(self) -> RobotFile:
        """Limits, gains and rate; raise `InputError` if the text is not valid."""
        return parse_robot_file(self.robot, f"{self.origin}, its robot file")

    @property
    def body(self) -> RigidBody:
        """Kinematics and masses; raise `InputError` if the text is not valid."""
        tip = self.robot_file.tip_frame
        return RigidBody.from_urdf(self.urdf, tip, self.gravity_m_s2, origin=f"{self.origin}, its URDF")


@dataclass(frozen=True)
class KnownObject:
    """A fitted spring and damper with a flat surface."""

    stiffness_n_m: float  # k [N/m]
    damping_n_s_m: float  # c [N s/m]
    surface_m: float  # position of the surface along its normal, in world coordinates [m]
    normal_world: tuple[float, float, float]  # unit vector into the object


@dataclass(frozen=True)
class PlanSimulation:
    """A plan to rehearse; equal rehearsals have equal results."""

    arm: ArmText  # limits, gains, rate and masses
    plan_json: str  # what is done
    known: KnownObject  # object that is pressed
    start_rad: tuple[float, ...]  # joint positions at the start [rad]


_known: OrderedDict[PlanSimulation, Samples | None] = OrderedDict()


def simulate_plans(simulations: Sequence[PlanSimulation], processes: int = 1) -> Iterator[Samples | None]:
    """Rehearse plans in parallel and in order; None for a plan that the arm cannot do.

    Earlier rehearsals are cached. The result does not depend on the number of processes.

    Args:
        simulations: plans to rehearse.
        processes: largest number of new processes; 1 to use only this one.
    """
    known = {trial: _known[trial] for trial in simulations if trial in _known}
    new = [trial for trial in dict.fromkeys(simulations) if trial not in known]
    parallel = processes > 1 and len(new) > 1
    with worker_pool(min(processes, len(new))) if parallel else nullcontext() as pool:
        simulated = pool.map(_simulate_or_none, new) if pool else map(_simulate_or_none, new)
        for trial in simulations:
            if trial not in known:
                known[trial] = next(simulated)
            _known[trial] = known[trial]
            _known.move_to_end(trial)
            if len(_known) > _KEPT:
                _known.popitem(last=False)
            yield known[trial]


def _simulate_or_none(simulation: PlanSimulation) -> Samples | None:
    try:
        return simulate_plan(simulation)
    except PalpateError:
        return None


def simulate_plan(simulation: PlanSimulation) -> Samples:
    """Simulate a probing run of this arm without noise; return its ticks.

    Args:
        simulation: arm, plan, object and start.

    Raises:
        InputError: the arm cannot do it within its limits.
        SafetyTripError: the task would stop.
    """
    known, robot_file, body = simulation.known, simulation.arm.robot_file, simulation.arm.body
    limits, torque_limits_nm = robot_file.limits, np.array(robot_file.limits.torque_nm)
    plan = ProbingPlan.model_validate_json(simulation.plan_json)
    task = ProbingTask.from_robot_file(robot_file, plan, body=body)
    push = np.array(plan.press_direction_world)
    normal = np.array(known.normal_world)
    dt_s, time_s = 1.0 / robot_file.control_rate_hz, 0.0
    position = np.array(simulation.start_rad)
    velocity, torque = np.zeros_like(position), body.gravity(position)
    rows: list[tuple[object, ...]] = []
    output: TaskOutput | None = None
    while output is None or not output.done:
        tip = body.tip_motion(position, velocity)
        along_m, speed_m_s = float(tip.position_world_m @ normal), float(tip.velocity_world_m_s @ normal)
        depth_m, pushed_n = along_m - known.surface_m, 0.0
        if depth_m > 0.0:
            pushed_n = max(known.stiffness_n_m * depth_m + known.damping_n_s_m * speed_m_s, 0.0)
        force_n = pushed_n * float(push @ normal)
        measured = Measurement(time_s, position, velocity, torque, force_n, time_s, time_s, time_s)
        if force_n > limits.force_n:  # refuse what the guard would trip on, or what takes too long
            raise InputError(f"the force would exceed {limits.force_n:g} N (limits.force_n)")
        beyond = np.abs(torque) > torque_limits_nm
        if beyond.any():
            raise InputError(
                f"joint {int(beyond.argmax()) + 1} would exceed its torque limit (limits.torque_nm)"
            )
        if time_s > LONGEST_S:
            raise InputError(f"takes more than {LONGEST_S:.0f} s")
        if output is None:
            task.start(measured)
        output = task.step(measured, dt_s)
        torque = output.command.joint_torque_nm
        rows.append(
            (time_s, output.run, output.phase, position, torque, force_n, output.tip_position_world_m)
        )
        lever_m = normal @ tip.jacobian_world[:3]
        acceleration = body.forward_dynamics(position, velocity, torque - lever_m * pushed_n)
        # The damper's force also acts within the step, which adds c dt b b^T to the mass matrix. Its inverse
        # follows by the formula of Sherman and Morrison (Ann. Math. Stat. 21, 1950).
        if pushed_n:
            mobility = np.linalg.solve(body.mass_matrix(position), lever_m)
            damping_s = known.damping_n_s_m * dt_s
            reduction = damping_s / (1.0 + damping_s * (lever_m @ mobility))
            acceleration = acceleration - reduction * (lever_m @ acceleration) * mobility
        velocity = velocity + dt_s * acceleration
        position = position + dt_s * velocity
        time_s += dt_s
    if task.failures:
        raise InputError(task.failures[0])
    # Ticks with the columns that channels need; all devices sample at the same time without faults.
    names = ("time_s", "run", "phase", "joint_position_rad", "torque_measured_nm", "force_n")
    values = zip((*names, "tip_position_world_m"), zip(*rows, strict=True), strict=True)
    columns = {name: np.array(column) for name, column in values}
    for device in ("encoder", "torque", "force"):
        columns[f"{device}_at_s"] = columns["time_s"]
        columns[f"{device}_status"] = np.full(len(rows), Status.OK)
    columns["press_direction_world"] = np.tile(push, (len(rows), 1))
    return Samples(tick_stream(columns["joint_position_rad"].shape[1]), columns)
