"""`palpate compare`: where does the model fail?"""

from pathlib import Path
from typing import Annotated

import typer

from estimation.comparison import Comparison
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
from palpate.findings.estimation_run import load_material
from palpate.findings.story import compare_subject, tell_story
from palpate.findings.subject import (
    ALL_CHANNELS,
    Subject,
    channels_to_diagnose,
    model_names,
    only_channel,
    subjects_of,
)
from palpate.report.outcome import NAMES as OUTCOME
from palpate.report.outcome import write_json, write_outcome
from palpate.text.comparison import ALIKE, as_data, headline, parts_table
from palpate.words import safe, shown
from robot_io.errors import InputError

RESULT = "comparison.json"


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    model: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(MODELS)}; default: what suits each channel.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Only this channel, such as contact.")] = None,
    urdf: UrdfOption = None,
    tip_frame: TipFrameOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Write comparison.json and an HTML report here.", metavar="FOLDER")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Put a model beside the measurement: how far off it is, and where it fails first.

    All errors are on runs that the fit has not seen; the noise floor is what a complete model would leave.
    """
    material = load_material(file, import_options(column, unit, where, context, fresh_runs))
    found = subjects_of(material, model, given_arm(urdf, tip_frame, material.arm))
    subjects = only_channel(found, channel)
    folder = folder_to_fill(material, out, (RESULT, *OUTCOME), force=force) if out is not None else None
    given = {"column": column, "unit": unit, "where": where, "context": context, "fresh-runs": fresh_runs}
    judged_by = {"model": model, "urdf": urdf, "tip-frame": tip_frame}
    typed = retyped(file, channel=channel, **judged_by, **given)
    if folder is not None:
        output_folder(folder)
    compared, failures = _compare(subjects)
    data: dict[str, object] = {
        "file": str(file),
        "model": model_names(subjects),
        "channels": [as_data(comparison) for comparison in compared],
        "failures": failures,
    }
    if as_json:
        console.print_json(data)
    else:
        _print(compared, failures)
    if folder is not None:
        write_json(data, folder / RESULT)
        judged = [subject for subject in subjects if subject.channel.name not in failures]
        stories = [tell_story(subject, None, (), ()) for subject in judged]
        written = write_outcome(folder, material, stories, [f"palpate compare {typed}"])
        console.stderr().print(f"\nreport  [bold]{shown(written['report'])}[/bold]")
    if not as_json:
        console.next_steps(
            (f"palpate diagnose {typed}{_where(subjects, compared, channel)}", "which effect is missing"),
            (f"palpate compare {typed} --out FOLDER", "a report to zoom into"),
        )


def _compare(subjects: tuple[Subject, ...]) -> tuple[list[Comparison], dict[str, str]]:
    """Compare each; channels that cannot be judged are told with their reason.

    Raises:
        InputError: none can be judged.
    """
    compared, failures = [], {}
    with console.stderr().status("comparing") as status:
        for subject in subjects:
            status.update(f"comparing {subject.channel.name}")
            try:
                compared.append(compare_subject(subject))
            except InputError as error:
                failures[subject.channel.name] = str(error)
    if not compared:
        raise InputError(next(iter(failures.values())))
    return compared, failures


def _where(subjects: tuple[Subject, ...], compared: list[Comparison], channel: str | None) -> str:
    """The option without which `diagnose` would not judge a channel that the model misses."""
    judged = {subject.channel.name for subject in channels_to_diagnose(subjects, None)}
    missed = [comparison.channel for comparison in compared if comparison.lack_of_fit >= ALIKE]
    if channel is not None or judged.issuperset(missed):
        return ""
    return f" --channel {missed[0] if len(missed) == 1 else ALL_CHANNELS}"


def _print(compared: list[Comparison], failures: dict[str, str]) -> None:
    out = console.stdout()
    for number, comparison in enumerate(compared):
        out.print(("\n" if number else "") + headline(comparison))
        for words in comparison.words[1:] if comparison.lack_of_fit > ALIKE else ():
            out.print(f"  {words}")
        if comparison.lack_of_fit > ALIKE or len(compared) == 1:
            out.print(parts_table(comparison))
    for reason in failures.values():
        out.print(f"[yellow]{safe(reason)}[/yellow]")
