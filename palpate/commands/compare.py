"""`palpate compare`: where does the model fail?"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from estimation.study import ChannelResult, Comparison, Revision
from estimation.study.model_suggestions import FAR_BETTER, better_model
from estimation.study.revisions import own_effects
from palpate.common import console
from palpate.common.files import output_folder, spare_files
from palpate.common.formatting import safe, shown, typed
from palpate.common.options import model_names
from palpate.common.output_paths import folder_to_fill, folder_to_read
from palpate.render.build import NAMES, view_of, write_outcome
from palpate.render.build import as_json as json_text
from palpate.render.paired import print_pair
from palpate.render.terminal import print_comparison, print_files
from palpate.render.view import FAR
from palpate.study import Study
from palpate.workflows.data_options import (
    DataArguments,
    FolderOption,
    ForceOption,
    JsonOption,
    ModelOption,
    takes_data,
)
from palpate.workflows.paired_comparison import NAMES as SIDES
from palpate.workflows.paired_comparison import ComparedPair, chosen_revisions, write_pair
from robot_io.errors import InputError

RESULT = "comparison.json"
Steps = list[tuple[str, str]]


@takes_data
def command(
    data: DataArguments,
    *,
    other: Annotated[
        Path | None,
        typer.Argument(help="Another one, to put beside it: a twin, before and after, two specimens."),
    ] = None,
    model: ModelOption = None,
    other_model: Annotated[
        str | None,
        typer.Option(
            help="Base model of the other; without another, two models of FILE.", autocompletion=model_names
        ),
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Only this channel, such as contact.")] = None,
    revision: Annotated[
        list[int] | None,
        typer.Option(help="What was added, instead of the base model (palpate revisions).", metavar="N"),
    ] = None,
    other_revision: Annotated[
        list[int] | None,
        typer.Option(help="That of the other; without it, the same model is fitted to both.", metavar="N"),
    ] = None,
    folder: FolderOption = None,
    as_json: JsonOption = False,
    out: Annotated[
        Path | None, typer.Option(help="Write comparison.json and an HTML report here.", metavar="FOLDER")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Put a model beside the measurement: how far off it is, and where it fails first.

    The base model, whatever was added; --revision shows that. All errors are on runs that the fit has not
    seen; the noise level is what a complete model would leave.

    With OTHER, two measurements side by side: how far each follows the other and each model describes the
    other (fit in %), how parameters differ, and what each model leaves.

    Examples: palpate compare a.mcap; palpate compare before.csv after.csv --out there; palpate compare a.mcap
    --model kelvin_voigt --other-model hunt_crossley
    """
    named = {"--model": model, "--other-model": other_model, "--channel": channel}
    if (revision or other_revision) and (given := [name for name, value in named.items() if value]):
        raise InputError(f"--revision says channel and model already: leave out {given[0]}")
    read = folder_to_read(data.file, folder)
    if other is not None or other_model is not None or other_revision:
        revisions = {"revision": revision, "other-revision": other_revision}
        numbers = revision or (), other_revision or ()
        pair = ComparedPair(data, other, (model, other_model), channel, revisions=numbers, folder=read)
        typed_too = {name: [str(one) for one in given or ()] for name, given in revisions.items()}
        _side_by_side(data, pair, {**typed_too, "folder": folder}, out, as_json=as_json, force=force)
        return
    study = data.study(model, read)
    kept = chosen_revisions(study, revision or ())
    target = folder_to_fill(data.file, out, (RESULT, *NAMES), force=force) if out is not None else None
    if target is not None:
        output_folder(target)
    with console.stderr().status("comparing"):
        results, failures = _of_revisions(study, kept) if kept else _of_base_models(study, channel)
    compared = [result.shown for result in results if result.shown is not None]
    models = "+".join(dict.fromkeys(result.channel.model.name for result in results))
    channels = list(map(as_data, compared))
    content = {"file": str(data.file), "model": models, "channels": channels, "failures": failures}
    if as_json:
        console.print_json(content)
    else:
        print_comparison(console.stdout(), view_of(study, results))
        for words in (*_of_other_data(study, kept), *failures.values()):
            console.stdout().print(f"[yellow]{safe(words)}[/yellow]")
    grown = {"revision": [str(one.number) for one in kept], "folder": folder}
    again = f"palpate compare {data.typed(channel=channel, model=model, **grown)}"
    if target is not None:
        written = write_outcome(target, study, results, [again], {RESULT: json_text(content)})
        console.stderr().print(f"\nreport  [bold]{shown(written['report'])}[/bold]")
    if not as_json:
        zoom = (f"{again} --out FOLDER", "a report to zoom into")
        stages = [(f"palpate revisions {data.typed(folder=folder)}", "all stages")]
        first = stages if kept else _after(data, study, results, model, channel, folder)
        console.next_steps(*first, zoom)


def _side_by_side(
    data: DataArguments,
    pair: ComparedPair,
    given: dict[str, list[str] | Path | None],
    out: Path | None,
    *,
    as_json: bool,
    force: bool,
) -> None:
    """Print two sides, and write them where that was asked; `given` are the options that chose them."""
    if out is not None:
        spare_files(out, SIDES, force=force, keep=pair.files)
    same = pair.files[0] == pair.files[1]
    first, second = pair.sides[0].first, pair.sides[0].second
    if same and not any(given.values()):
        given |= {"model": [first.channel.model.name], "other-model": [second.channel.model.name]}
    beside = "" if same else f" {typed(pair.files[1])}"
    again = f"palpate compare {typed(data.file)}{beside}{data.typed(**given).removeprefix(typed(data.file))}"
    view = pair.view([again])
    if as_json:
        console.print_json(pair.as_data())
    else:
        print_pair(console.stdout(), view)
    if out is not None:
        with console.stderr().status("report and recording"):
            written = write_pair(out, pair, view)
        if not as_json:
            print_files(console.stdout(), written)
    if not as_json:
        steps = [] if out is not None else [(f"{again} --out FOLDER", "curves, residuals, and a recording")]
        files = dict.fromkeys(pair.files)
        each = [(f"palpate compare {typed(file)}", "where its base model fails") for file in files]
        console.next_steps(*steps, *each)


def as_data(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain data; the keys are stable."""
    return {
        "channel": comparison.channel,
        "model": comparison.model,
        "effort_unit": comparison.effort_unit,
        "rmse": comparison.rmse,
        "noise_floor": comparison.noise.value,
        "noise_source": comparison.noise.source,
        "noise_at_most": comparison.noise.is_bound,
        "lack_of_fit": comparison.lack_of_fit,
        "parameters": {name: parameter.value for name, parameter in comparison.parameters.items()},
        "parts": {by: list(map(vars, parts)) for by, parts in comparison.parts.items()},
        "words": list(comparison.words),
        "patterns": list(map(vars, comparison.patterns)),
        "kinds": list(map(vars, comparison.kinds)),
        "not_judged": comparison.not_judged,
    }


def _of_base_models(study: Study, channel: str | None) -> tuple[list[ChannelResult], dict[str, str]]:
    found = study.compare(channel)
    return [study.result(study.channel(channel.channel)) for channel in found.channels], dict(found.failures)


def _of_revisions(study: Study, kept: Sequence[Revision]) -> tuple[list[ChannelResult], dict[str, str]]:
    return [study.result(study.channel_of(one), one.effects) for one in kept], {}


def _of_other_data(study: Study, kept: Sequence[Revision]) -> Iterator[str]:
    for one in kept:
        if study.channel_of(one).sha256 != one.data_sha256:
            error = f"{one.rmse:.3g} {one.effort_unit}"
            yield f"revision {one.number} was kept with an error of {error}: of other rows, or read otherwise"


def _after(  # noqa: PLR0917, what was typed
    data: DataArguments,
    study: Study,
    results: Sequence[ChannelResult],
    model: str | None,
    channel: str | None,
    folder: Path | None,
) -> Steps:
    """Commands that go on from a comparison of base models; the nearest first."""
    steps: Steps = []
    newest = [kept for result in results if (kept := study.newest(result.channel)) is not None]
    if newest:
        own = list(dict.fromkeys([*(data.effect or ()), *own_effects(newest)]))
        numbers = [str(one.number) for one in newest]
        since = data.typed(revision=numbers, folder=folder, effect=own)
        steps.append((f"palpate compare {since}", "with what was added since"))
    elif model is None and data.urdf is None:
        steps += _other_models(data, study, results, channel)
    missing = f"palpate diagnose {data.typed(channel=channel, model=model)}"
    return [*steps, (missing, "which effect is missing")]


def _other_models(
    data: DataArguments, study: Study, results: Sequence[ChannelResult], channel: str | None
) -> Iterator[tuple[str, str]]:
    """Commands with a base model that does far better, where the usual one misses by far."""
    for result in results:
        if result.comparison is None or result.comparison.lack_of_fit < FAR:
            continue
        better = better_model(study, result.channel, FAR_BETTER * result.comparison.rmse)
        if better is not None:
            left = f"{better[1]:.3g} {result.channel.effort_unit}"
            typed = data.typed(channel=channel, model=better[0])
            yield f"palpate compare {typed}", f"a base model that leaves {left}"
