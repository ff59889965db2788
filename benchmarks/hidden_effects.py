"""Hides effects in made-up sessions and counts how often the diagnosis is right.

    python benchmarks/hidden_effects.py [--quick | --small] [--kind contact|revolute] [--seed 0]
    python benchmarks/hidden_effects.py --simulated [--quick] [--seed 0]

Two processes by default (--processes).

The sessions come from `synthetic/`, which shares no code with the effects that find them. Strength is the RMS
of what the base model cannot mimic over the noise; cells that an effect cannot reach are left out. With
`--simulated` they are probing runs of the simulated arm, with the simulator's own hidden effects.
"""

import argparse
import multiprocessing
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from simulated.probing import drawable, probe
from synthetic.scene import FLOOR, Scene, make, names
from threadpoolctl import threadpool_limits

from estimation.base_model import ModelContext
from estimation.channel import ChannelKind
from estimation.diagnosis import ChannelDiagnosis, Verdict, diagnose
from estimation.diagnosis.search.library import library
from estimation.models import MODELS

BASE = {ChannelKind.CONTACT: "kelvin_voigt", ChannelKind.REVOLUTE: "pendulum"}
# Signals that a hidden effect depends on, by any of which the remaining error may be told.
SIGNALS = {
    "bias": {"offset", "effort"},
    "drift": {"time"},
    "coulomb_friction": {"direction"},
    "stribeck_friction": {"direction", "velocity"},
    "asymmetric_friction": {"direction", "velocity"},
    "load_dependent_friction": {"direction", "load", "effort"},
    "quadratic_friction": {"velocity"},
    "quadratic_damping": {"velocity", "effort", "direction"},
    "dry_friction": {"direction", "past motion", "velocity"},
    "stress_relaxation": {"past motion"},
    "plastic_set": {"past motion", "position"},
    "hysteresis": {"effort", "past motion"},
    "lag": {"effort", "past motion"},
    "delay": {"effort", "past motion"},
    "saturation": {"effort", "direction"},
    "deadband": {"effort", "position"},
    "quantisation": {"effort", "position"},
    "backlash": {"past motion", "direction"},
    "joint_elasticity": {"acceleration", "effort", "past motion"},
    "hunt_crossley": {"velocity", "position", "effort"},
    "adhesion": {"past motion", "direction", "position"},
    "contact_offset": {"position", "effort", "velocity"},
    "tool_compliance": {"effort", "past motion"},
}

# Laws of the library that contain a hidden one, exactly and at any motion, beside the base models used here.
# This is by what their equations say, whatever comes out: where only the hidden law is removed, these can
# still draw it. What comes near only where a damper or the range of motion is small is not listed.
CONTAINED_IN: dict[str, dict[str, str]] = {
    "bias": {
        "drift": "a drift of no rate is its offset",
        "joint_spring": "a spring of no stiffness is its preload",
    },
    "coulomb_friction": {
        "stribeck_friction": "a Stribeck law of no rise is its level",
        "asymmetric_friction": "of one force and slope both ways it is Coulomb and viscous friction",
    },
    "cubic_stiffness": {"hunt_crossley": "a power law of exponent 3 without a damper is a cubic spring"},
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


def run(job: Job) -> Outcome | None:
    """Make the session and diagnose it; None where the effect cannot be made that strong."""
    made = make(job.scene)
    if made is None:
        return None
    started = time.process_time()
    model = MODELS[BASE[job.scene.kind]]().build(ModelContext())
    effects = [effect for effect in library() if effect.name not in job.without]
    found = diagnose(made.data, model, effects, rng=np.random.default_rng(job.scene.seed)).channels[0]
    return Outcome(job, found, time.process_time() - started, made.truth)


@dataclass(frozen=True)
class Size:
    """How much of the grid is run.

    Attributes:
        nothing: sessions with nothing hidden, of each colour.
        seeds: sessions of each effect and strength.
        strengths: of single effects, times the floor.
        removed: of effects that are taken out of the library.
        pairs: sessions with two effects.
    """

    nothing: int
    seeds: int
    strengths: tuple[float, ...]
    removed: tuple[float, ...]
    pairs: int


ALL = (3.0, 10.0, 30.0)
QUICK, FULL = Size(4, 1, (10.0,), (10.0,), 4), Size(70, 4, ALL, ALL, 60)
SMALL = {
    ChannelKind.CONTACT: Size(5, 1, ALL, (10.0,), 14),
    ChannelKind.REVOLUTE: Size(2, 1, (10.0,), (10.0,), 10),
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


def stated(found: ChannelDiagnosis) -> list[set[str]]:
    """Each accepted effect with those it is said to be confused with."""
    return [{entry.effect, *entry.confused_with} for entry in found.accepted]


def is_first(outcome: Outcome) -> bool:
    """Whether the one hidden effect leads the ranking or is in the first group stated."""
    (hidden,) = outcome.job.scene.hidden
    ranking, groups = outcome.found.ranking, stated(outcome.found)
    return bool(ranking and ranking[0].effect == hidden) or bool(groups and hidden in groups[0])


def share(hits: Sequence[bool]) -> str:
    """Hits of all, and percent."""
    return f"{sum(hits)}/{len(hits)} = {100.0 * float(np.mean(hits)):.1f} %" if hits else "none"


def covered(outcome: Outcome) -> list[bool]:
    """Whether each base parameter's 95 % interval holds the truth, where all hidden effects were found."""
    if outcome.found.final is None or {e.effect for e in outcome.found.accepted} != set(
        outcome.job.scene.hidden
    ):
        return []
    fitted = outcome.found.final.parameters
    return [
        abs(fitted[name].value - true) < 1.96 * (fitted[name].std_err or np.inf)
        for name, true in outcome.truth.items()
    ]


def report(outcomes: Sequence[Outcome]) -> None:
    """Print all figures."""
    parts: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        parts[outcome.job.part].append(outcome)
    report_nothing(parts["none"])
    report_one(parts["one"])
    pairs = [all(any(h in g for g in stated(o.found)) for h in o.job.scene.hidden) for o in parts["pair"]]
    print(f"two at once: both found {share(pairs)}")
    removal("removed alone", parts["removed"])
    plain = [o for o in parts["removed"] if next(iter(o.job.scene.hidden)) not in CONTAINED_IN]
    removal("removed with every law that contains it", [*plain, *parts["removed with all"]])
    report_floors(parts["one"])
    intervals = share([hit for outcome in outcomes for hit in covered(outcome)])
    print(f"95 % intervals of base parameters hold the truth: {intervals}")
    seconds = [o.seconds for o in outcomes]
    print(f"processor time: median {np.median(seconds):.1f} s, worst {max(seconds):.1f} s")
    confusion(parts["one"], "hidden -> accepted")
    confusion([o for o in parts["removed"] if o.found.accepted], "removed -> wrongly accepted")
    print("missed")
    for outcome in outcomes:
        if not is_right(outcome):
            print("  " + described(outcome))


def report_nothing(outcomes: Sequence[Outcome]) -> None:
    """False alarms by the colour of the noise."""
    for colour in (0.0, 0.9, 0.97):
        found = [o.found for o in outcomes if o.job.scene.correlation == colour]
        alarms = [bool(one.accepted) for one in found]
        adequate = [one.verdict is Verdict.ADEQUATE for one in found]
        print(f"nothing hidden, AR(1) {colour}: false alarms {share(alarms)}, adequate {share(adequate)}")


def report_one(outcomes: Sequence[Outcome]) -> None:
    """Single effects by their strength."""
    for strength in (3.0, 10.0, 30.0):
        chosen = [o for o in outcomes if strength in o.job.scene.hidden.values()]
        leading = share([is_first(o) for o in chosen])
        print(f"one at {strength:g} times the floor: first or in its group {leading}")
        exact = [
            stated(o.found) != [] and all(g & set(o.job.scene.hidden) for g in stated(o.found))
            for o in chosen
        ]
        print(f"  accepted, and nothing beside it: {share(exact)}")


def report_floors(outcomes: Sequence[Outcome]) -> None:
    """How near the final error of a solved scene is to the noise that was put in."""
    solved = [o for o in outcomes if [e.effect for e in o.found.accepted] == list(o.job.scene.hidden)]
    floors = [
        o.found.final.rmse / FLOOR[o.job.scene.kind] < 1.05
        for o in solved
        if o.found.final is not None and "quantisation" not in o.job.scene.hidden
    ]
    print(f"final error within 5 % of the true floor: {share(floors)}")


def removal(title: str, outcomes: Sequence[Outcome]) -> None:
    """Print how often effects that are not in the library were told as such."""
    named = [bool(o.found.accepted) for o in outcomes]
    print(f"not in the library, {title}: a wrong name accepted {share(named)}")
    unexplained = [o for o in outcomes if o.found.verdict is Verdict.UNEXPLAINED]
    print(f"  verdict unexplained {share([o.found.verdict is Verdict.UNEXPLAINED for o in outcomes])}")
    print(f"  of these, right signals {share([has_right_signals(o) for o in unexplained])}")


def has_right_signals(outcome: Outcome) -> bool:
    """Whether one of the signals that the hidden effect depends on is told."""
    hidden = next(iter(outcome.job.scene.hidden))
    return bool(set(outcome.found.depends_on) & SIGNALS.get(hidden, {"position"}))


def is_right(outcome: Outcome) -> bool:
    """Whether the answer is the one wanted, in all that is asked of it."""
    hidden, found = outcome.job.scene.hidden, outcome.found
    if not hidden:
        return found.verdict is Verdict.ADEQUATE
    if outcome.job.without:
        told = found.verdict is Verdict.UNEXPLAINED and has_right_signals(outcome)
        return told and not found.accepted
    groups = stated(found)
    return all(any(h in g for g in groups) for h in hidden) and all(g & set(hidden) for g in groups)


def described(outcome: Outcome) -> str:
    """A scene and what was said of it, in one line."""
    scene, found = outcome.job.scene, outcome.found
    hidden = ", ".join(f"{name} x{strength:g}" for name, strength in scene.hidden.items()) or "nothing"
    named = " + ".join(e.effect for e in found.accepted) or "none"
    suspects = ", ".join(s.effect for s in found.suspects) or "none"
    return (
        f"{outcome.job.part} | {hidden}, seed {scene.seed}, AR(1) {scene.correlation:g} | "
        f"{found.verdict.value} | named {named} | suspects {suspects} | "
        f"depends on {', '.join(found.depends_on) or 'nothing told'}"
    )


def confusion(outcomes: Sequence[Outcome], title: str) -> None:
    """Print what was taken for what."""
    taken: dict[str, Counter[str]] = defaultdict(Counter)
    for outcome in outcomes:
        names_found = (
            " + ".join(sorted(e.effect for e in outcome.found.accepted)) or outcome.found.verdict.value
        )
        taken[next(iter(outcome.job.scene.hidden))][names_found] += 1
    print(title)
    for hidden, counts in taken.items():
        print(f"  {hidden:24s} " + ", ".join(f"{name} {count}" for name, count in counts.most_common()))


def run_simulated(options: argparse.Namespace) -> None:
    """Probe the simulated arm with each effect hidden once, and a few times with nothing."""
    shown = drawable()[::5] if options.quick else drawable()
    hidden = ["" for _ in range(2 if options.quick else 10)] + shown
    with TemporaryDirectory() as folder, _pool(options.processes) as pool:
        tasks = [
            pool.submit(probe, effect, options.seed + number, Path(folder))
            for number, effect in enumerate(hidden)
        ]
        probed = []
        for task in tasks:
            probed.append(task.result())
            one = probed[-1]
            print(
                f"{'right' if one.is_right else 'WRONG'} | {one.hidden or 'nothing'} | {one.told}", flush=True
            )
    print(f"nothing hidden: right {share([one.is_right for one in probed if not one.effect])}")
    print(f"one effect hidden: right {share([one.is_right for one in probed if one.effect])}")


def _pool(processes: int) -> ProcessPoolExecutor:
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, spawn, initializer=threadpool_limits, initargs=(1,))


def main() -> None:
    """Run the grid."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one seed, one strength")
    parser.add_argument("--small", action="store_true", help="one seed, about a quarter of an hour")
    parser.add_argument("--kind", choices=["contact", "revolute"], help="one kind of channel only")
    parser.add_argument("--simulated", action="store_true", help="probing runs of the simulated arm")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.simulated:
        run_simulated(options)
        return
    kinds = [ChannelKind(options.kind)] if options.kind else list(BASE)
    for kind in kinds:
        print(f"\n== {kind.value}, base model {BASE[kind]}", flush=True)
        with _pool(options.processes) as pool:
            size = QUICK if options.quick else SMALL[kind] if options.small else FULL
            grid = jobs(kind, size, options.seed)
            outcomes = [o for o in pool.map(run, grid, chunksize=1) if o is not None]
        report(outcomes)


if __name__ == "__main__":
    main()
