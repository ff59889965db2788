"""Run the probing task on the reference plant and record the result."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.control.arm.inverse_kinematics import Elbow, PlanarArm
from palpate.control.laws.gains import Gains
from palpate.control.loop.task import Phase, TaskEvent, TaskOutput
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.types import Measurement
from tests.control.reference_plant import DOWN, TOOL_AXIS_TIP, ReferencePlant, test_arm

TICK_S = 0.001
WIDE = (np.full(3, -3.1), np.full(3, 3.1))


@dataclass
class ProbingRecord:
    """One row a tick; forces are the plant's own."""

    time_s: np.ndarray
    force_n: np.ndarray
    phase: np.ndarray
    run: np.ndarray
    torque_nm: np.ndarray
    reference_rad: np.ndarray
    position_rad: np.ndarray
    outputs: list[TaskOutput]
    events: list[tuple[float, TaskEvent]]

    def kinds(self) -> list[str]:
        return [event.kind for _, event in self.events]

    def event(self, kind: str) -> TaskEvent:
        return next(event for _, event in self.events if event.kind == kind)

    def force_after_touch(self, run: int, wait_s: float) -> np.ndarray:
        """Forces of a run from `wait_s` after the first contact."""
        in_run = self.run == run
        touched_s = self.time_s[in_run & (self.force_n > 0.0)][0]
        return self.force_n[in_run & (self.time_s >= touched_s + wait_s)]

    def in_phase(self, phase: Phase, run: int = 0) -> np.ndarray:
        return (self.phase == phase) & (self.run == run)


def plant_above(
    height_m: float = 0.08, x_m: float = 0.42, elbow: Elbow = Elbow.POSITIVE, **settings
) -> ReferencePlant:
    """The reference plant with its tool pointing down at a height."""
    start = PlanarArm(test_arm(), TOOL_AXIS_TIP).solve(np.array([x_m, 0.0, height_m]), DOWN, elbow)
    return ReferencePlant(start.position_rad.copy(), **settings)


def probing_task(plan: ProbingPlan, gains: Gains | None = None, limits=WIDE, **more) -> ProbingTask:
    return ProbingTask(test_arm(), TOOL_AXIS_TIP, gains or Gains(), plan, position_limits_rad=limits, **more)


def started(plan: ProbingPlan, **limits) -> None:
    """Lets a task look at its plan, on the reference arm."""
    probing_task(plan, **limits).start(plant_above().measure())


def push(plant: ReferencePlant, force_n: Callable[[], float]) -> None:
    """From now on the force sensor feels `force_n()` as well."""
    truth = plant.measure

    def measure() -> Measurement:
        measurement = truth()
        return measurement._replace(force_n=measurement.force_n + force_n())

    plant.measure = measure


def run_probing(plant: ReferencePlant, task: ProbingTask, limit_s: float = 60.0) -> ProbingRecord:
    measurement: Measurement = plant.measure()
    task.start(measurement)
    rows, outputs, events = [], [], []
    while not outputs or not outputs[-1].done:
        assert plant.time_s < limit_s, "the task does not come to an end"
        measurement = plant.measure()
        output = task.step(measurement, TICK_S)
        outputs.append(output)
        events += [(plant.time_s, event) for event in output.events]
        rows.append((plant.time_s, plant.contact_force_n(), *plant.position_rad))
        plant.advance(output.command.joint_torque_nm, TICK_S)
    time_s, force_n, *position = np.array(rows).T
    return ProbingRecord(
        time_s,
        force_n,
        np.array([output.phase for output in outputs]),
        np.array([output.run for output in outputs]),
        np.array([output.command.joint_torque_nm for output in outputs]),
        np.array([output.reference_position_rad for output in outputs]),
        np.array(position).T,
        outputs,
        events,
    )
