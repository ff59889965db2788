"""`palpate revisions`: the stages of a session's models, to go back to."""

from pathlib import Path
from typing import Annotated

import typer

from estimation.data.channels import is_session
from palpate import console
from palpate.data_options import FileArgument
from palpate.derived import derived_folder
from palpate.estimation_run import NO_ARM, Material
from palpate.files import existing_file
from palpate.revisions import RevisionShelf
from palpate.stage_text import revision_table
from palpate.words import shown
from robot_io.session import Session


def command(
    file: FileArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print all revisions as JSON.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Where they are kept, if not in the usual place.", metavar="FOLDER")
    ] = None,
) -> None:
    """List the stages of a session's models: what was added to what, and how large the error was then."""
    existing_file(file, "session or data file")
    session = Session.open(file) if is_session(file) else None
    material = Material(file, session, (), {}, NO_ARM)
    revisions = RevisionShelf(derived_folder(material, out)).all()
    if as_json:
        kept = [revision.model_dump(mode="json") for revision in revisions]
        console.print_json({"file": str(file), "revisions": kept})
        return
    if not revisions:
        console.stdout().print("no revisions yet: nothing was added to a model")
        console.next_steps((f"palpate diagnose {shown(file)} --apply", "find what is missing, and add it"))
        return
    console.stdout().print(revision_table(revisions))
    number = revisions[0].number
    console.next_steps(
        (f"palpate add {shown(file)} EFFECT --from {number}", "go back to a revision, and continue there"),
        (
            f"palpate export {shown(file)} --revision {revisions[-1].number}",
            "as a simulated world",
        ),
    )
