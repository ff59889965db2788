"""How a channel's model grew: compared with the measurement, diagnosed, refitted stage by stage."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from estimation.channel import ChannelKind
from estimation.comparison import Comparison, compare
from estimation.diagnosis import ChannelDiagnosis, Diagnosis
from estimation.diagnosis.apart import Job, Progress, diagnose_apart
from estimation.diagnosis.judged import Judged
from estimation.effect import Effect
from estimation.revision import Revision, revise
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
    """

    subject: Subject
    diagnosis: ChannelDiagnosis | None
    comparison: Comparison | None
    stages: tuple[Revision, ...]


def compare_subject(subject: Subject) -> Comparison:
    """Compare; see `estimation.comparison.compare`."""
    return compare(subject.channel, subject.model)


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
    return diagnose_apart(jobs, os.cpu_count() or 1, progress)


def diagnosis_of(judged: Sequence[Judged], file: str) -> Diagnosis:
    """The answers alone, for the record."""
    model = model_names(tuple(Subject(one.data, one.model) for one in judged))
    return Diagnosis(file=file, model=model, channels=[one.found for one in judged])


def tell_story(
    subject: Subject, diagnosis: ChannelDiagnosis | None, added: Sequence[str], effects: Sequence[Effect]
) -> Story:
    """Compare the base model, and add effects stage by stage.

    Args:
        subject: the channel, as it was judged, and its base model.
        diagnosis: what was found missing, if anybody asked.
        added: effects to add, in order.
        effects: where they are found.

    Raises:
        InputError: an effect is unknown, there already, or does not apply.
    """
    if diagnosis is not None and diagnosis.baseline is None:
        return Story(subject, diagnosis, None, ())
    stages = revise(subject.channel, subject.model, added, effects)
    compared = compare(subject.channel, subject.model, stages[-1].noise_floor)
    return Story(subject, diagnosis, compared, stages)


def channel_for(subjects: Sequence[Subject], effects: Sequence[Effect]) -> Subject:
    """The one channel in which these effects can be; the contact, where they can be there too.

    Raises:
        InputError: there is none, or there are several joints to choose from.
    """
    fitting = [
        subject for subject in subjects if all(effect.applies_to(subject.channel) for effect in effects)
    ]
    names = " and ".join(effect.name for effect in effects)
    if not fitting:
        there = ", ".join(f"{subject.channel.name} ({subject.channel.kind})" for subject in subjects)
        raise InputError(f"{names} can be in none of the channels: {there}")
    contacts = [subject for subject in fitting if subject.channel.kind is ChannelKind.CONTACT]
    if len(fitting) > 1 and len(contacts) != 1:
        there = ", ".join(subject.channel.name for subject in fitting)
        raise InputError(f"{names} can be in {there}: choose one with --channel")
    return (contacts or fitting)[0]
