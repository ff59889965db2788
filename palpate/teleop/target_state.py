"""What was probed so far: which of it the operator feels, and whether the follower still measures it."""

from math import dist, inf, nan

import numpy as np

from control.loop.task import Phase
from control.teleop.force_mismatch import MismatchMonitor
from control.teleop.virtual_object import ForceLaw
from palpate.teleop.object_law import force_law, terms_of
from palpate.teleop.summaries import summarize_trust
from robot_io.errors import InputError
from robot_io.link import ObjectEstimate, Report, short_number
from robot_io.link.messages import MOST_TARGETS
from sim_backend.scenario import Scenario

DOWN = (0.0, 0.0, -1.0)  # the virtual object is pressed downwards only
_TOUCHING = (Phase.LOADING, Phase.HOLD, Phase.UNLOADING)


class TargetStates:
    """Estimates by target. The nearest one is felt, and before the first the scene's guess.

    Attributes:
        received: how many estimates have come.
        felt: the one that is felt; None for the guess.
    """

    def __init__(self, scene: Scenario) -> None:
        self.received = 0
        self.felt: ObjectEstimate | None = None
        self._estimates: dict[int, ObjectEstimate] = {}
        self._revisions: dict[int, int] = {}  # newest by target, also of what cannot be felt
        self._law: ForceLaw = force_law(terms_of(scene))
        self._surface_m = np.array((0.0, 0.0, scene.object.surface_height_m))
        self._mismatch, self._told = MismatchMonitor(), set[object]()
        self._report_s = -inf

    @property
    def seen(self) -> tuple[int, ...]:
        """Revision of the newest estimate of each target, shape (n,) with n at most `MOST_TARGETS`."""
        return tuple(self._revisions.values())[-MOST_TARGETS:]

    def on_new_peer(self) -> None:
        """Another follower: it counts its estimates from 0 again."""
        self._revisions.clear()

    def take(self, estimate: ObjectEstimate) -> bool:
        """Take in an estimate; whether it is new. InputError: it is, but cannot be felt."""
        known = self._revisions.pop(estimate.target, -1)
        self._revisions[estimate.target] = max(known, estimate.revision)
        if estimate.revision <= known:
            return False
        self.received += 1
        if dist(estimate.direction_world, DOWN) > 1e-3:
            raise InputError("the virtual object is pressed downwards only")
        force_law(estimate.model)
        self._estimates[estimate.target] = estimate
        return True

    def choose(self, tip_world_m: tuple[float, ...]) -> ObjectEstimate | None:
        """The estimate that is to be felt from now on at this place, (3,) [m]; None if all stays as it is."""
        if not self._estimates:
            return None
        nearest = min(self._estimates.values(), key=lambda one: _away_m(one, tip_world_m))
        if nearest is self.felt:
            return None
        self.felt = nearest
        self._law, self._surface_m = force_law(nearest.model), np.array(nearest.surface_world_m)
        self._mismatch, self._told = MismatchMonitor(max(nearest.noise_n, 0.0)), set()
        return nearest

    def compare(self, report: Report, sent_s: float) -> list[str]:
        """Hold what the follower feels against what the virtual object would answer there.

        Returns:
            Where they disagree and it was not told yet, in words.
        """
        direction = np.array(report.direction_world)
        depth_m = float((np.array(report.tip_world_m) - self._surface_m).dot(direction))
        dt_s = min(max(sent_s - self._report_s, 1e-3), 1.0)
        self._report_s = sent_s
        predicted_n = self._law(depth_m, report.speed_m_s, dt_s)
        if report.phase not in _TOUCHING:
            return []
        place = (short_number(report.target), Phase(report.phase).name.lower())
        self._mismatch.add(place, depth_m, report.force_n, predicted_n)
        found = [one for one in self._mismatch.mismatches() if one.place not in self._told]
        self._told.update(one.place for one in found)
        return [f"target {place[0]}, {place[1]}: {one.summary()}" for one in found]

    def summary(self, tip_world_m: tuple[float, ...], age_s: float) -> str:
        """How far what is felt at this place can be trusted; `age_s` is that of its measurement [s]."""
        away_m = nan if self.felt is None else _away_m(self.felt, tip_world_m)
        return summarize_trust(self.felt, age_s, away_m)


def _away_m(estimate: ObjectEstimate, tip_world_m: tuple[float, ...]) -> float:
    """Across the press direction [m]."""
    return dist(estimate.surface_world_m[:2], tip_world_m[:2])
