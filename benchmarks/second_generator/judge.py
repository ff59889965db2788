"""Judge whether diagnoses are right, and make tables of the results."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from palpate.estimation.diagnosis import ChannelDiagnosis, diagnose
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.effects import EFFECTS

from .cases import CaseSpec, GeneratedCase, make

NAMES: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("names.yaml").read_text("utf-8"))
QUANTILE_95 = 1.96


@dataclass(frozen=True)
class Interval:
    """A parameter's estimate and true value; `holds` is None if the data did not determine it."""

    name: str
    value: float
    std_err: float | None
    truth: float
    accepted: bool  # of an accepted effect, not of the simple model

    @property
    def holds(self) -> bool | None:
        """Whether the 95 % interval contains the true value."""
        if self.std_err is None or not math.isfinite(self.std_err):
            return None
        return abs(self.value - self.truth) <= QUANTILE_95 * self.std_err


@dataclass(frozen=True)
class CaseOutcome:
    """A diagnosed case; `seconds` is processor time, because machines are busy."""

    job: CaseSpec
    seed: int
    strength: float
    world: str
    samples: int
    floor: float
    verdict: str
    reason: str
    accepted: list[str]
    remaining_times_floor: float | None
    right: bool
    first: bool
    exact: bool
    seconds: float
    intervals: list[Interval] = field(default_factory=list)
    exact_forms: list[str] = field(default_factory=list)  # accepted effects whose form is stated as exact
    kind_right: bool | None = None  # whether the budget's largest kind is a hidden effect's; None without one
    kind_stated: bool | None = None  # the same, or such a kind is stated to explain as much in its place

    def line(self) -> str:
        """Return one readable line."""
        asked = " + ".join(self.job.hidden) or "nothing"
        named = " + ".join(self.accepted) or "-"
        ratio = "" if self.remaining_times_floor is None else f" {self.remaining_times_floor:.2f} x floor"
        return (
            f"{'right' if self.right else 'WRONG'} {self.job.number:3d} {self.job.kind:8s} "
            f"{asked} ({self.job.sort}, {self.strength:.0f}) -> {self.verdict}: {named}{ratio} "
            f"[{self.world}; {self.samples} samples, {self.seconds:.1f} s]"
        )


def run(job: CaseSpec, seed: int) -> CaseOutcome | None:
    """Make a case and diagnose it; None if it cannot be made.

    For a case of the sort "removed", the library lacks the hidden effect and every law that contains it.
    """
    case = make(job, seed)
    if case is None:
        return None
    started = time.process_time()
    rng = np.random.default_rng([seed, job.number, 7])
    removed = withheld_effects(job) if job.sort == "removed" else frozenset()
    effects = [effect for effect in effect_library() if effect.name not in removed]
    diagnosis = diagnose(case.channel, case.model, effects, rng=rng, file=f"case {job.number}").channels[0]
    return evaluate_case(case, seed, diagnosis, time.process_time() - started)


def _names(job: CaseSpec) -> list[str]:
    """Return the hidden effects by the library's names."""
    return [NAMES["spelled"].get(name, name) for name in job.hidden]


def withheld_effects(job: CaseSpec) -> frozenset[str]:
    """Return the names of the hidden effects and of every law that contains one of them."""
    plain = frozenset(_names(job))
    return plain.union(*(NAMES["contained_in"].get(name, ()) for name in plain))


def evaluate_case(case: GeneratedCase, seed: int, diagnosis: ChannelDiagnosis, seconds: float) -> CaseOutcome:
    """Compare a diagnosis with the truth."""
    job = case.job
    names, right_sets = [entry.effect for entry in diagnosis.accepted], _right_sets(job)
    group = [names[0], *diagnosis.accepted[0].confused_with] if names else []
    first = bool(set(group) & frozenset().union(*right_sets))
    verdict = diagnosis.verdict.value
    right = {
        "nothing": verdict == "adequate",
        "outside": verdict == "unexplained" or (verdict == "missing" and first),
        "removed": verdict == "unexplained",
    }.get(job.sort, verdict == "missing" and first)
    return CaseOutcome(
        job=job,
        seed=seed,
        strength=case.strength,
        world=case.world,
        samples=len(case.channel),
        floor=case.floor,
        verdict=verdict,
        reason=diagnosis.reason,
        accepted=names,
        remaining_times_floor=diagnosis.remaining.times_floor if diagnosis.remaining else None,
        right=right,
        first=first,
        exact=set(names) in right_sets,
        seconds=seconds,
        intervals=_intervals(case, diagnosis) if job.sort not in ("outside", "removed") else [],
        exact_forms=[entry.effect for entry in diagnosis.accepted if entry.form == "exact"],
        kind_right=_is_kind_right(job, diagnosis, with_replacing=False),
        kind_stated=_is_kind_right(job, diagnosis, with_replacing=True),
    )


def _is_kind_right(job: CaseSpec, diagnosis: ChannelDiagnosis, *, with_replacing: bool) -> bool | None:
    """Return whether the budget's largest kind, or one that may replace it, is that of a hidden effect."""
    hidden = [EFFECTS[name] for name in _names(job) if name in EFFECTS]
    if not hidden:
        return None
    kinds = frozenset().union(*({effect.kind} | effect.also for effect in hidden))
    if not diagnosis.budget:
        return False
    largest = diagnosis.budget[0]
    return not kinds.isdisjoint({largest.kind, *largest.replaceable_by * with_replacing})


def _right_sets(job: CaseSpec) -> list[frozenset[str]]:
    """Return all sets of names that describe the hidden effects."""
    if job.sort == "outside":
        named = job.hidden[0] in NAMES["named_by_a_wider_library"]
        return [frozenset({"position_dependent_friction"} if named else ())]
    sets = [frozenset[str]()]
    for name in _names(job):
        ways = [[name], *NAMES["same_curve"].get(name, ())]
        sets = [names.union(way) for names in sets for way in ways]
    return sets


def _intervals(case: GeneratedCase, diagnosis: ChannelDiagnosis) -> list[Interval]:
    """List estimates with known truth: of right effects, and of the base model if all effects are named."""
    named = {entry.effect for entry in diagnosis.accepted}
    spelled = set(_names(case.job))
    there = {
        f"{entry.effect}.{name}": p for entry in diagnosis.accepted for name, p in entry.parameters.items()
    }
    whole = diagnosis.final.parameters if diagnosis.final and named == spelled else {}
    both = {name: (p, True) for name, p in there.items() if name.split(".")[0] in spelled}
    both |= {name: (p, False) for name, p in whole.items() if name.split(".")[0] not in named}
    return [
        Interval(name, p.value, p.std_err, case.truth[name], accepted)
        for name, (p, accepted) in both.items()
        if name in case.truth
    ]


HIDDEN = ("one", "two")
# Rows of the table: the sorts of cases in the row, and the condition for counting a case.
ROWS: dict[str, tuple[Sequence[str], Callable[[CaseOutcome], bool]]] = {
    "verdict right": (("nothing", "one", "two", "outside", "removed"), lambda o: o.right),
    "  nothing hidden": (("nothing",), lambda o: o.right),
    "  one effect": (("one",), lambda o: o.right),
    "  two effects": (("two",), lambda o: o.right),
    "  outside the vocabulary": (("outside",), lambda o: o.right),
    "  removed from the library": (("removed",), lambda o: o.right),
    "first effect right": (HIDDEN, lambda o: o.first),
    "exact set": (HIDDEN, lambda o: o.exact),
    "nothing hidden: unexplained": (("nothing",), lambda o: o.verdict == "unexplained"),
    "nothing hidden: named": (("nothing",), lambda o: o.verdict == "missing"),
    "outside: wrong name": (("outside",), lambda o: o.verdict == "missing" and not o.first),
    "outside: unexplained": (("outside",), lambda o: o.verdict == "unexplained"),
    "removed: wrong name": (("removed",), lambda o: o.verdict == "missing"),
    "removed: wrong name, form exact": (("removed",), lambda o: bool(o.exact_forms)),
    "removed: kind right": (("removed",), lambda o: o.kind_right is True),
    "removed: kind right or possible": (("removed",), lambda o: o.kind_stated is True),
}


def table(outcomes: Sequence[CaseOutcome]) -> str:
    """Return a table of the results for contacts, joints and both."""
    kinds = sorted({o.job.kind for o in outcomes})  # contacts first
    columns = {kind: [o for o in outcomes if o.job.kind == kind] for kind in kinds} | {"all": list(outcomes)}
    lines = {"": list(columns)}
    for what, (sorts, is_so) in ROWS.items():
        counted = [[o for o in some if o.job.sort in sorts] for some in columns.values()]
        lines[what] = [f"{sum(map(is_so, some))} of {len(some)}" for some in counted]
    for what, accepted in (("accepted", True), ("the simple model", False)):
        lines[f"intervals of {what} hold"] = [_held(some, accepted) for some in columns.values()]
    return "\n".join(f"{what:36s}" + "".join(f"{cell:>16s}" for cell in row) for what, row in lines.items())


def _held(some: Sequence[CaseOutcome], accepted: bool) -> str:
    flags = [i.holds for o in some for i in o.intervals if i.accepted == accepted and i.holds is not None]
    return f"{100 * np.mean(flags):.0f} % of {len(flags)}" if flags else "-"
