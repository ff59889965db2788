"""Ways from one place to the next that stay above the object: up first where the tip would dip into it.

Joints that move in proportion swing the tip on an arc. Between two targets it bulges by up to centimetres,
more than a tool is lifted between runs.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from control.arm.inverse_kinematics import PlanarArm
from control.probing.plan import ProbingPlan
from control.probing.sites import ProbingSite
from robot_io.errors import InputError
from robot_io.types import FloatArray

_STEPS = 40  # places on a way that are looked at
_KEPT_SHARE = 0.5  # of the clearance between tool and object, on the way as well
_MOST_LIFTS = 5  # that are tried
_LIFT_MARGIN_M = 0.002
_ROUNDING_M = 1e-6


class Place(NamedTuple):
    """Where a way begins or ends.

    Attributes:
        position_rad: joint positions, shape (3,) [rad].
        site: the target that it is the approach start of; None: the tip cannot be lifted along a press line.
    """

    position_rad: FloatArray
    site: ProbingSite | None = None


class Passage(NamedTuple):
    """A way.

    Attributes:
        points_rad: from its start to its end, at rest in between, shape (3,) each [rad].
        too_low_m: how far its lowest place is too low [m]; 0 if it is not.
    """

    points_rad: tuple[FloatArray, ...]
    too_low_m: float

    def problem(self, where: str) -> str:
        """That it is too low, in words, and what would help."""
        return (
            f"on the way {where} the tip would come {1e3 * self.too_low_m:.1f} mm too near to the object and "
            "cannot be lifted more: give targets nearer to each other, or more approach_clearance_m and "
            "retract_m"
        )


class Passages:
    """Finds ways.

    Args:
        arm: closed-form kinematics.
        plan: direction of "down", and the clearance.
    """

    def __init__(self, arm: PlanarArm, plan: ProbingPlan) -> None:
        self._arm = arm
        u, w, _ = arm.plane_direction(np.array(plan.press_direction_world))
        self._down = np.array((u, w))
        self._spare_m = (1.0 - _KEPT_SHARE) * min(plan.retract_m, plan.approach_clearance_m)
        self._shares = np.linspace(0.0, 1.0, _STEPS)[:, None]

    def find(self, start: Place, end: Place) -> Passage:
        """The way with the least lifting that keeps clear of the object, or the highest there is.

        Between two targets the higher one counts; to or from any other place, the lower end.
        """
        ends = (start, end)
        depths_m = self._depths_m(np.array([start.position_rad, end.position_rad]))
        top_m = float(depths_m.min() if start.site and end.site else depths_m.max())
        best, level_m = self._at_level(ends, math.inf, top_m), top_m
        for _ in range(_MOST_LIFTS):
            if best.too_low_m <= 0.0:
                break
            passage = self._at_level(ends, level_m, top_m)
            level_m -= max(passage.too_low_m, 0.0) + _LIFT_MARGIN_M
            best = min(best, passage, key=lambda found: found.too_low_m)
        return best

    def check(self, start: Place, sites: Sequence[ProbingSite]) -> None:
        """The ways from the start to all sites in turn and back, with objects where they are expected.

        Raises:
            InputError: the tip would come too near to an object.
        """
        here, where = start, ""
        for number, site in enumerate(sites, 1):
            here, before = Place(site.joint_position_rad(here.position_rad), site), here
            where = f"target {number}"
            _refuse_if_low(self.find(before, here), f"to {where}")
        _refuse_if_low(self.find(here, start), f"back from {where}")

    def _at_level(self, ends: tuple[Place, Place], level_m: float, top_m: float) -> Passage:
        """The way whose ends are lifted to a level [m] where they are lower, and the site allows it."""
        start, end = ends
        up, over = self._lifted_rad(start, level_m), self._lifted_rad(end, level_m)
        across = up + self._shares * (over - up)
        too_low_m = float(self._depths_m(across).max()) - top_m - self._spare_m
        points = [start.position_rad]
        points += [up] if up is not start.position_rad else []
        points += [over] if over is not end.position_rad else []
        return Passage((*points, end.position_rad), max(too_low_m, 0.0))

    def _lifted_rad(self, place: Place, level_m: float) -> FloatArray:
        site = place.site
        if site is None:
            return place.position_rad
        lift_m = float(self._depths_m(place.position_rad[None])[0]) - level_m
        return site.lifted_rad(lift_m, place.position_rad) if lift_m > _ROUNDING_M else place.position_rad

    def _depths_m(self, position_rad: FloatArray) -> FloatArray:
        """How far down the tip is, shape (k,) [m], for joint positions of shape (k, 3) [rad]."""
        depths_m: FloatArray = self._arm.tips_in_plane(position_rad) @ self._down
        return depths_m


def _refuse_if_low(passage: Passage, where: str) -> None:
    if passage.too_low_m > 0.0:
        raise InputError(passage.problem(where))
