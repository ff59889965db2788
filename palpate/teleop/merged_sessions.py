"""Merge a leader's and a follower's session on one timeline, and compute the error of the felt force."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from palpate.common.console import significant
from palpate.control.loop.task import IN_CONTACT, Phase
from palpate.control.loop.tick_record import STREAM_NAME as TICK
from palpate.control.teleop.messaging import STREAM_NAME as LINK
from palpate.control.teleop.virtual_object import ForceLaw
from palpate.robot_io.errors import InputError
from palpate.robot_io.link.messages import short_number
from palpate.robot_io.session import Event, Samples, Session
from palpate.robot_io.types import BoolArray, FloatArray
from palpate.sim_backend.scenario import Scenario
from palpate.teleop.follower import ESTIMATE
from palpate.teleop.haptics import FEEL, GUESS
from palpate.teleop.haptics import STREAM_NAME as HAPTIC
from palpate.teleop.virtual_object import force_law, terms_in, terms_of

TOUCH_S = 0.005  # time after a touch in which passivity limits the damper's force
_TICK_S = 1e-3
_TOO_SLOW = 0.01  # share of missed ticks or lost time above which the machine was too slow
_APART_S = 0.05  # shortest time between two touches
_LEAST_N = 0.2  # smallest real force that is included in the comparison


@dataclass(frozen=True)
class ForceComparison:
    """Comparison of two forces, shape (n,) each."""

    time_s: FloatArray  # on the leader's clock [s]
    rendered_n: FloatArray
    real_n: FloatArray
    stalled: BoolArray  # whether the machine missed a tick at the start of the touch

    @property
    def share(self) -> float:
        """Root mean square of the difference, relative to the real force's; NaN without samples."""
        if not len(self.real_n):
            return float("nan")
        return float(np.sqrt(np.mean((self.rendered_n - self.real_n) ** 2) / np.mean(self.real_n**2)))

    def settled(self) -> "ForceComparison":
        """Return the comparison without each touch's first `TOUCH_S`, and without touches that began late."""
        begins_s = self.time_s[np.diff(self.time_s, prepend=-np.inf) > _APART_S]
        since_s = self.time_s - begins_s[np.searchsorted(begins_s, self.time_s, side="right") - 1]
        return self.select((since_s >= TOUCH_S) & ~self.stalled)

    def select(self, rows: BoolArray) -> "ForceComparison":
        """Return the comparison with the selected samples."""
        return ForceComparison(
            self.time_s[rows], self.rendered_n[rows], self.real_n[rows], self.stalled[rows]
        )

    def summary(self) -> str:
        """Return the share, such as "1.2 % rms of 8000 samples"."""
        if not len(self.real_n):
            return "nothing to compare"
        return f"{100.0 * self.share:.2g} % rms of {len(self.real_n)} samples"


@dataclass(frozen=True)
class MergedSessions:
    """Both sessions, with times on the leader's clock."""

    leader: Session
    follower: Session

    @cached_property
    def haptic(self) -> Samples:
        """Ticks of the haptic loop."""
        return self.leader.samples(HAPTIC)

    @cached_property
    def ticks(self) -> Samples:
        """Ticks of the follower."""
        return self.follower.samples(TICK)

    @cached_property
    def exchanges(self) -> FloatArray:
        """Leader's time, follower's clock minus leader's, round trip by exchange; shape (n, 3) [s], n > 0.

        Raises:
            InputError: neither side received a message from the other.
        """
        for session, sign in ((self.leader, 1.0), (self.follower, -1.0)):
            link = session.samples(LINK)
            known = np.isfinite(link["peer_offset_s"])
            if known.any():
                offset_s = sign * link["peer_offset_s"][known]
                own_s = link["time_s"][known]
                time_s = own_s if sign > 0 else own_s - offset_s
                return np.column_stack((time_s, offset_s, link["round_trip_s"][known]))
        raise InputError(
            f"{self.leader.path} and {self.follower.path}: neither received a message from the other"
        )

    @property
    def offset_s(self) -> float:
        """Follower's clock minus leader's, from the exchange with the shortest round trip [s]."""
        return float(self.exchanges[self.exchanges[:, 2].argmin(), 1])

    @property
    def round_trip_s(self) -> float:
        """Shortest round trip [s]; the offset's uncertainty is half of it."""
        return float(self.exchanges[:, 2].min())

    def clock_summary(self) -> str:
        """Describe the error of the common timeline; the clocks' offset itself has no meaning."""
        durations_s = 0.5 * self.round_trip_s, float(np.ptp(self.exchanges[:, 1]))
        scaled = ((s, "s") if s >= 1.0 else (1e3 * s, "ms") for s in durations_s)
        error, drift = (f"{significant(size, size)} {unit}" for size, unit in scaled)
        return (
            f"the follower's times are shown on the leader's clock; the clocks' offset is known to within "
            f"{error} (half the shortest round trip) and drifted by {drift} over the session"
        )

    @property
    def missed_share(self) -> float:
        """Share of the leader's haptic ticks that were skipped, or late by a period or more."""
        time_s, late = self.haptic["time_s"], self.haptic["lateness_s"] >= _TICK_S
        due = max(round((time_s[-1] - time_s[0]) / _TICK_S) + 1, len(time_s))
        return float((due - len(time_s) + np.count_nonzero(late)) / due)

    @property
    def slipped_share(self) -> float:
        """Share of the leader's time by which the follower's clock fell behind, as a simulated clock may."""
        time_s, offset_s, _ = self.exchanges.T
        if np.ptp(time_s) == 0.0:
            return 0.0
        return max(0.0, -float(np.polyfit(time_s - time_s[0], offset_s - offset_s[0], 1)[0]))

    def slowness(self) -> list[str]:
        """List, as clauses, the parts for which the machine was too slow; empty if it was fast enough."""
        clauses = []
        if self.missed_share > _TOO_SLOW:
            gap_ms = 1e3 * np.diff(self.haptic["time_s"]).max(initial=0.0)
            clauses.append(
                f"{100.0 * self.missed_share:.2g} % of the leader's ticks came late or not at all, with gaps "
                f"of up to {gap_ms:.3g} ms"
            )
        if self.slipped_share > _TOO_SLOW:
            share = f"{100.0 * self.slipped_share:.2g} %"
            clauses.append(f"the follower's clock ran {share} slower than the leader's")
        return clauses

    def to_leader(self, follower_s: FloatArray) -> FloatArray:
        """Convert times of the follower's clock to the leader's, shape (n,) [s]; clocks may drift.

        Args:
            follower_s: times of the follower's clock, shape (n,) [s].
        """
        time_s, offset_s, _ = self.exchanges.T
        theirs_s = np.maximum.accumulate(time_s + offset_s)
        return np.asarray(follower_s - np.interp(follower_s, theirs_s, offset_s))

    def rendered_models(self) -> list[tuple[Event, Mapping[str, Any]]]:
        """Return the events of the rendered models, with their data."""
        return [(event, event.data or {}) for event in self.leader.events if event.kind == FEEL]

    def verdicts(self) -> dict[int, str]:
        """Return the newest verdict of each estimated target, by number."""
        made = [event.data or {} for event in self.follower.events if event.kind == ESTIMATE]
        return {short_number(data["target"]): data["verdict"] for data in made}

    def compare_rendered_to_real(self, real: Scenario) -> ForceComparison:
        """Compare forces felt after the first estimate with the real object's response to the same motion.

        Touches during the arrival of the first estimate are left out, because the force then changes
        gradually.

        Args:
            real: the follower's world.
        """
        haptic = self.haptic
        law = force_law(terms_of(real))
        depth_m = real.object.surface_height_m - haptic["tip_position_world_m"][:, 2]
        rate_m_s, step_s = -haptic["tip_velocity_world_m_s"][:, 2], np.diff(haptic["time_s"], prepend=np.nan)
        step_s[:1] = 1e-3
        real_n = _law_forces(law, depth_m, rate_m_s, step_s)
        touching = haptic["force_n"] > 0.0
        # Start of each touch, and number of the newest touch, 0 before the first.
        begins = touching & ~np.concatenate([[False], touching[:-1]])
        number = np.cumsum(begins)
        has_estimate = np.concatenate([[False], (haptic["revision"] != GUESS)[begins]])
        counted = touching & has_estimate[number] & (real_n > _LEAST_N)
        # Touches that began less than `TOUCH_S` before a missed tick.
        missed = haptic["lateness_s"] > np.median(step_s)
        first = np.convolve(begins, np.ones(round(TOUCH_S / _TICK_S)))[: len(begins)] > 0.0
        late = np.zeros(number[-1] + 1, bool)
        late[number[first & missed]] = True
        forces = ForceComparison(haptic["time_s"], haptic["force_n"], real_n, touching & late[number])
        return forces.select(counted)

    def compare_modeled_to_measured(self) -> ForceComparison:
        """Compare each target's newest model with the measured forces, on the follower's presses."""
        ticks, parts = self.ticks, [(np.zeros(0),) * 3]
        newest = {data["target"]: data for _, data in self.rendered_models()}
        pressed = np.isin(ticks["phase"], IN_CONTACT) & (ticks["run"] >= 0)
        events = ((event.time_s, event.data) for event in self.follower.events if event.kind == "target")
        begun = [(time_s, data["target"]) for time_s, data in events if data and "state" not in data]
        # Number of the probed target; -1 before the first.
        targets = np.full(len(ticks), -1.0)
        if begun:
            starts_s, numbers = np.array(begun).T
            places = np.searchsorted(starts_s, ticks["time_s"], side="right") - 1
            targets = np.where(places >= 0, numbers[np.maximum(places, 0)], -1.0)
        air_n = float(np.mean(ticks["force_n"][ticks["phase"] == Phase.FREE_AIR]))
        for target, data in newest.items():
            law, rows = force_law(terms_in(data)), np.flatnonzero(targets == target)
            direction, tip = ticks["press_direction_world"][rows], ticks["tip_position_world_m"][rows]
            depth_m = np.einsum("ij,ij->i", tip - np.array(data["surface_world_m"]), direction)
            rate_m_s = np.einsum("ij,ij->i", ticks["tip_velocity_world_m_s"][rows], direction)
            step_s = np.diff(ticks["time_s"][rows], prepend=ticks["time_s"][rows[:1]] - 1e-3)
            modeled_n = _law_forces(law, depth_m, rate_m_s, step_s)
            kept = pressed[rows] & (depth_m > 0.0)
            measured_n = ticks["force_n"][rows] - air_n
            parts.append((ticks["time_s"][rows][kept], modeled_n[kept], measured_n[kept]))
        time_s, modeled_n, measured_n = (np.concatenate(column) for column in zip(*parts, strict=True))
        return ForceComparison(self.to_leader(time_s), modeled_n, measured_n, np.zeros(len(time_s), bool))


def _law_forces(law: ForceLaw, depth_m: FloatArray, rate_m_s: FloatArray, step_s: FloatArray) -> FloatArray:
    """Return the forces of a law along a motion, shape (n,) [N]."""
    return np.array([law(*state) for state in np.column_stack([depth_m, rate_m_s, step_s]).tolist()])


def merge_sessions(first: Session, second: Session) -> MergedSessions:
    """Merge both sessions, in either order; raise `InputError` unless they are a leader's and a follower's.

    Args:
        first: session of leader or follower.
        second: session of the other side.
    """
    for leader, follower in ((first, second), (second, first)):
        if HAPTIC in leader.stream_names and {TICK, LINK} <= set(follower.stream_names):
            return MergedSessions(leader, follower)
    raise InputError(f"{first.path} and {second.path}: give the sessions of a leader and of its follower")
