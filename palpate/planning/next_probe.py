"""Choose the next probe of a session's arm: the feasible plan that best separates open explanations."""

import math
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from palpate.common.console import as_shell_word
from palpate.control.loop.tick_record import STREAM_NAME
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.tick_channels import DIRECTION, contact_channels, joint_channels
from palpate.estimation.data_quality.motion_and_effort import SLID
from palpate.estimation.design.discrimination import (
    EQUIVALENT,
    Experiment,
    RivalModels,
    choose_experiment,
    separated_names,
    separated_pairs,
)
from palpate.estimation.design.next_experiment import (
    FEW_READINGS,
    LONGEST_S,
    NextExperiment,
    NextProbe,
    describe_separation,
)
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.study import ModelStudy, StudyChannel
from palpate.estimation.study.channels import channel_of
from palpate.estimation.study.fitting import Progress
from palpate.estimation.study.other_models import rivals_of
from palpate.planning.experiments import (
    ArmText,
    CandidatePlan,
    KnownObject,
    PlanSimulation,
    candidates,
    combine_plans,
    simulate_plans,
)
from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.files.file_model import parse_yaml, validate
from palpate.robot_io.session import Samples, Session
from palpate.robot_io.types import FloatArray
from palpate.runs.hidden_effects import SEALED
from palpate.runs.probing import PLAN

FITTED = 6  # number of the best experiments for which all models are refitted
PAIRED = 3  # number of pairs of these tried as one experiment, the most informative pairs first
_SEED = 1


@dataclass(frozen=True)
class UndecidedModels:
    """A channel with models that its data cannot separate, each described by its effects."""

    channel: StudyChannel
    names: tuple[str, ...]
    rivals: RivalModels

    @property
    def no_leads(self) -> FloatArray:
        """Scores of an experiment that does not help to answer this question."""
        return np.zeros((len(self.names),) * 2)


def next_probe(
    study: ModelStudy,
    diagnoses: Sequence[ChannelDiagnosis],
    longest_s: float = LONGEST_S,
    progress: Progress = lambda what, share: None,
    processes: int = 1,
) -> NextProbe | None:
    """Return the plan expected to separate the open explanations; None if there is none.

    If no channel could be judged, the plan records the missing data. Otherwise each plan that the arm can do
    within its limits is rehearsed, data are simulated on that motion from each remaining model, and all
    models are fitted again; see `palpate.estimation.design`. No plan is run twice, because its result is
    already in the data. A plan stated in saved diagnoses is used without planning again, unless it ran since.

    Args:
        study: study with all measurements so far.
        diagnoses: diagnoses of its channels.
        longest_s: longest allowed duration of an experiment [s].
        progress: called with the current step and the fraction of it that is done.
        processes: number of processes for the rehearsals.

    Raises:
        InputError: the session's own copies of robot file or plan are not valid.
    """
    if not study.source.probed:
        return None
    sessions = filter(None, (study.source.session, *study.source.more))
    ran = [_plan_of(session) for session in sessions]  # plans that the arm has run so far
    stated = _stated_probe(study, diagnoses) if longest_s >= LONGEST_S else None
    if stated is not None and stated.plan not in ran:
        return stated
    # Each channel's accepted effects with their indistinguishable alternatives.
    open_questions = [
        UndecidedModels(channel, tuple(models), RivalModels.of(list(models.values())))
        for diagnosis in diagnoses
        for channel in [study.channel(diagnosis.channel)]
        for models in rivals_of(study, channel, diagnosis)
    ]
    if not open_questions:
        return _remedy(study, diagnoses, longest_s, progress)
    # Only models of joints predict anything about other places of the object and other directions.
    is_joint_open = any(question.channel.kind is not ChannelKind.CONTACT for question in open_questions)
    offered = feasible(study, progress, processes=processes, elsewhere=is_joint_open)
    predicted = _planned(offered, ran, study, open_questions, longest_s)
    single = [design.expected(open_questions) for design in predicted[:FITTED]]
    # Pairs that are more informative than any single experiment, the most informative pairs first.
    most = max((design.experiment.separation for design in single), default=0.0)
    both_tell = [
        (a.experiment.combined_with(b.experiment).separation, a, b) for a, b in combinations(single, 2)
    ]
    both_tell.sort(key=lambda pair: pair[0], reverse=True)
    pairs = [(a.candidate, b.candidate) for tells, a, b in both_tell if tells * EQUIVALENT > most]
    paired = feasible(study, progress, pairs=pairs, processes=processes)
    joint = _planned(paired, ran, study, open_questions, longest_s)
    every = [*single, *(design.expected(open_questions) for design in joint)]
    choice = choose_experiment([design.experiment for design in every])
    if choice is None:
        return None
    candidate, leads = every[choice.index].candidate, choice.experiment.leads
    separated = [
        (design.channel.name, names)
        for design, lead in zip(open_questions, leads, strict=True)
        if (names := separated_names(design.names, lead))
    ]
    proposal = NextExperiment(
        purpose=" and to ".join(dict.fromkeys(describe_separation(names) for _, names in separated)),
        separates=list(dict.fromkeys(name for _, names in separated for name in names)),
        instruction=candidate.words,
        probe=candidate.settings,
    )
    channels = tuple(dict.fromkeys(channel for channel, _ in separated))
    apart = [
        separated_pairs(question.names, [design.experiment.leads[number] for design in (*predicted, *every)])
        for number, question in enumerate(open_questions)
    ]
    return NextProbe(candidate.plan, proposal, choice.reason, channels, set[frozenset[str]]().union(*apart))


def can_plan(study: ModelStudy) -> bool:
    """Return whether the arm of a study, its object and its plan are known, so that probes can be planned.

    Args:
        study: the study.
    """
    session = study.source.session
    return session is not None and study.source.probed and _rehearsal(study, session) is not None


def _stated_probe(study: ModelStudy, diagnoses: Sequence[ChannelDiagnosis]) -> NextProbe | None:
    """Return the probe stated by diagnoses; None unless it is one of this arm's own candidates.

    A diagnosis may come from a file of unknown origin, which must not control the arm.
    """
    proposals = [
        item.next_experiment for item in diagnoses if item.next_experiment and item.next_experiment.probe
    ]
    session = study.source.session
    rehearsal = _rehearsal(study, session) if proposals and session is not None else None
    if rehearsal is None:
        return None
    proposal, (before, trial) = proposals[0], rehearsal
    single = _candidates(before, trial)
    paired = (plan for pair in combinations(single, 2) if (plan := combine_plans(*pair, before)) is not None)
    for candidate in chain(single, paired):
        if candidate.settings == proposal.probe:
            channels = tuple(item.channel for item in diagnoses if item.next_experiment == proposal)
            return NextProbe(candidate.plan, proposal, proposal.instruction, channels)
    return None


@dataclass(frozen=True)
class _Planned:
    """A feasible experiment with its predicted motion for each question; None if it is uninformative."""

    candidate: CandidatePlan
    experiment: Experiment  # with predicted or, after refits, expected scores
    motions: tuple[ChannelData | None, ...]

    def expected(self, left: Sequence[UndecidedModels]) -> "_Planned":
        """Return the experiment with the scores that are expected once all models are refitted."""
        rng = np.random.default_rng(_SEED)
        leads = tuple(
            question.rivals.simulated_leads(motion, rng) if motion is not None else question.no_leads
            for question, motion in zip(left, self.motions, strict=True)
        )
        evidence = sum(
            question.rivals.evidence(lead, motion)
            for question, lead, motion in zip(left, leads, self.motions, strict=True)
            if motion is not None
        )
        return replace(self, experiment=replace(self.experiment, leads=leads, evidence=evidence))


def _planned(
    offered: Iterable[tuple[CandidatePlan, Samples]],
    ran: Sequence[ProbingPlan],
    study: ModelStudy,
    left: Sequence[UndecidedModels],
    longest_s: float,
) -> list["_Planned"]:
    """Plan experiments that are short enough and were not run yet, the most promising first."""
    planned = []
    for offer, ticks in offered:
        duration_s = float(ticks["time_s"][-1])
        if offer.plan in ran or duration_s > longest_s:
            continue
        is_new = offer.is_new_location
        motions = tuple(_motion(question, study, ticks, is_new_location=is_new) for question in left)
        leads = tuple(
            question.rivals.predicted_leads(motion) if motion is not None else question.no_leads
            for question, motion in zip(left, motions, strict=True)
        )
        planned.append(_Planned(offer, Experiment(offer.words, duration_s, leads), motions))
    return sorted(planned, key=lambda offer: offer.experiment.separation, reverse=True)


def _plan_of(session: Session) -> ProbingPlan:
    text = session.metadata.extra.get(PLAN, "")
    return validate(ProbingPlan, dict(parse_yaml(text, f"{session.path}, its plan").data) if text else {})


def _remedy(
    study: ModelStudy, diagnoses: Sequence[ChannelDiagnosis], longest_s: float, progress: Progress
) -> NextProbe | None:
    """Propose more presses where a channel cannot be judged, or harder ones if readings are too coarse."""
    contacts = [item for item in diagnoses if item.channel.startswith("contact")]
    judged = contacts or list(diagnoses)
    if any(item.verdict is not Verdict.INSUFFICIENT for item in judged):
        return None
    first = judged[0]
    if SLID in first.reason:  # all candidates press in the same wrong direction
        return None
    setting = "force_limit_n" if FEW_READINGS in first.reason else "repeats"
    for candidate, ticks in feasible(study, progress):
        duration_s = float(ticks["time_s"][-1])
        if setting in candidate.settings and duration_s <= longest_s:
            proposal = NextExperiment(
                purpose=f"judge {first.channel}",
                separates=[],
                instruction=candidate.words,
                probe=candidate.settings,
            )
            reason = f"{candidate.words}: {first.reason}"
            return NextProbe(candidate.plan, proposal, reason, tuple(item.channel for item in judged))
    return None


def feasible(
    study: ModelStudy,
    progress: Progress = lambda what, share: None,
    pairs: Sequence[tuple[CandidatePlan, CandidatePlan]] | None = None,
    processes: int = 1,
    *,
    elsewhere: bool = True,
) -> Iterator[tuple[CandidatePlan, Samples]]:
    """Return the experiments that the arm of a study can do, each with its simulated motion.

    Args:
        study: study of the arm.
        progress: called with the experiment under consideration.
        pairs: pairs to combine, at most `PAIRED` of them; None for the whole catalog.
        processes: number of processes for the rehearsals.
        elsewhere: whether the catalog includes other places of the object and other directions of pressing.

    Raises:
        InputError: see `next_probe`.
    """
    session = study.source.session
    rehearsal = _rehearsal(study, session) if session is not None and study.source.probed else None
    if rehearsal is None:
        return
    before, trial = rehearsal
    if pairs is None:
        considered = [each for each in _candidates(before, trial) if elsewhere or not each.is_new_location]
    else:
        considered = [plan for pair in pairs if (plan := combine_plans(*pair, before))][:PAIRED]
    simulations = [replace(trial, plan_json=each.plan.model_dump_json()) for each in considered]
    for number, (candidate, ticks) in enumerate(
        zip(considered, simulate_plans(simulations, processes), strict=True)
    ):
        progress(f"design: {candidate.words}", number / len(considered))
        if ticks is not None:
            yield candidate, ticks


def _motion(
    question: UndecidedModels, study: ModelStudy, ticks: Samples, *, is_new_location: bool
) -> ChannelData | None:
    """Return the channel's planned motion; None if it does not move, or presses another place."""
    data = question.channel.data
    channels: Sequence[ChannelData]
    if data.kind is ChannelKind.CONTACT:
        channels = contact_channels(ticks, tared=False)
    else:
        directions = data.context.get(DIRECTION)
        joints = joint_channels(ticks, None if directions is None else directions[0])
        channels = [joint for joint in joints if joint.name == data.name]
    planned = channels[0] if channels else None
    if planned is None or (is_new_location and planned.kind is ChannelKind.CONTACT):
        return None
    prepared = channel_of(planned, question.channel.model.name, study.source.arm).prepare()
    return replace(
        prepared,
        recovers=data.recovers,
        recovery_ratio=data.recovery_ratio,
        retardation_s=data.retardation_s,
        surface_recovers=data.surface_recovers,
    )


def _rehearsal(study: ModelStudy, session: Session) -> tuple[ProbingPlan, PlanSimulation] | None:
    """Return a session's plan and its rehearsal; None if nothing was touched: the object is unknown.

    Figures are rounded, because a motion hardly depends on them. The cached motion of a plan then stays valid
    if further probes change the estimates slightly.
    """
    contact = next((channel for channel in study.channels if channel.kind is ChannelKind.CONTACT), None)
    if contact is None or contact.data.surface is None or not session.metadata.robot_file:
        return None
    metadata, before = session.metadata, _plan_of(session)
    # stiffness [N/m] and damping [N s/m] of the base model, or the secant if the model has none
    data, damping = contact.data, 0.0
    stiffness = float(np.max(data.effort)) / max(float(np.max(data.position)), 1e-9)
    with suppress(InputError):  # it cannot be judged
        parameters = study.fit(contact).parameters
        if spring := parameters.get("stiffness.k"):
            stiffness = spring.value
        if damper := parameters.get("damping.c"):
            damping = max(damper.value, 0.0)
    surface_m, normal = round(contact.data.surface.position_m, 3), before.press_direction_world
    known = KnownObject(_rounded(stiffness), _rounded(damping), surface_m, normal)
    arm = ArmText(metadata.robot_file, metadata.urdf, study.source.arm.gravity_m_s2, str(session.path))
    start_rad = session.samples(STREAM_NAME).vector("joint_position_rad")[0]
    start = tuple(np.round(start_rad, 3).tolist())
    return before, PlanSimulation(arm, before.model_dump_json(), known, start)


def _candidates(before: ProbingPlan, trial: PlanSimulation) -> list[CandidatePlan]:
    """Return all experiments with a valid plan at or near the place that was touched first."""
    push = np.array(before.press_direction_world)
    tip_m, _ = trial.arm.body.tip_pose(np.array(trial.start_rad))
    before_m = np.array(before.targets_world_m[0]) if before.targets_world_m else tip_m
    place_m = before_m + (trial.known.surface_m - before_m @ push) * push
    return candidates(before, trial.arm.robot_file, place_m)


def _rounded(positive: float) -> float:
    """Round to the nearest of ten values per decade, with an error of at most 12 %; 0 stays 0."""
    return float(f"{10.0 ** (round(10.0 * math.log10(positive)) / 10.0):.2e}") if positive > 0.0 else 0.0


_WORLD = ("--robot", "--scenario", "--engine", "--seed", "--hidden", "--drivers")
_WIRE = "--wire"


def plan_text(experiment: NextExperiment, plan: ProbingPlan) -> str:
    """Write the plan as YAML, with its purpose as a comment.

    Args:
        experiment: the experiment that a diagnosis states.
        plan: the whole plan.
    """
    words = f"# {one_line(experiment.instruction)}\n# to {one_line(experiment.purpose)}\n"
    return words + plan.to_yaml()


def same_world(session: Session) -> str | None:
    """Return the options of `palpate probe` that recreate the world of a session.

    Returns:
        Options for a shell; None if they cannot be derived from the session.
    """
    metadata = session.metadata
    try:
        words = shlex.split(metadata.command_line)
    except ValueError:
        return None
    if words[:2] != ["palpate", "probe"] or SEALED in words:
        return None
    chosen: list[str] = []
    for word, following in zip(words[2:], [*words[3:], ""], strict=True):
        name, equals, _ = word.partition("=")
        if name == _WIRE:
            chosen.append(word)
        elif name in _WORLD:
            chosen += [word] if equals else [word, following]
    if metadata.seed is not None and not any(word.startswith("--seed") for word in chosen):
        chosen += ["--seed", str(metadata.seed)]
    return " ".join(as_shell_word(word) for word in chosen)
