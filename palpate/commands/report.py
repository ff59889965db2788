"""`palpate report`: all that is known of a measurement, as one HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.common import console
from palpate.common.files import output_file
from palpate.common.formatting import shown
from palpate.common.output_paths import folder_to_read
from palpate.render.build import REPORT, is_own_page
from palpate.workflows.data_options import DataArguments, FolderOption, JsonOption, ModelOption, takes_data


@takes_data
def command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    folder: FolderOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Page to write.", metavar="FILE.html")] = Path(
        REPORT
    ),
    force: Annotated[bool, typer.Option("--force", help="Replace what is no page of palpate.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write measurement, models, what was found missing and what was added as one page that needs no network.

    palpate report press.csv -o press.html
    """
    path = output_file(out, force=force or is_own_page(out), keep=[data.file])
    study = data.study(model, folder_to_read(data.file, folder))
    with console.stderr().status("fitting and drawing"):
        study.report(path, [f"palpate report {data.typed(model=model, folder=folder)}"])
    if as_json:
        console.print_json({"file": str(data.file), "report": str(path)})
        return
    console.stdout().print(f"report  [bold]{shown(path)}[/bold]", soft_wrap=True)
    console.next_steps(
        (f"palpate workbench {data.typed()}", "the same on a local page, with effects to tick")
    )
