"""How a channel's model grew: compared with the measurement, diagnosed, refitted stage by stage."""

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from estimation.channel import ChannelKind
from estimation.comparison import Comparison, compare_standing
from estimation.diagnosis import ChannelDiagnosis, Diagnosis
from estimation.diagnosis.apart import Job, Progress, diagnose_apart
from estimation.fit.load import with_load
from estimation.diagnosis.judged import Judged
from estimation.effect import Effect
from estimation.revision import Revision, revision_of, standings
from palpate.findings.kept_diagnosis import KeptDiagnosis
from palpate.findings.subject import Subject, model_names
from robot_io.errors import InputError

SEED = 1  # of the surrogates


@dataclass(frozen=True)
class Story:
    """One channel with all that was found out about it.

    Attributes:
        subject: the channel and its base model.
        diagnosis: what is missing; None where nobody asked.
        comparison: the base model beside the measurement; None where the data cannot be judged.
        stages: the base model, and one stage for each effect added; empty where the data cannot be judged.
        grown: the last stage beside the measurement; None where nothing was added.
        left_out: why what was added is not told, in a sentence; empty where it is.
    """

    subject: Subject
    diagnosis: ChannelDiagnosis | None
    comparison: Comparison | None
    stages: tuple[Revision, ...]
    grown: Comparison | None = None
    left_out: str = ""

    @property
    def added(self) -> list[str]:
        """Effects that were added to the base model, in order."""
        return [stage.added for stage in self.stages[1:]]

    @property
    def adds_what_was_found(self) -> bool:
        """Whether what was added is what the diagnosis named, and nothing else."""
        found = self.diagnosis.accepted if self.diagnosis is not None else []
        return self.added == [entry.effect for entry in found]


def diagnose_subjects(
    subjects: Sequence[Subject], effects: Iterable[Effect], progress: Progress, file: str
) -> Diagnosis:
    """What is missing in each; see `judge_subjects`."""
    return diagnosis_of(judge_subjects(subjects, effects, progress), file)


def judge_subjects(
    subjects: Sequence[Subject], effects: Iterable[Effect], progress: Progress
) -> list[Judged]:
    """Diagnose the channels of one robot, on all processors; see `estimation.diagnosis.robot.judge_robot`."""
    library = tuple(effects)
    jobs = [Job(subject.channel, subject.model, library, SEED) for subject in subjects]
    judged = diagnose_apart(jobs, os.cpu_count() or 1, progress)
    return [_with_what_was_left_out(one, subject) for one, subject in zip(judged, subjects, strict=True)]


def _with_what_was_left_out(judged: Judged, subject: Subject) -> Judged:
    found = judged.found.model_copy(update={"not_judged": list(subject.not_judged)})
    return replace(judged, found=found)


def diagnosis_of(judged: Sequence[Judged], file: str) -> Diagnosis:
    """The answers alone, for the record."""
    model = model_names(tuple(Subject(one.data, one.model) for one in judged))
    return Diagnosis(file=file, model=model, channels=[one.found for one in judged])


def tell_story(
    subject: Subject,
    diagnosis: ChannelDiagnosis | None,
    added: Sequence[str],
    effects: Sequence[Effect],
    kept: KeptDiagnosis | None = None,
) -> Story:
    """Add effects stage by stage, and compare the first and the last stage with the measurement.

    All are measured by one noise floor: the lowest that any stage shows, or that the diagnosis found.

    Args:
        subject: the channel, as it was judged, and its base model.
        diagnosis: what was found missing, if anybody asked.
        added: effects to add, in order.
        effects: where they are found.
        kept: what was found earlier, which is told where it is about the same data and base model.

    Raises:
        InputError: an effect is unknown, there already, or does not apply.
    """
    if diagnosis is not None and diagnosis.baseline is None:
        return Story(subject, diagnosis, None, ())
    fitted = standings(subject.channel, subject.model, added, effects)
    first = last = next(fitted)
    stages = [revision_of(0, "", first)]
    for number, (name, last) in enumerate(zip(added, fitted, strict=True), start=1):
        stages.append(revision_of(number, name, last))
    if kept is not None:
        diagnosis = kept.of(subject.channel.name, first.rmse)
    known = diagnosis.noise_floor if diagnosis is not None else None
    floor = min(stages[-1].noise_floor, math.inf if known is None else known)
    stages = [replace(stage, noise_floor=min(stage.noise_floor, floor)) for stage in stages]
    base = compare_standing(first, floor)
    grown = replace(compare_standing(last, floor), model=model_name(base.model, added)) if added else None
    return Story(subject, diagnosis, base, tuple(stages), grown)


def model_name(base: str, added: Sequence[str]) -> str:
    """What a base model with effects added to it is called."""
    return " + ".join([base, *added])


def channel_for(subjects: Sequence[Subject], effects: Sequence[Effect]) -> Subject:
    """The one channel in which these effects can be; the contact, where they can be there too.

    Raises:
        InputError: there is none, or there are several joints to choose from.
    """
    fitting = [subject for subject in subjects if _suit(effects, subject)]
    names = " and ".join(effect.name for effect in effects)
    if not fitting:
        there = ", ".join(f"{subject.channel.name} ({subject.channel.kind})" for subject in subjects)
        raise InputError(f"{names} can be in none of the channels: {there}")
    contacts = [subject for subject in fitting if subject.channel.kind is ChannelKind.CONTACT]
    if len(fitting) > 1 and len(contacts) != 1:
        there = ", ".join(subject.channel.name for subject in fitting)
        raise InputError(f"{names} can be in {there}: choose one with --channel")
    return (contacts or fitting)[0]


def _suit(effects: Sequence[Effect], subject: Subject) -> bool:
    """Whether all effects can be in a channel, which brings its load as soon as a model is fitted to it."""
    model = subject.model
    any_values = {name: p.typical[0] for name, p in (*model.gains.items(), *model.inner.items())}
    loaded = with_load(subject.channel, model, any_values)
    return all(effect.applies_to(loaded) for effect in effects)
