"""What the loop runs: a task turns one measurement into one command, tick after tick."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from control.loop.phases import Phase
from robot_io.types import Command, FloatArray, Measurement

NO_RUN = -1  # `run` between runs


@dataclass(frozen=True, slots=True)
class TaskEvent:
    """Something worth a line in the session, such as the touch of the object.

    Attributes:
        kind: short word for filters, such as "touch".
        text: one sentence for people.
        data: values for programs (numbers, strings), if any.
    """

    kind: str
    text: str
    data: Mapping[str, object] | None = None


class TaskOutput(NamedTuple):
    """What a task wants in one tick, and what it was aiming at.

    Attributes:
        command: joint torques wanted; the guard has the last word.
        reference_position_rad: shape (n,), where the joints should be [rad].
        reference_velocity_rad_s: shape (n,), how fast they should move [rad/s].
        tip_position_world_m: shape (3,), measured tip (forward kinematics of the measured joints) [m].
        tip_velocity_world_m_s: shape (3,), measured tip velocity [m/s].
        press_direction_world: shape (3,), unit vector into the object.
        desired_force_n: contact force aimed at, positive in compression [N]; NaN when it is free.
        phase: what the arm is doing.
        run: number of the probing run from 0, or `NO_RUN` between runs.
        done: the task has ended: this command is the last, and the arm may be let go where it stands.
        events: what happened in this tick.
    """

    command: Command
    reference_position_rad: FloatArray
    reference_velocity_rad_s: FloatArray
    tip_position_world_m: FloatArray
    tip_velocity_world_m_s: FloatArray
    press_direction_world: FloatArray
    desired_force_n: float
    phase: Phase
    run: int = NO_RUN
    done: bool = False
    events: tuple[TaskEvent, ...] = ()


class Task(Protocol):
    """Anything the loop can run; it sees measurements and time steps, never devices or clocks."""

    def start(self, measurement: Measurement) -> None:
        """Begin from the measured state; called once, in the first tick before `step`."""

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """One tick; what is raised, or returned in another shape than `TaskOutput` says, stops the arm.

        Args:
            measurement: this tick's measurement.
            dt_s: time since the previous tick [s]; a whole multiple of the period after an overrun.
        """
