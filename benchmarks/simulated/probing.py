"""Probing runs of the simulated arm in which one effect is hidden, and what the diagnosis says of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from control.probing.plan import ProbingPlan
from estimation.diagnosis import ChannelDiagnosis, diagnose
from estimation.study import Study
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from sim_backend.hidden import draw_hidden, noise_scale
from sim_backend.imperfection import IMPERFECTIONS
from sim_backend.scenario import Scenario


@dataclass(frozen=True)
class Probed:
    """One session."""

    hidden: str  # effect, with its parameters; empty if nothing was hidden
    seed: int  # of all that is random
    found: list[ChannelDiagnosis]  # the answer for each channel

    @property
    def effect(self) -> str:
        """Name of what was hidden, or ""."""
        return self.hidden.split(" ")[0]

    @property
    def groups(self) -> dict[str, list[set[str]]]:
        """Effects accepted in each channel, each with those it is said to be confused with."""
        return {
            entry.channel: [
                {_simulated(name) for name in (a.effect, *a.confused_with)} for a in entry.accepted
            ]
            for entry in self.found
            if entry.accepted
        }

    @property
    def is_right(self) -> bool:
        """Whether the hidden effect was named in one channel at least, and nothing else in any."""
        groups = [group for of_channel in self.groups.values() for group in of_channel]
        return all(self.effect in group for group in groups) and bool(groups) == bool(self.effect)

    @property
    def told(self) -> str:
        """What was said, in short."""
        said = {
            channel: " + ".join("/".join(sorted(g)) for g in of_channel)
            for channel, of_channel in self.groups.items()
        }
        unknown = [entry.channel for entry in self.found if entry.verdict.value == "unexplained"]
        refused = [entry.channel for entry in self.found if entry.verdict.value == "insufficient"]
        rest = [f"unexplained in {', '.join(unknown)}"] if unknown else []
        rest += [f"insufficient in {', '.join(refused)}"] if refused else []
        return "; ".join([*(f"{names} in {channel}" for channel, names in said.items()), *rest]) or "adequate"


def work(parameters: Mapping[str, Any], seed: int) -> list[dict[str, Any]]:
    """As a case of a sweep: what came of one probing with `effect` hidden, as one row."""
    with TemporaryDirectory() as folder:
        found = probe(parameters["effect"], seed, Path(folder))
    return [{"hidden": found.hidden, "told": found.told, "effect": found.effect, "is_right": found.is_right}]


def _simulated(effect: str) -> str:
    """What the simulator calls an effect that was found: a force sensor's dead band shows in the joints."""
    return "deadband" if effect == "force_deadband" else effect


def drawable() -> list[str]:
    """Effects that some channel of a probing run shows."""
    channels = noise_scale(Scenario()).channels
    return [
        name for name in IMPERFECTIONS if any(channel in IMPERFECTIONS[name].shows_in for channel in channels)
    ]


def probe(effect: str, seed: int, folder: Path) -> Probed:
    """Probe with one effect hidden (or none, ""), and diagnose all channels.

    Args:
        effect: what to hide; place and strength are drawn by seed, 5 to 50 times the noise floor.
        seed: of the drawing and of all noise.
        folder: for the session.
    """
    world = Scenario()
    hidden: Sequence = draw_hidden(seed, effect=effect, scenario=world) if effect else []
    path = folder / f"{effect or 'nothing'}-{seed}.mcap"
    scenario = world.with_hidden(list(hidden))
    job = ProbingJob(find_robot(DEFAULT), path, ProbingPlan(), scenario=scenario, seed=seed, online=None)
    run_probing(job)
    channels = Study(path).channels
    rng = np.random.default_rng(seed)
    found = diagnose([one.data for one in channels], [one.model for one in channels], rng=rng).channels
    told = "; ".join(f"{entry.name} {entry.model_dump(exclude={'effect'})}" for entry in hidden)
    return Probed(told, seed, found)
