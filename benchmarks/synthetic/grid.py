"""Which made-up sessions are diagnosed: single effects, pairs, nothing, and what the library lacks."""

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from synthetic.scene import Scene, make, names
from synthetic.ways import WAYS

from estimation.base_model import ModelContext
from estimation.channel import ChannelKind
from estimation.diagnosis import ChannelDiagnosis, diagnose
from estimation.diagnosis.candidates import library
from estimation.models import MODELS
from palpate.sweep import Case

BASE = {ChannelKind.CONTACT: "kelvin_voigt", ChannelKind.REVOLUTE: "pendulum"}
# Laws of the library that contain a hidden one, exactly and at any motion, beside the base models used here.
# This is by what their equations say, whatever comes out: where only the hidden law is removed, these can
# still draw it. What comes near only where a damper or the range of motion is small is not listed.
CONTAINED_IN: dict[str, dict[str, str]] = {
    "bias": {
        "drift": "a drift of no rate is its offset",
        "joint_spring": "a spring of no stiffness is its preload",
        "run_offset": "of one offset in all runs",
    },
    "coulomb_friction": {
        "stribeck_friction": "a Stribeck law of no rise is its level",
        "asymmetric_friction": "of one force and slope both ways it is Coulomb and viscous friction",
        "presliding_friction": "of no presliding distance",
        "bouc_wen_hysteresis": "of no path",
    },
    "dry_friction": {"bouc_wen_hysteresis": "a sharp one is a friction with a presliding distance"},
    "load_dependent_friction": {"load_dependent_presliding": "of no presliding distance"},
    "cubic_stiffness": {
        "hunt_crossley": "a power law of exponent 3 without a damper is a cubic spring",
        "power_law_stiffness": "of exponent 3",
    },
    "stress_relaxation": {"relaxation_spectrum": "with one of its two times"},
    "tool_compliance": {
        "stress_relaxation": "a spring in series with a spring and damper is a standard linear solid"
    },
}
# Two effects that together are one law of the library: no data tells how many they are.
ONE_LAW = (
    {"bias", "drift"},
    {"coulomb_friction", "stribeck_friction"},
    {"coulomb_friction", "asymmetric_friction"},
    {"deadband", "contact_offset"},  # together a wider dead band
)


@dataclass(frozen=True)
class Job:
    """One session to make and diagnose."""

    part: str
    scene: Scene
    without: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came out of a job."""

    job: Job
    found: ChannelDiagnosis
    seconds: float
    truth: dict[str, float]
    floor: float

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> "Outcome":
        """The outcome that `work` put into a row."""
        kept = json.loads(row["outcome"])
        scene = kept["scene"] | {"kind": ChannelKind(kept["scene"]["kind"])}
        job = Job(kept["part"], Scene(**scene), tuple(kept["without"]))
        found = ChannelDiagnosis.model_validate(kept["found"])
        return cls(job, found, row["seconds"], kept["truth"], kept["floor"])

    def record(self) -> str:
        """One line of JSON, by which two engines can be compared."""
        job = _plain(self.job)
        found = self.found.model_dump(mode="json", exclude={"ranking", "next_experiment"})
        rest = {"seconds": self.seconds, "truth": self.truth, "floor": self.floor}
        return json.dumps({"job": job, "found": found} | rest)


def run(job: Job) -> Outcome | None:
    """Make the session and diagnose it; None where the effect cannot be made that strong."""
    made = make(job.scene)
    if made is None:
        return None
    started = time.process_time()
    model = MODELS[BASE[job.scene.kind]]().build(ModelContext())
    effects = [effect for effect in library() if effect.name not in job.without]
    found = diagnose(made.data, model, effects, rng=np.random.default_rng(job.scene.seed)).channels[0]
    return Outcome(job, found, time.process_time() - started, made.truth, made.floor)


def case_of(job: Job) -> Case:
    """The job as a case of a sweep."""
    return Case("synthetic.grid:work", {"job": _plain(job)}, job.scene.seed)


def work(parameters: Mapping[str, Any], seed: int) -> list[dict[str, str]]:
    """One row with the outcome of a job; with an empty one where the effect cannot be made that strong."""
    kept = parameters["job"]
    scene = Scene(**kept["scene"] | {"kind": ChannelKind(kept["scene"]["kind"])})
    outcome = run(Job(kept["part"], scene, tuple(kept["without"])))
    if outcome is None:
        return [{"outcome": ""}]
    found = outcome.found.model_dump(mode="json")
    return [{"outcome": json.dumps(kept | {"found": found, "truth": outcome.truth, "floor": outcome.floor})}]


def _plain(job: Job) -> dict[str, Any]:
    scene = asdict(job.scene) | {"kind": job.scene.kind.value}
    return {"part": job.part, "scene": scene, "without": list(job.without)}


@dataclass(frozen=True)
class Size:
    """How much of the grid is run."""

    nothing: int  # sessions with nothing hidden, of each colour
    seeds: int  # sessions of each effect and strength
    strengths: tuple[float, ...]  # of single effects, times the floor
    removed: tuple[float, ...]  # of effects that are taken out of the library
    pairs: int  # sessions with two effects
    ways: tuple[int, int]  # sessions with nothing and with one effect, of each other way of recording


ALL = (3.0, 10.0, 30.0)
QUICK, FULL = Size(4, 1, (10.0,), (10.0,), 4, (1, 1)), Size(70, 4, ALL, ALL, 60, (20, 20))
SMALL = {
    ChannelKind.CONTACT: Size(5, 1, ALL, (10.0,), 14, (1, 3)),
    ChannelKind.REVOLUTE: Size(2, 1, (10.0,), (10.0,), 10, (1, 3)),
}


def jobs(kind: ChannelKind, size: Size, first: int) -> Iterator[Job]:
    """The grid, from this seed on."""
    for colour in (0.0, 0.9, 0.97):
        for seed in range(size.nothing):
            yield Job("none", Scene(kind, {}, colour, 1000 + first + seed))
    for number, name in enumerate(names(kind)):
        for seed in range(first, first + size.seeds):
            colour = 0.97 if (seed + number) % 2 else 0.0
            for strength in size.strengths:
                yield Job("one", Scene(kind, {name: strength}, colour, seed))
            for strength in size.removed:
                scene = Scene(kind, {name: strength}, 0.0, seed)
                yield Job("removed", scene, (name,))
                if name in CONTAINED_IN:
                    yield Job("removed with all", scene, (name, *CONTAINED_IN[name]))
    for seed in range(2000 + first, 2000 + first + size.pairs):
        pair = np.random.default_rng(seed).choice(names(kind), 2, replace=False)
        if set(pair) not in ONE_LAW:
            yield Job("pair", Scene(kind, {str(name): 10.0 for name in pair}, 0.0, seed))


def other_ways(kind: ChannelKind, size: Size, first: int) -> Iterator[Job]:
    """Sessions that come about and are read otherwise; see `WAYS`."""
    nothing, one = size.ways
    for number, way in enumerate(WAYS[kind]):
        start = 3000 + 100 * number + first
        for seed in range(start, start + nothing):
            yield Job(f"nothing, {way}", Scene(kind, {}, 0.0, seed, way))
        for seed in range(start + 50, start + 50 + one):
            rng = np.random.default_rng(seed)
            hidden = {str(rng.choice(names(kind))): float(rng.choice(ALL))}
            yield Job(f"one, {way}", Scene(kind, hidden, float(rng.choice([0.0, 0.9])), seed, way))
