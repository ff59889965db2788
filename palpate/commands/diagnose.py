"""`palpate diagnose` and `estimate`: diagnose missing effects, and estimate parameters."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from palpate.common import console
from palpate.common.console import as_shell_word, count, display_path, json_text, safe, shell_path
from palpate.common.files import folder_to_fill, output_folder
from palpate.common.options import JsonOption, estimator_names, with_options
from palpate.estimation.channel import ChannelKind
from palpate.estimation.diagnosis import Verdict
from palpate.estimation.estimate import with_unit
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.study import StudyDiagnosis
from palpate.estimation.study.channels import ALL_CHANNELS, FITTED_ARM_MODEL
from palpate.estimation.study.estimates import ALL, DEFAULT_ESTIMATORS
from palpate.estimation.study.other_models import better_explanation, error_with_fitted_masses
from palpate.estimation.study.results import ChannelResult
from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.render.build import NAMES, view_of, write_outcome
from palpate.render.estimates import as_data, calibration_remark, print_estimates
from palpate.render.terminal import print_diagnosis, print_files
from palpate.robot_io.errors import InputError
from palpate.study import Study
from palpate.workflows.data_options import DataArguments, ForceOption, ModelOption, takes_data

PLAN = "next-experiment.yaml"
EXIT_CODES = {Verdict.MISSING: 10, Verdict.UNEXPLAINED: 11, Verdict.INSUFFICIENT: 12}  # 1 to 3 are failures
MOST_ASKED = 3  # largest number of unused columns to suggest


_EXIT_CODE = "Exit code 10 if missing, else 11 if unexplained, else 12 if insufficient, else 0."
_CHANNEL = f"Only this channel, such as joint_2; default: {ALL_CHANNELS}."
_APPLY = "Add the missing effects, and save each step as a revision."
_OUT = f"Write {RESULT}, a report and more to this folder."


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(DataArguments):
    """What is diagnosed, as the user typed it."""

    model: ModelOption = None
    channel: Annotated[str | None, Option(help=_CHANNEL)] = None
    apply: Annotated[bool, Option("--apply", help=_APPLY)] = False
    exit_code: Annotated[bool, Option("--exit-code", help=_EXIT_CODE)] = False
    as_json: JsonOption = False
    out: Annotated[Path | None, Option(help=_OUT, metavar="FOLDER")] = None
    force: ForceOption = False


@with_options(DiagnoseOptions, "file")
def diagnose_command(data: DiagnoseOptions) -> None:
    """Diagnose whether a model lacks a physical effect, which effect, and how certain the answer is.

    Verdicts: adequate, missing, unexplained (something is missing, and no known effect explains it), or
    insufficient (the data do not allow a verdict). Errors are computed on runs that were not used for the
    fit. Overwrites the earlier report in the session's folder, and the saved verdicts on the same channels.
    """
    from palpate.render.progress import diagnosis_progress  # noqa: PLC0415, loads what moves an arm

    data.refuse_idle_force(data.out, force=data.force)
    study = data.study(data.model, data.out)
    data.print_omitted()
    folder = None
    if data.out is not None or data.apply or (study.source.session is not None and not data.as_json):
        names = (RESULT, PLAN, *NAMES)
        folder = output_folder(folder_to_fill(data.file, data.out, names, force=data.force))
    with diagnosis_progress([item.name for item in study.chosen(data.channel)]) as progress:
        diagnosis = study.diagnose(data.channel, apply=data.apply, progress=progress)
    following = study.next_probe(diagnosis.channels)

    @cache  # JSON does not need these comparisons of all channels
    def results() -> list[ChannelResult]:
        return [
            study.result(study.channel(entry.channel), [added.effect for added in entry.accepted], entry)
            for entry in diagnosis.channels
        ]

    def show() -> None:
        print_diagnosis(console.stdout(), view_of(study, results()))
        if study.source.probed and all(item.kind is not ChannelKind.CONTACT for item in study.channels):
            console.warn("no contact: the force never exceeds its level in free air; was anything touched?")

    console.present(study.diagnosis_data(diagnosis), show, as_json=data.as_json)
    plan = None
    if folder is not None:
        try:
            content = study.diagnosis_to_save(diagnosis)
        except InputError as error:
            console.warn(f"the saved verdicts on other channels could not be kept: {error}")
            content = study.diagnosis_data(diagnosis)
        texts = {RESULT: json_text(content)}
        if following is not None:
            from palpate.planning.next_probe import plan_text  # noqa: PLC0415, as where it was planned

            plan, texts[PLAN] = folder / PLAN, plan_text(following.proposal, following.plan)
        repeated = data.command_text(channel=data.channel, model=data.model, apply=data.apply)
        written = write_outcome(folder, study, results(), [f"palpate diagnose {repeated}"], texts)
        if not data.as_json:
            console.stdout().print()
            print_files(console.stdout(), {"result": folder / RESULT, **written})
    if not data.as_json:
        console.next_steps(*_next_steps(data, study, diagnosis, plan))
    if data.exit_code:
        raise typer.Exit(_exit_code_of([channel.verdict for channel in diagnosis.channels]))


def _exit_code_of(verdicts: Iterable[Verdict]) -> int:
    """Return the exit code of the most severe verdict; 0 if all channels are adequate."""
    return min((EXIT_CODES[verdict] for verdict in verdicts if verdict in EXIT_CODES), default=0)


def _model_steps(data: DiagnoseOptions, study: Study, diagnosis: StudyDiagnosis) -> Iterator[tuple[str, str]]:
    """Suggest commands that add the missing effects, or use the newest revision if it already has them."""
    improved = [channel for channel in diagnosis.channels if channel.accepted]
    added = {  # effects of the newest revision of each channel
        item.channel: revision.effects if (revision := study.latest(study.channel(item.channel))) else []
        for item in improved
    }
    saved = [
        item for item in improved if set(added[item.channel]) == {entry.effect for entry in item.accepted}
    ]
    if saved:
        kept = data.command_text(folder=data.out)
        yield f"palpate revisions {kept}", "the newest revision contains the missing effects"
        yield from console.export_steps(kept, [study.channel(item.channel).kind for item in saved])
    for item in improved:
        if item in saved:
            continue
        names = " ".join(entry.effect for entry in item.accepted)
        alone = len(study.source.channels) == 1 or item.channel == "contact"
        where = "" if alone else f" --channel {item.channel}"
        where += " --fresh" if added[item.channel] else ""  # otherwise it would add to these
        it = "it" if len(item.accepted) == 1 else "them"
        # a folder without revisions is the user's, and its report is replaced only with --force
        force = data.out is not None and not study.revisions
        again = data.command_text(model=data.model, out=data.out, force=force)
        yield f"palpate add {again} {names}{where}", f"refit with {it}, and save a revision"


def _next_steps(
    data: DiagnoseOptions, study: Study, diagnosis: StudyDiagnosis, plan: Path | None
) -> Iterator[tuple[str, str]]:
    """Suggest commands that follow a diagnosis, the nearest first."""
    again = data.command_text(model=data.model, channel=data.channel)
    yield from _model_steps(data, study, diagnosis)
    if data.model is None and data.urdf is None:
        for item in diagnosis.channels:
            better = better_explanation(study, study.channel(item.channel), item)
            if better is not None:
                left = (
                    "start from a better base model, with an error of "
                    f"{with_unit(better[1], item.effort_unit)}"
                )
                better_text = data.command_text(channel=data.channel, model=better[0])
                yield f"palpate diagnose {better_text}", left
    for item in diagnosis.channels if data.urdf is not None else ():
        error = error_with_fitted_masses(study, study.channel(item.channel), item)
        if error is not None:
            fitted_text = data.command_text(channel=data.channel, model=FITTED_ARM_MODEL)
            left = f"fit the links' masses too: {item.channel} then has an error of"
            yield f"palpate diagnose {fitted_text}", f"{left} {with_unit(error, item.effort_unit)}"
            break  # the model is one of the whole arm
    if plan is not None and study.source.session is not None:
        from palpate.planning.next_probe import same_world  # noqa: PLC0415, as above

        world = same_world(study.source.session)
        if world is not None:
            experiment = f"palpate probe --experiment {shell_path(plan)} {world}".strip()
            yield experiment, "the most informative next experiment"
    if any(
        channel.verdict is Verdict.UNEXPLAINED or channel.complete is False for channel in diagnosis.channels
    ):
        for name in study.source.unused[:MOST_ASKED]:
            with_signal = f"palpate diagnose {again} --context {as_shell_word(name)}"
            yield with_signal, f"test whether the error depends on {name}"
        own_effect = "try an effect of your own (docs/reference/effects.md explains how to write one)"
        yield f"palpate diagnose {again} --effect FILE.py:CLASS", own_effect
    if all(study.refusal(study.channel(channel.channel)) for channel in diagnosis.channels):
        reading = data.command_text(**dict.fromkeys(["effect", "urdf", "tip-frame", "held-out"]))
        remedy = f"palpate import {reading} --look", "check columns, units and ranges"
        if study.source.session is not None:
            remedy = f"palpate inspect {shell_path(data.file)}", "see it in Rerun"
        elif data.file.is_file() and any("; record" in channel.reason for channel in diagnosis.channels):
            remedy = f"palpate import {shell_path(data.file)} FILE ... --look", "import more files as runs"
        yield remedy
        return
    only = None if data.channel == ALL_CHANNELS else data.channel
    is_adequate = all(channel.verdict is Verdict.ADEQUATE for channel in diagnosis.channels)
    purpose = "the model beside the measurements" if is_adequate else "where the model fails"
    yield f"palpate compare {data.command_text(model=data.model, channel=only, folder=data.out)}", purpose


_ESTIMATOR = (
    f"One or more of {', '.join(ESTIMATORS)}, separated by commas; default: {','.join(DEFAULT_ESTIMATORS)}."
)


@takes_data
def estimate_command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    channel: Annotated[str | None, Option(help="Only this channel, such as joint_2.")] = None,
    estimator: Annotated[str | None, Option(help=_ESTIMATOR, autocompletion=estimator_names)] = None,
    every: Annotated[bool, Option("--all", help="Use all estimators.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate the parameters of a model with 95 % intervals, by least squares, a robust method and RANSAC.

    Reads a session or a data file. For a simulated session, the true values and the errors are shown too.
    """
    if every and estimator is not None:
        raise InputError(f"--all and --estimator {estimator}: give only one of them")
    study = data.study(model)
    data.print_omitted()
    names = ALL if every else DEFAULT_ESTIMATORS if estimator is None else estimator
    estimates = study.estimate(names, channel)
    session = study.source.session
    cut_off = session is not None and session.truncated

    def show() -> None:
        out = console.stdout()
        out.print(f"[bold]{display_path(data.file)}[/bold]: {count(len(estimates), 'channel')}")
        for each in estimates:
            print_estimates(out, each, study.truth_of(each.channel))
        for remark in calibration_remark(session):
            out.print(f"  {safe(remark)}")

    used = "+".join(dict.fromkeys(each.model.name for each in estimates))
    content = {
        "file": str(data.file),
        "model": used,
        "cut_off": cut_off,
        "channels": [as_data(each, study.truth_of(each.channel)) for each in estimates],
    }
    again = data.command_text(channel=channel, model=model)
    steps = [(f"palpate compare {again}", "how well the model fits, and where it fails")]
    if all(study.refusal(study.channel(each.channel.name)) for each in estimates):
        steps = [(f"palpate diagnose {again}", "why these data cannot judge a model")]
    if session is not None:
        steps.append((f"palpate inspect {shell_path(data.file)}", "see it in Rerun"))
    console.present(content, show, steps, as_json=as_json)
