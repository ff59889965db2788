"""Probe and diagnose again, each time by the most informative plan, until one explanation is left."""

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from palpate.common.console import count, json_text
from palpate.common.files import output_folder, write_text
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.design.next_experiment import LONGEST_S, NextProbe
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.study.fitting import Progress
from palpate.estimation.study.other_models import is_undecided
from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.robot_io.errors import InputError
from palpate.runs.probing import NO_WATCHER, ProbingJob, Watcher, run_probing
from palpate.study import Study

DECISIONS = "decisions.jsonl"
Design = Callable[[Study, Sequence[ChannelDiagnosis], float, Progress], NextProbe | None]
Watch = Callable[[ProbingPlan], AbstractContextManager[Watcher]]
Work = Callable[[Sequence[str]], AbstractContextManager[Progress]]


class StopReason(StrEnum):
    """Reason why no further probe is run; see `_ENDS`."""

    SEPARATED = "separated"
    SIMPLEST = "simplest"
    UNSEEN = "unseen"
    UNEXPLAINED = "unexplained"
    INSEPARABLE = "inseparable"
    PROBES = "probes"
    SECONDS = "seconds"
    INSUFFICIENT = "insufficient"


_ENDS = {
    StopReason.SEPARATED: "one explanation is left",
    StopReason.SIMPLEST: (
        "the simplest explanation is kept, because the others contain it and no further experiment is "
        "expected to separate them"
    ),
    StopReason.UNSEEN: "an effect seen in an earlier probe is not significant in the data of all probes",
    StopReason.UNEXPLAINED: (
        "no effect of the library explains the remaining error, and no experiment of this arm is expected to "
        "help"
    ),
    StopReason.INSEPARABLE: "no experiment of this arm is expected to separate the remaining explanations",
    StopReason.PROBES: "the budget of probes is used up",
    StopReason.SECONDS: (
        "the experiment that would separate the explanations takes longer than the remaining time"
    ),
    StopReason.INSUFFICIENT: "the data allow no verdict",
}


@dataclass(frozen=True)
class ProbeDecision:
    """Result of one probe, and what follows."""

    probe: int  # its number, from 1
    session: str  # its file, in the folder of the log
    seconds: float  # that it took on the robot's clock
    # Groups of indistinguishable effects, by channel.
    left: dict[str, list[list[str]]]
    end: StopReason | None  # why it was the last; None if another follows
    next: str  # description of the next step; empty after the last
    sentence: str  # all this in one sentence


@dataclass(frozen=True)
class ResolveResult:
    """Result of the whole sequence."""

    folder: Path  # with the sessions, and what is derived from them
    decisions: tuple[ProbeDecision, ...]  # one for each probe
    channels: tuple[ChannelDiagnosis, ...]  # the last diagnosis

    @property
    def end(self) -> StopReason | None:
        """Reason for the end."""
        return self.decisions[-1].end

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data; the keys are stable."""
        return {
            "folder": str(self.folder),
            "end": self.end,
            "probes": len(self.decisions),
            "seconds": sum(decision.seconds for decision in self.decisions),
            "decisions": [asdict(decision) for decision in self.decisions],
            "channels": [channel.model_dump(mode="json") for channel in self.channels],
        }


def resolve(  # noqa: PLR0917
    job: ProbingJob,
    probes: int,
    seconds: float,
    channel: str | None = None,
    on_decision: Callable[[ProbeDecision], None] = lambda decision: None,
    watch: Watch = lambda plan: nullcontext(NO_WATCHER),
    work: Work = lambda channels: nullcontext(lambda what, share: None),
    design: Design = Study.next_probe,
) -> ResolveResult:
    """Run a first probe and the most informative further probes; report and log each decision.

    Args:
        job: the first probe; the folder of its session is the study's, and holds no session yet.
        probes: maximum number of probes, including the first.
        seconds: maximum time of all probes, on the robot's clock [s].
        channel: the channel to explain; None for all.
        on_decision: called with each decision.
        watch: observes the run of a plan.
        work: shows the progress of the computation for these channels.
        design: chooses the next probe from the study, its diagnosis, and the time that it may take [s].

    Raises:
        InputError: the folder already holds sessions, or the job cannot be run.
        PalpateError: the arm was stopped, or a run gave no data; all sessions so far are kept.
        KeyboardInterrupt: the user stopped it; as above.
    """
    folder = job.session.parent
    if any(folder.glob("*.mcap")):
        raise InputError(f"{folder}: already holds sessions; name a new folder, which palpate creates")
    output_folder(folder)
    decisions: list[ProbeDecision] = []
    shown: set[str] = set()  # channels in which something was missing so far
    while True:
        number = len(decisions)
        ran = replace(job, session=folder / f"probe-{number + 1:02d}.mcap", again=number)
        with watch(ran.plan) as watcher:
            outcome = run_probing(ran, watcher)
        outcome.raise_for_failure()
        study = Study(folder)
        used_s = sum(decision.seconds for decision in decisions) + outcome.loop.duration_s
        with work([item.name for item in study.chosen(channel)]) as progress:
            diagnosis = study.diagnose(channel, plan=False, progress=progress)
            judged = diagnosis.channels
            is_last, left_s = number + 1 >= probes, seconds - used_s
            end, following = _decide(study, judged, left_s, progress, design, is_last=is_last)
            if end is StopReason.SEPARATED and any(
                item.verdict is Verdict.ADEQUATE and item.channel in shown for item in judged
            ):
                end = StopReason.UNSEEN
            shown |= {
                item.channel for item in judged if item.verdict in {Verdict.MISSING, Verdict.UNEXPLAINED}
            }
            judged = study.settle(judged, following)
            if end is StopReason.INSEPARABLE and not any(is_undecided(item) for item in judged):
                end = StopReason.SIMPLEST
            diagnosis = diagnosis.model_copy(update={"channels": judged})
        write_text(output_folder(folder / "study") / RESULT, json_text(study.diagnosis_data(diagnosis)))
        explanations = []
        for item in judged:
            if item.verdict is Verdict.INSUFFICIENT:
                explanations.append(f"{item.channel} cannot be judged ({item.reason})")
            elif item.verdict is not Verdict.ADEQUATE:
                names = " and ".join(" or ".join([e.effect, *e.confused_with]) for e in item.accepted)
                signals = ", ".join(item.depends_on) or "no signal"
                rest = "" if item.complete else f"something that depends on {signals}"
                explanations.append(f"{item.channel} shows {' and '.join(filter(None, (names, rest)))}")
        what = "; ".join(explanations) or "nothing is missing"
        then = _ENDS[end or StopReason.SEPARATED]
        if end is None and following is not None:
            then = f"next, to {following.proposal.purpose}: {following.reason}"
        decision = ProbeDecision(
            probe=number + 1,
            session=ran.session.name,
            seconds=outcome.loop.duration_s,
            left={
                item.channel: [[e.effect, *e.confused_with] for e in item.accepted]
                for item in judged
                if item.accepted
            },
            end=end,
            next=following.proposal.instruction if end is None and following else "",
            sentence=f"after {count(number + 1, 'probe')}: {what}; {then}",
        )
        decisions.append(decision)
        with (folder / DECISIONS).open("a", encoding="utf-8") as log:
            log.write(json.dumps(asdict(decision)) + "\n")
        on_decision(decision)
        if end is not None or following is None:
            return ResolveResult(folder, tuple(decisions), tuple(judged))
        job = replace(job, plan=following.plan)


def _decide(
    study: Study,
    diagnoses: Sequence[ChannelDiagnosis],
    left_s: float,
    progress: Progress,
    design: Design,
    *,
    is_last: bool,
) -> tuple[StopReason | None, NextProbe | None]:
    undecided = [diagnosis for diagnosis in diagnoses if is_undecided(diagnosis)]
    refused = any(diagnosis.verdict is Verdict.INSUFFICIENT for diagnosis in diagnoses)
    if not undecided and not refused:
        return StopReason.SEPARATED, None
    if not undecided and is_last:
        return StopReason.INSUFFICIENT, None
    following = design(study, diagnoses, min(left_s, LONGEST_S), progress)
    if following is not None:
        return (StopReason.PROBES if is_last else None), following
    if not undecided:
        return StopReason.INSUFFICIENT, None
    following = design(study, diagnoses, LONGEST_S, progress) if left_s < LONGEST_S else None
    if following is not None:
        return StopReason.SECONDS, following
    is_named = any(diagnosis.accepted for diagnosis in undecided)
    return (StopReason.INSEPARABLE if is_named else StopReason.UNEXPLAINED), None
