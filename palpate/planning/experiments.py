"""What a probing arm could do next: changes to the plan that it ran, each of which shows something else."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from control.probing.plan import ProbingPlan
from robot_io.errors import InputError
from robot_io.files.file_model import validate
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray

_FORCE_MARGIN = 1.2  # of the guard's force, that a press stays below
_TILT_RAD = 0.35  # of the tool in the arm's plane
_BESIDE_M = 0.1  # to another place of the surface
_ROOM_M = 0.03  # behind where the surface is expected at another place, within which it must be touched
_SHARED = ("speeds_m_s", "hold_s")  # of which two experiments take what serves both
_ELSEWHERE = frozenset({"press_direction_world", "targets_world_m"})
Settings = dict[str, Any]


@dataclass(frozen=True)
class CandidatePlan:
    """An experiment that is considered."""

    words: str  # what the arm does
    settings: Settings  # what differs from the plan before
    plan: ProbingPlan  # the whole plan

    @property
    def is_elsewhere(self) -> bool:
        """Whether it presses another place of the object, or in another direction."""
        return not _ELSEWHERE.isdisjoint(self.settings)


def candidates(before: ProbingPlan, robot_file: RobotFile, place_world_m: FloatArray) -> list[CandidatePlan]:
    """All experiments that make a valid plan; whether the arm can do them is for a rehearsal to say.

    Args:
        before: the plan that was run first: targets and what is not changed stay.
        robot_file: whose guard limits the force.
        place_world_m: where the surface was touched, shape (3,) [m].
    """
    found = []
    for words, settings in (*_changes(before, robot_file), *_elsewhere(before, place_world_m)):
        try:
            found.append(CandidatePlan(words, settings, _plan(before, settings)))
        except InputError:  # such as an approach that is too short for the speed
            continue
    return found


def both(first: CandidatePlan, second: CandidatePlan, before: ProbingPlan) -> CandidatePlan | None:
    """One experiment with what two show; None where they want different things, or make no valid plan."""
    wants, others = ({k: v for k, v in one.settings.items() if k not in _SHARED} for one in (first, second))
    if not wants or not others or any(others.get(name, value) != value for name, value in wants.items()):
        return None
    speeds = {*first.settings.get("speeds_m_s", ()), *second.settings.get("speeds_m_s", ())}
    hold_s = max(one.settings.get("hold_s", 0.0) for one in (first, second)) or before.hold_s
    settings = {**wants, **others, "hold_s": hold_s, "speeds_m_s": sorted(speeds, reverse=True)[:3]}
    words = f"{first.words}, and {second.words}"
    try:
        return CandidatePlan(words, settings, _plan(before, settings))
    except InputError:
        return None


def _plan(before: ProbingPlan, settings: Settings) -> ProbingPlan:
    return validate(ProbingPlan, before.model_dump() | {"repeats": 1, "excitation": None} | settings)


def _changes(before: ProbingPlan, robot_file: RobotFile) -> Iterator[tuple[str, Settings]]:
    force_n = before.force_limit_n
    hard_n = min(2.0 * force_n, robot_file.limits.force_n / _FORCE_MARGIN)
    speeds = {"speeds_m_s": [0.15, 0.09, 0.06]}
    yield "press again as before, twice", {"repeats": 2, "speeds_m_s": list(before.speeds_m_s)}
    yield "press slowly and fast", {"speeds_m_s": [0.15, 0.05, 0.01], "hold_s": 1.0}
    yield f"press with {hard_n:.3g} N", {"speeds_m_s": [0.1, 0.03], "force_limit_n": hard_n}
    yield f"press with {force_n / 3:.2g} N", {"speeds_m_s": [0.1, 0.03], "force_limit_n": force_n / 3}
    yield "hold for 10 s", {"speeds_m_s": [0.1, 0.02], "hold_s": 10.0}
    yield "press quickly one after the other", {"speeds_m_s": [0.15], "hold_s": 0.1, "repeats": 5}
    yield "record free air before each press", {**speeds, "free_air_s": 4.0}
    for words, quantity, share, low_hz, high_hz, duration_s in (
        ("vary the force while pressing", "force", 0.3, 0.5, 8.0, 6.0),
        ("shake quickly while pressing", "position", 0.15, 2.0, 12.0, 4.0),
        ("turn round slowly while pressing", "position", 0.35, 0.1, 0.5, 20.0),
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


def _elsewhere(before: ProbingPlan, place_world_m: FloatArray) -> Iterator[tuple[str, Settings]]:
    """Light presses with the arm in another posture, which are of another place to the object."""
    lightly = {"speeds_m_s": [0.05], "force_limit_n": before.force_limit_n / 3, "hold_s": 0.3, "repeats": 2}
    lightly |= {"travel_speed_m_s": 0.08}
    for angle in (-2.0 * _TILT_RAD, -_TILT_RAD, _TILT_RAD, 2.0 * _TILT_RAD):
        tilted = {"press_direction_world": _tilted(before.press_direction_world, angle)}
        yield f"press with the tool tilted by {math.degrees(angle):.0f} degrees", {**tilted, **lightly}
    push = np.array(before.press_direction_world)
    out = np.array([*place_world_m[:2], 0.0])  # the arm's base is the origin
    out -= (out @ push) * push
    if np.linalg.norm(out) < _BESIDE_M:  # there is no telling where out is
        return
    out /= np.linalg.norm(out)
    for steps in (-2, -1, 1, 2):
        target = np.round(place_world_m + steps * _BESIDE_M * out, 4).tolist()
        words = f"press {100.0 * abs(steps) * _BESIDE_M:.0f} cm {'further out' if steps > 0 else 'nearer'}"
        searched = {"search_depth_m": before.approach_clearance_m + _ROOM_M}
        yield words, {"targets_world_m": [target], **searched, **lightly}


def _tilted(direction: tuple[float, float, float], angle_rad: float) -> list[float]:
    """A direction turned in the vertical plane of the world's x axis, in which the shipped arms move."""
    x, y, z = direction
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return [cosine * x - sine * z, y, sine * x + cosine * z]
