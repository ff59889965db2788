"""`palpate compare`: show how far a model misses a measurement, and where."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from palpate.common import console
from palpate.common.console import display_path, json_text, safe, shell_path
from palpate.common.files import atomic_write_all, folder_to_fill, folder_to_read, output_folder, spare_files
from palpate.common.options import JsonOption, model_names, with_options
from palpate.estimation.estimate import with_unit
from palpate.estimation.study import ChannelResult
from palpate.estimation.study.channels import ALL_CHANNELS
from palpate.estimation.study.other_models import far_better_model
from palpate.estimation.study.paired_comparison import ComparedModel, Extended, compare_pairs
from palpate.estimation.study.revisions import Revision, user_effects_of
from palpate.render.build import NAMES, REPORT, result_view, write_outcome
from palpate.render.paired import ChannelPairView, PairView, as_data, print_pair
from palpate.render.terminal import print_comparison, print_files
from palpate.render.view import ChannelView
from palpate.robot_io.errors import InputError
from palpate.study import Study
from palpate.workflows.data_options import DataArguments, FolderOption, ForceOption, ModelOption

RESULT, RECORDING = "comparison.json", "sides.rrd"
PAIR_FILES = {"result": RESULT, "report": REPORT, "recording": RECORDING}  # of two measurements


def _chosen_revisions(study: Study, numbers: Sequence[int]) -> list[Revision]:
    """Look up revisions by number."""
    saved_revisions = [study.revision(number) for number in dict.fromkeys(numbers)]
    names = [revision.channel for revision in saved_revisions]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f"--revision: several revisions of channel '{min(twice)}'; compare one at a time")
    return saved_revisions


def _extended(study: Study, saved_revisions: Sequence[Revision]) -> Extended:
    """Return the models of revisions in a study, or its base models without revisions."""
    return [(study.channel_of(revision), revision.effects) for revision in saved_revisions] or [
        (channel, ()) for channel in study.channels
    ]


def _names(first: Study, second: Study, grown: tuple[Extended, Extended]) -> tuple[str, str]:
    """Name both sides by file, with folders if needed, or by model if the file is the same."""
    paths = [study.source.path for study in (first, second)]
    if paths[0] is None or paths[1] is None or paths[0].resolve() == paths[1].resolve():
        both = {c.name for c, _ in grown[0]} & {c.name for c, _ in grown[1]}
        shared = ([(c, e) for c, e in side if c.name in both] for side in grown)
        a, b = (", ".join(dict.fromkeys(" + ".join([c.model.name, *e]) for c, e in side)) for side in shared)
        return f"{first.source.name}: {a}", f"{second.source.name}: {b}"
    if paths[0].name != paths[1].name:
        return paths[0].name, paths[1].name
    return str(paths[0]), str(paths[1])


_OTHER = "Second measurement, such as a simulated twin, a repetition after a change, or another specimen."
_OTHER_MODEL = "Base model of OTHER; without OTHER, a second model of FILE."
_REVISION = "Number of the revision to compare instead of the base model; palpate revisions lists them."
_OTHER_REVISION = "Revision of OTHER; default: the same model is fitted to both."
_OUT = "Write comparison.json and an HTML report to this folder."


@dataclass(frozen=True, kw_only=True)
class CompareOptions(DataArguments):
    """What is compared, as the user typed it."""

    other: Annotated[Path | None, Argument(help=_OTHER)] = None
    model: ModelOption = None
    other_model: Annotated[str | None, Option(help=_OTHER_MODEL, autocompletion=model_names)] = None
    channel: Annotated[str | None, Option(help="Only this channel, such as contact.")] = None
    revision: Annotated[list[int] | None, Option(help=_REVISION, metavar="N")] = None
    other_revision: Annotated[list[int] | None, Option(help=_OTHER_REVISION, metavar="N")] = None
    folder: FolderOption = None
    as_json: JsonOption = False
    out: Annotated[Path | None, Option(help=_OUT, metavar="FOLDER")] = None
    force: ForceOption = False


@with_options(CompareOptions, "file")
def compare_command(data: CompareOptions) -> None:
    """Compare a model with the measurement: how large its error is, and where it is largest.

    Compares the base model; to compare a revision, add --revision N. Errors are computed on runs that were
    not used for the fit. The noise level is the error that a complete model would leave. The model fits if
    its error is below 1.1 times the noise, or at most three times the noise without a sign of a missing
    effect.

    With OTHER, compares two measurements: how well each model describes the other measurement (fit in %), how
    parameters differ, and the residuals of each model.

    Examples:
      palpate compare a.mcap
      palpate compare before.csv after.csv --out comparison
      palpate compare a.mcap --model kelvin_voigt --other-model hunt_crossley
    """
    data.refuse_idle_force(data.out, force=data.force)
    named = {"--model": data.model, "--other-model": data.other_model, "--channel": data.channel}
    if (data.revision or data.other_revision) and (given := [name for name, value in named.items() if value]):
        raise InputError(f"--revision sets channel and model, so leave out {given[0]}")
    if data.other is not None or data.other_model is not None or data.other_revision:
        _compare_pair(data)
        return
    study = data.study(data.model, folder_to_read(data.file, data.folder))
    saved_revisions = _chosen_revisions(study, data.revision or ())
    target = None
    if data.out is not None:
        target = output_folder(folder_to_fill(data.file, data.out, (RESULT, *NAMES), force=data.force))
    with console.stderr().status("comparing"):
        if saved_revisions:
            results = [study.result(study.channel_of(item), item.effects) for item in saved_revisions]
            failures: dict[str, str] = {}
        else:
            base = study.compare(data.channel)
            results = [study.result(study.channel(item.channel)) for item in base.channels]
            failures = dict(base.failures)
    compared = [result.shown for result in results if result.shown is not None]
    models = "+".join(dict.fromkeys(result.channel.model.name for result in results))

    @cache
    def content() -> dict[str, Any]:  # intervals of parameters take long, and the terminal shows none
        channels = [
            {
                **{name: getattr(comparison, name) for name in ("channel", "model", "effort_unit", "rmse")},
                "noise_floor": comparison.noise.value,
                "noise_source": comparison.noise.source,
                "noise_at_most": comparison.noise.is_bound,
                **{name: getattr(comparison, name) for name in ("lack_of_fit", "fits")},
                "parameters": {name: parameter.value for name, parameter in comparison.parameters.items()},
                **{name: getattr(comparison, name) for name in ("parts", "words", "patterns", "kinds")},
                "not_judged": comparison.exclusion_note,
            }
            for comparison in compared
        ]
        return {"file": str(data.file), "model": models, "channels": channels, "failures": failures}

    if data.as_json:
        console.print_json(content())
    else:
        print_comparison(console.stdout(), [result_view(each, with_parameters=False) for each in results])
        of_other_data = (
            f"revision {item.number} was fitted to other rows or with other import options, so its errors "
            f"here differ from its saved error, {with_unit(item.rmse, item.effort_unit)}"
            for item in saved_revisions
            if study.channel_of(item).sha256 != item.data_sha256
        )
        for words in (*of_other_data, *failures.values()):
            console.stdout().print(f"[yellow]{safe(words)}[/yellow]")

    grown = {"revision": [item.number for item in saved_revisions], "folder": data.folder}
    again = f"palpate compare {data.command_text(channel=data.channel, model=data.model, **grown)}"
    if target is not None:
        written = write_outcome(target, study, results, [again], {RESULT: json_text(content())})
        console.stderr().print(f"\nreport  [bold]{display_path(written['report'])}[/bold]")
    if not data.as_json:
        zoom = [(f"{again} --out FOLDER", "an interactive report")] if target is None else []
        stages = (f"palpate revisions {data.command_text(folder=data.folder)}", "all stages")
        first = [stages] if saved_revisions else _next_steps(data, study, results)
        console.next_steps(*first, *zoom)


def _compare_pair(data: CompareOptions) -> None:
    """Compare two studies, or two models of one; without a second revision, the first one's model is used."""
    channel, out, read = data.channel, data.out, folder_to_read(data.file, data.folder)
    files, models = (data.file, data.other or data.file), (data.model, data.other_model or data.model)
    first = data.study(models[0], read)
    second = replace(data, file=files[1]).study(models[1], None if data.other else read, first)
    saved_revisions = _chosen_revisions(first, data.revision or ())
    other_revisions = _chosen_revisions(second, data.other_revision or ()) or saved_revisions
    grown = _extended(first, saved_revisions), _extended(second, other_revisions)
    names = _names(first, second, grown)
    shared = compare_pairs(first, second, names, grown)
    pairs = [pair for pair in shared if channel in {None, ALL_CHANNELS, pair.channel}]
    if not pairs:
        available = ", ".join(pair.channel for pair in shared)
        raise InputError(f"--channel {channel}: not in both measurements. Both have: {available}")
    if all(pair.is_same_data and pair.first.model == pair.second.model for pair in pairs):
        raise InputError(
            f"{files[1]}: is the same measurement as {files[0]}, with the same model; name another file, or "
            "another model with --other-model or --other-revision. To compare the specimens of one file, use "
            "palpate batch FILE --split COLUMN"
        )
    if out is not None:
        spare_files(out, PAIR_FILES.values(), force=data.force, keep=files)
    same = files[0] == files[1]
    given: dict[str, Any] = {"revision": data.revision or [], "other-revision": data.other_revision or []}
    given["folder"] = data.folder
    is_of_base_models = same and not any(given.values())
    given["channel"] = channel
    if is_of_base_models:
        a, b = pairs[0].first, pairs[0].second
        given |= {"model": a.channel.model.name, "other-model": b.channel.model.name}
    beside = "" if same else f" {shell_path(files[1])}"
    file = shell_path(data.file)
    again = f"palpate compare {file}{beside}{data.command_text(**given).removeprefix(file)}"

    def side(study: Study, model: ComparedModel) -> ChannelView:
        return result_view(study.result(model.channel, model.effects, reason=model.reason))

    channels = [ChannelPairView(pair, (side(first, pair.first), side(second, pair.second))) for pair in pairs]
    view = PairView(names, tuple(channels), (again,))
    # The keys are stable.
    content = {"files": [str(file) for file in files], "channels": [as_data(pair) for pair in pairs]}
    console.present(content, lambda: print_pair(console.stdout(), view), as_json=data.as_json)
    if out is not None:
        with console.stderr().status("report and recording"):
            # plotting libraries take long to import
            from palpate.render.paired_report import document, record_pair  # noqa: PLC0415

            texts = {output_folder(out) / RESULT: json_text(content), out / REPORT: document(view)}
            with atomic_write_all(texts):
                record_pair(view, out / RECORDING)
        if not data.as_json:
            print_files(console.stdout(), {what: out / name for what, name in PAIR_FILES.items()})
    if not data.as_json:
        steps = [] if out is not None else [(f"{again} --out FOLDER", "curves, residuals, and a recording")]
        alone = [
            replace(data, file=path).command_text(channel=channel, model=base)
            for path, base in dict.fromkeys(zip(files, models, strict=True))
        ]
        steps += [(f"palpate compare {each}", "where its base model fails") for each in alone]
        console.next_steps(*steps)


def _next_steps(
    data: CompareOptions, study: Study, results: Sequence[ChannelResult]
) -> Iterator[tuple[str, str]]:
    """Suggest commands that follow a comparison of base models, the nearest first."""
    newest = [saved for result in results if (saved := study.newest(result.channel)) is not None]
    if newest:
        own = list(dict.fromkeys([*(data.effect or ()), *user_effects_of(newest)]))
        numbers = [revision.number for revision in newest]
        since = data.command_text(revision=numbers, folder=data.folder, effect=own)
        yield f"palpate compare {since}", "the newest model, with its added effects"
    elif data.model is None and data.urdf is None:
        for result in results:  # suggest a far better base model if the usual one does not fit
            better = far_better_model(study, result.channel, result.comparison)
            if better is not None:
                left = (
                    "compare a better base model, with an error of "
                    f"{with_unit(better[1], result.channel.effort_unit)}"
                )
                yield f"palpate compare {data.command_text(channel=data.channel, model=better[0])}", left
    again = data.command_text(channel=data.channel, model=data.model)
    yield f"palpate diagnose {again}", "which effect is missing"
