"""Counts how often the diagnosis of a made-up session was right, and prints it."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from synthetic.grid import CONTAINED_IN, Outcome
from synthetic.scene import FLOOR

from estimation.diagnosis import ChannelDiagnosis, Verdict

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


def covered(outcome: Outcome, *, accepted: bool) -> list[bool]:
    """Whether each 95 % interval with a known truth holds it, where just the hidden effects were found."""
    if outcome.found.final is None or {e.effect for e in outcome.found.accepted} != set(
        outcome.job.scene.hidden
    ):
        return []
    fitted = outcome.found.final.parameters
    return [
        abs(fitted[name].value - true) < 1.96 * (fitted[name].std_err or np.inf)
        for name, true in outcome.truth.items()
        if name in fitted and (name.split(".")[0] in outcome.job.scene.hidden) == accepted
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
    for whose, accepted in (("base parameters", False), ("accepted effects", True)):
        intervals = share([hit for outcome in outcomes for hit in covered(outcome, accepted=accepted)])
        print(f"95 % intervals of {whose} hold the truth: {intervals}")
    report_ways(parts)
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


def report_ways(parts: Mapping[str, Sequence[Outcome]]) -> None:
    """Sessions that came about or were read otherwise, in the same words as the usual ones."""
    for part, outcomes in parts.items():
        if part.startswith("nothing, "):
            alarms = share([bool(o.found.accepted) for o in outcomes])
            adequate = share([o.found.verdict is Verdict.ADEQUATE for o in outcomes])
            print(f"{part}: false alarms {alarms}, adequate {adequate}")
        if part.startswith("one, "):
            verdict = share([o.found.verdict is Verdict.MISSING and is_first(o) for o in outcomes])
            print(f"{part}: first or in its group {share([is_first(o) for o in outcomes])}")
            print(f"  verdict missing with it first {verdict}")


def report_floors(outcomes: Sequence[Outcome]) -> None:
    """How near the final error of a solved scene is to what the true law leaves, and to the noise put in."""
    solved = [o for o in outcomes if [e.effect for e in o.found.accepted] == list(o.job.scene.hidden)]
    smooth = [o for o in solved if o.found.final and "quantisation" not in o.job.scene.hidden]
    for title, floor in (
        ("what the true law leaves", lambda o: o.floor),
        ("the usual noise", lambda o: FLOOR[o.job.scene.kind]),
    ):
        near = [o.found.final.rmse / floor(o) < 1.05 for o in smooth if o.found.final is not None]
        print(f"final error within 5 % of {title}: {share(near)}")


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
    return (
        f"{outcome.job.part} | {hidden}, seed {scene.seed}, AR(1) {scene.correlation:g} | "
        f"{found.verdict.value} | named {named} | depends on {', '.join(found.depends_on) or 'nothing told'}"
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
