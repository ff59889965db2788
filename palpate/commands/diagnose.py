"""`palpate diagnose`: is anything missing in the model, and which physical effect is it?"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from estimation.diagnosis import Diagnosis, Verdict
from estimation.diagnosis.common_cause import others_may_tell
from estimation.diagnosis.judged import Judged
from estimation.effect import Effect
from estimation.effects.stress_relaxation import StressRelaxation
from estimation.fresh_runs import relaxes_afresh
from estimation.models import MODELS
from palpate import console
from palpate.data_options import (
    ColumnOption,
    ContextOption,
    FileArgument,
    ForceOption,
    FreshOption,
    TipFrameOption,
    UnitOption,
    UrdfOption,
    WhereOption,
    given_arm,
    import_options,
    retyped,
)
from palpate.files import output_folder
from palpate.findings.derived import folder_to_fill
from palpate.findings.effect_library import EffectLibrary, library_with
from palpate.findings.estimation_run import Arm, Material, load_material
from palpate.findings.kept_diagnosis import RESULT
from palpate.findings.next_plan import plan_of, same_world, write_plan
from palpate.findings.other_models import better_explanation
from palpate.findings.revisions import RevisionShelf
from palpate.findings.story import Story, diagnosis_of, judge_subjects, tell_story
from palpate.findings.subject import ALL_CHANNELS, Subject, channels_to_diagnose, subjects_of
from palpate.render.progress import diagnosis_progress
from palpate.render.stories import NAMES as OUTCOME
from palpate.render.stories import diagnosis_view, write_json, write_outcome
from palpate.render.terminal import print_diagnosis, print_files
from palpate.render.view import StudyView
from palpate.text.after_diagnosis import Ways, after_diagnosis
from palpate.words import typed as path_typed

PLAN = "next-experiment.yaml"


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    model: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(MODELS)}; default: what suits each channel.")
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(
            help=f"Only this channel, such as joint_2, or {ALL_CHANNELS}; default: contacts, if any."
        ),
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect of your own to try as well; its file is run.", metavar="FILE.py:CLASS"),
    ] = None,
    apply: Annotated[
        bool, typer.Option("--apply", help="Add what is missing, and keep each step as a revision.")
    ] = False,
    urdf: UrdfOption = None,
    tip_frame: TipFrameOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the diagnosis as JSON.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(help=f"Write {RESULT}, report and more here.", metavar="FOLDER"),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Say whether anything is missing in a model, which physical effect it is, and how sure that is.

    Verdicts: adequate, missing, unexplained (structure that no known effect explains), or insufficient (this
    data cannot say). All is judged on runs that the fit has not seen. What is in the session's own folder
    is renewed.
    """
    material = load_material(file, import_options(column, unit, where, context, fresh_runs))
    known = subjects_of(material, model, given_arm(urdf, tip_frame, material.arm))
    subjects = channels_to_diagnose(known, channel, probed=material.probed)
    data = {"column": column, "unit": unit, "where": where, "context": context, "fresh-runs": fresh_runs}
    judged_by = {"model": model, "urdf": urdf, "tip-frame": tip_frame}
    ways = Ways(
        diagnose=retyped(file, channel=channel, effect=effect, **judged_by, **data),
        add=retyped(file, effect=effect, **judged_by, **data),
        compare=retyped(
            file, channel=None if channel == ALL_CHANNELS else channel, folder=out, **judged_by, **data
        ),
        kept=retyped(file, folder=out, **data),
    )
    library = library_with(effect)
    library.rehearse([subject.channel for subject in subjects])
    wanted = out is not None or apply or (material.session is not None and not as_json)
    names = (RESULT, PLAN, *OUTCOME)
    folder = output_folder(folder_to_fill(material, out, names, force=force)) if wanted else None
    with diagnosis_progress([subject.channel.name for subject in subjects]) as progress:
        judged = judge_subjects(subjects, library.effects, progress)
    diagnosis = diagnosis_of(judged, str(file))
    if model is None and urdf is None and not as_json:
        ways = replace(ways, others=tuple(_other_models(judged, material.arm, ways.diagnose)))
    left_out = len(subjects) < len(known)
    why_all = why_all_channels(judged, library.effects, chosen=channel is not None) if left_out else None
    if as_json:
        console.print_json(diagnosis.model_dump(mode="json"))
    else:
        _print(subjects, diagnosis)
    afresh = not as_json and material.session is None and met_afresh(subjects, diagnosis)
    ways = replace(ways, applied=apply, why_all=why_all, afresh=afresh)
    if folder is None:
        if not as_json:
            console.next_steps(*after_diagnosis(material, diagnosis, ways))
        return
    write_json(diagnosis.model_dump(mode="json"), folder / RESULT)
    plan = _write_plan(material, diagnosis, folder)
    stories = stories_of(judged, library)
    if apply:
        _keep(folder, stories, library.own, quiet=as_json)
    repeated = f"palpate diagnose {ways.diagnose}{' --apply' if apply else ''}"
    written = write_outcome(folder, material, stories, [repeated])
    if not as_json:
        console.stdout().print()
        print_files(console.stdout(), {"result": folder / RESULT, **written})
        ways = replace(ways, again=_again(material, plan))
        console.next_steps(*after_diagnosis(material, diagnosis, ways))


def met_afresh(subjects: Sequence[Subject], diagnosis: Diagnosis) -> bool:
    """Whether something relaxes that is not explained, and would be better if no run remembered another."""
    for subject, found in zip(subjects, diagnosis.channels, strict=True):
        helped = [*(entry.effect for entry in found.accepted), *(entry.effect for entry in found.suspects)]
        if found.verdict is Verdict.UNEXPLAINED and StressRelaxation.name in helped:
            return relaxes_afresh(subject.channel, subject.model)
    return False


def why_all_channels(judged: Sequence[Judged], effects: Sequence[Effect], *, chosen: bool) -> str | None:
    """What judging the channels that were left out would tell; None where nobody knows of anything.

    Args:
        judged: those that were not left out.
        effects: the library.
        chosen: whether the user left them out.
    """
    if not chosen:
        return "the arm's joints were not judged"
    unsure = next((one for one in judged if others_may_tell(one, effects)), None)
    if unsure is None:
        return None
    (entry,) = unsure.found.accepted
    return f"the other joints may tell {entry.effect} from {' or '.join(entry.confused_with)}"


def _print(subjects: Sequence[Subject], diagnosis: Diagnosis) -> None:
    pairs = zip(subjects, diagnosis.channels, strict=True)
    views = tuple(diagnosis_view(subject.channel, found) for subject, found in pairs)
    print_diagnosis(console.stdout(), StudyView(diagnosis.file, views))


def _other_models(judged: Sequence[Judged], arm: Arm, typed: str) -> Iterator[tuple[str, str]]:
    for one in judged:
        better = better_explanation(Subject(one.data, one.model), one.found, arm)
        if better is not None:
            left = f"{better[1]:.3g} {one.found.effort_unit}"
            yield f"palpate diagnose {typed} --model {better[0]}", f"from a base model that leaves {left}"


def stories_of(judged: Sequence[Judged], library: EffectLibrary) -> list[Story]:
    """Refit what was judged stage by stage, for the pictures."""
    with console.stderr().status("refitting stage by stage"):
        return [
            tell_story(
                Subject(one.data, one.model),
                one.found,
                [entry.effect for entry in one.found.accepted],
                library.effects,
            )
            for one in judged
        ]


def _keep(folder: Path, stories: Sequence[Story], own: dict[str, str], *, quiet: bool) -> None:
    for story in stories:
        if len(story.stages) < 2:
            continue
        name, unit = story.subject.channel.name, story.subject.channel.kind.effort_unit
        kept = RevisionShelf(folder).keep(name, unit, story.stages, parent=None, user_effects=own)
        if not quiet:
            numbers = ", ".join(str(revision.number) for revision in kept)
            console.stdout().print(f"[bold]{name}[/bold]: refitted, kept as revisions {numbers}")


def _write_plan(material: Material, diagnosis: Diagnosis, folder: Path) -> Path | None:
    """The first experiment that an arm can run by itself."""
    for found in diagnosis.channels:
        if found.next_experiment is None or found.verdict is Verdict.ADEQUATE:
            continue
        plan = plan_of(found.next_experiment, material.session)
        if plan is not None:
            path = folder / PLAN
            write_plan(found.next_experiment, plan, path)
            return path
    return None


def _again(material: Material, plan: Path | None) -> str | None:
    """The command that probes the same object by another plan; None where nobody knows it."""
    if plan is None or material.session is None:
        return None
    world = same_world(material.session)
    return None if world is None else f"palpate probe --experiment {path_typed(plan)} {world}".strip()
