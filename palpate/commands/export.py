"""`palpate export`: the improved model as a simulated world."""

from pathlib import Path
from typing import Annotated

import typer

from estimation.study.revisions import own_effects
from palpate import console
from palpate.data_options import DataArguments, FolderOption, JsonOption, takes_data
from palpate.derived import folder_to_read
from palpate.export import Export
from palpate.files import output_file
from palpate.words import safe, shown, typed

SCENARIO = "scenario.yaml"


@takes_data
def command(
    data: DataArguments,
    *,
    revision: Annotated[
        list[int] | None,
        typer.Option(help="Take these revisions; default: each channel's newest of this data.", metavar="N"),
    ] = None,
    folder: FolderOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Scenario file to write.", metavar="FILE.yaml")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there already.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the fitted models of object and joints as a scenario, so that they can be probed in simulation.

    Where the simulator cannot do what was fitted, that is said, and the rest is written.
    """
    place = folder_to_read(data.file, folder)
    study = data.study(None, place)
    path = output_file(out or place / SCENARIO, force=force or out is None, keep=[data.file])
    before = len(study.revisions)
    kept = study.to_export(revision or ())
    if len(study.revisions) > before:
        remark = "nothing was added to the contact's model yet: the base model is written as it is"
        console.stderr().print(f"[yellow]{remark}[/yellow] (palpate diagnose --apply adds what is missing)")
    export = study.export(path, [one.number for one in kept])
    if as_json:
        content = {"file": str(data.file), "scenario": str(path)}
        console.print_json(content | {"used": export.used, "left_out": export.left_out})
        return
    numbers, own = [str(each.number) for each in kept], own_effects(kept)
    _print(data.typed(revision=numbers, folder=folder, effect=[*(data.effect or ()), *own]), path, export)


def _print(again: str, path: Path, export: Export) -> None:
    out = console.stdout()
    out.print(f"scenario  [bold]{shown(path)}[/bold]", soft_wrap=True)
    for line in export.used:
        out.print(f"  [green]in[/green]   {safe(line)}")
    for line in export.left_out:
        out.print(f"  [yellow]out[/yellow]  {safe(line)}")
    console.next_steps(
        (f"palpate probe --scenario {typed(path)}", "probe the model as if it were the object"),
        (f"palpate compare {again}", "where the model still fails"),
    )
