"""Probing plan: targets, speeds, forces and repeats."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Literal

import yaml
from pydantic import Field, field_validator, model_validator

from palpate.control.paths.excitation import Excitation
from palpate.control.paths.trajectory import blend_distance_m
from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive

Speed = Annotated[Positive, Field(le=1.0)]
JointSpeed = Annotated[float, Field(ge=0.05, le=20.0)]
Vector = tuple[Number, Number, Number]


@dataclass(frozen=True, slots=True)
class ProbingRunSpec:
    """One approach, loading, hold and retract: its number, target and speed [m/s]."""

    run: int
    target: int
    speed_m_s: float


class ProbingPlan(FileModel):
    """Plan of a probing task; every target is probed `repeats` times at all speeds."""

    # set speeds of approach and loading [m/s].
    speeds_m_s: Annotated[tuple[Speed, ...], Field(min_length=1, max_length=100)] = (0.15, 0.09, 0.06)
    # number of repeats of all speeds at each target.
    repeats: Annotated[int, Field(ge=1, le=1000, strict=True)] = 1
    # points near the surface, which is found by touch; empty for one target below the tip [m].
    targets_world_m: Annotated[tuple[Vector, ...], Field(max_length=1000)] = ()
    # direction in which the tool points and presses; it is normalized.
    press_direction_world: Vector = (0.0, 0.0, -1.0)
    # force at which loading ends, and which is held [N].
    force_limit_n: Annotated[Number, Field(ge=0.01, le=1000.0)] = 10.0
    hold_s: NotNegative = 1.0  # duration of the hold [s]
    # law of the hold, see `palpate.control.laws.force_laws`; the last two use the online estimate.
    hold_law: Literal["admittance", "force_tracking_impedance", "constant_force"] = "admittance"
    excitation: Excitation | None = None  # profile that is added to the hold afterwards, or None
    approach_clearance_m: Positive = 0.03  # an approach starts this far before the target [m]
    search_depth_m: Positive = 0.2  # distance from the approach start in which the surface must lie [m]
    max_depth_m: Positive = 0.15  # deepest indentation [m]
    retract_m: Positive = 0.03  # distance out of the object between runs [m]
    settle_s: NotNegative = 0.2  # rest before the free-air record [s]
    # free-air record before each approach, for bias and noise of the force [s].
    free_air_s: Annotated[float, Field(ge=0.05, le=60.0)] = 0.3
    # height of a swing of the tip up from the approach start and back down, before each run once at each
    # of the next speeds, so that the joints reverse in free air; 0 for no swings [m].
    free_air_swing_m: Annotated[NotNegative, Field(le=0.5)] = 0.0
    # speeds of the fastest joint in these swings, if joint_acceleration_rad_s2 allows them [rad/s].
    free_air_swing_speeds_rad_s: Annotated[tuple[JointSpeed, ...], Field(min_length=1, max_length=10)] = (
        0.3,
        1.0,
    )
    load_time_limit_s: Positive = 10.0  # time limit of loading [s]
    acceleration_m_s2: Positive = 3.0  # acceleration of the tip in free air [m/s^2]
    travel_speed_m_s: Speed = 0.15  # speed of the tip while retracting [m/s]
    joint_speed_rad_s: Positive = 1.0  # fastest joint while moving to a target [rad/s]
    joint_acceleration_rad_s2: Positive = 4.0  # largest joint acceleration while moving to a target [rad/s^2]

    @field_validator("press_direction_world")
    @classmethod
    def _make_unit(cls, direction: Vector) -> Vector:
        length = math.hypot(*direction)
        if length < 1e-6:
            raise ValueError("has no direction")
        x, y, z = direction
        return x / length, y / length, z / length

    @model_validator(mode="after")
    def _check_amounts(self) -> "ProbingPlan":
        if self.excitation and 2.0 * self.excitation.amplitude_n > 0.8 * self.force_limit_n:
            raise ValueError(
                f"excitation.amplitude_n {self.excitation.amplitude_n} N would reduce the force to "
                f"zero; use at most {0.4 * self.force_limit_n:.3g} N for force_limit_n "
                f"{self.force_limit_n} N"
            )
        run_up_m = blend_distance_m(max(self.speeds_m_s), self.acceleration_m_s2)
        for name in ("approach_clearance_m", "retract_m", "search_depth_m"):
            if getattr(self, name) < run_up_m:
                raise ValueError(
                    f"{name} {getattr(self, name)} m is too short to reach {max(self.speeds_m_s)} m/s at "
                    f"acceleration_m_s2 {self.acceleration_m_s2}; give at least {run_up_m:.4f} m"
                )
        return self

    @property
    def shortest_s(self) -> float:
        """Shortest duration of the plan [s], with every surface one clearance ahead of the tip."""
        ride_s = self.excitation.duration_s if self.excitation else 0.0
        still_s = self.settle_s + self.free_air_s + self.hold_s + ride_s
        approach_s = sum(self.approach_clearance_m / speed_m_s for speed_m_s in self.speeds_m_s)
        rounds = max(len(self.targets_world_m), 1) * self.repeats
        return rounds * (approach_s + len(self.speeds_m_s) * still_s)

    def runs(self) -> list[ProbingRunSpec]:
        """List all runs in order: by target, then by repeat, then by speed."""
        order = product(range(max(len(self.targets_world_m), 1)), range(self.repeats), self.speeds_m_s)
        return [ProbingRunSpec(run, target, speed_m_s) for run, (target, _, speed_m_s) in enumerate(order)]

    def to_yaml(self) -> str:
        """Write the whole plan, defaults included, in the form that `load` reads."""
        text: str = yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
        return text
