"""Response of a follower's simulated arm to arbitrary targets."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.loop.result import Outcome
from palpate.control.loop.task import TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.control.teleop.follower_task import FollowerTask, TargetQueue
from palpate.robot_io.calibration.applied import load_calibrations
from palpate.robot_io.link.messages import Intent, Target, TargetState
from palpate.robot_io.types import Measurement
from palpate.runs.robots import find_robot
from palpate.runs.session import ArmJob, arm_session

_PLAN = ProbingPlan(speeds_m_s=(0.15,), hold_s=0.1, settle_s=0.05, free_air_s=0.1)
_AT_ONCE = 32  # targets that are handed over


@dataclass
class Driven:
    """How far the arm went, as shares of the limits at which its guard trips."""

    states: Counter[str]  # what became of the targets
    finished: bool = False  # else the guard has tripped, or something failed
    position: float = 0.0  # 1 is at an end of a joint's range, 0 in its middle
    velocity: float = 0.0
    force: float = 0.0


class _Queue(TargetQueue):
    """A queue that a leader fills as soon as it is empty, and that counts what becomes of its targets."""

    def __init__(self, targets: Iterable[Target]) -> None:
        super().__init__()
        self.linked, self.counts = True, Counter[str]()
        self._wanted = [replace(target, number=number) for number, target in enumerate(targets)]

    def fill(self) -> None:
        """Ask for more, if all that was asked for is over."""
        over = self.counts.total()
        if over == self._newest + 1:
            some = tuple(self._wanted[over : over + _AT_ONCE])
            self.take(Intent(some, (), (), ended=not some))

    def finish(self, state: TargetState, remark: str = "") -> None:
        self.counts[state.name.lower()] += 1
        super().finish(state, remark)


def drive(targets: Iterable[Target], folder: Path) -> Driven:
    """Let the arm probe them, one after the other; its session goes into the folder."""
    robot_file, queue = find_robot("follower"), _Queue(targets)
    calibrations = load_calibrations(robot_file)
    body, limits = RigidBody.of_robot(robot_file), robot_file.limits
    low, high = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
    driven = Driven(queue.counts)

    def probing(target: Target) -> ProbingTask:
        place = {"targets_world_m": (target.position_world_m,)}
        plan = _PLAN.model_copy(update=place | {"press_direction_world": target.direction_world})
        return ProbingTask.from_robot_file(robot_file, plan, calibrations, body)

    def observe(measurement: Measurement, _output: TaskOutput) -> Estimates:
        queue.fill()
        share = np.abs(measurement.joint_position_rad - 0.5 * (low + high)) / (0.5 * (high - low))
        driven.position = max(driven.position, float(share.max()))
        share = np.abs(measurement.joint_velocity_rad_s) / np.array(limits.velocity_rad_s)
        driven.velocity = max(driven.velocity, float(share.max()))
        driven.force = max(driven.force, abs(measurement.force_n) / limits.force_n)
        return NO_ESTIMATE

    task = FollowerTask(body, np.array(robot_file.sensor_axis_tip), gains_of(robot_file), queue, probing)
    with arm_session(ArmJob(robot_file, folder / "driven.mcap"), calibrations, {}) as arm:
        result = arm.run(task, observe)
    driven.finished = result.outcome is Outcome.FINISHED
    return driven
