"""`palpate revisions`: the stages of a session's models, to go back to."""

from typing import Annotated

import typer

from estimation.data.channels import is_session
from palpate import console
from palpate.data_options import (
    ColumnOption,
    ContextOption,
    FileArgument,
    FolderOption,
    FreshOption,
    UnitOption,
    WhereOption,
    retyped,
)
from palpate.files import existing_file
from palpate.findings.derived import kept_revisions
from palpate.findings.estimation_run import NO_ARM, Material
from palpate.findings.kept_revision import own_effects
from palpate.render.build import revision_rows
from palpate.render.terminal import print_revisions
from robot_io.session import Session


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print all revisions as JSON.")] = False,
    folder: FolderOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
) -> None:
    """List the stages of a session's models: what was added to what, and how large the error was then.

    Options for reading a data file are taken as well, so that a command can be edited into another one.
    """
    data = {"column": column, "unit": unit, "where": where, "context": context, "fresh-runs": fresh_runs}
    existing_file(file, "session or data file")
    session = Session.open(file) if is_session(file) else None
    material = Material(file, session, (), {}, NO_ARM)
    revisions = kept_revisions(material, folder).all()
    if as_json:
        kept = [revision.model_dump(mode="json") for revision in revisions]
        console.print_json({"file": str(file), "revisions": kept})
        return
    if not revisions:
        console.stdout().print("no revisions yet: nothing was added to a model")
        console.next_steps(
            (f"palpate diagnose {retyped(file, **data)} --apply", "find what is missing, and add it")
        )
        return
    print_revisions(console.stdout(), revision_rows(revisions))
    first, newest = revisions[0], {revision.channel: revision for revision in revisions}
    added = retyped(file, out=folder, effect=own_effects([first]), **data)
    last = {"revision": [str(revision.number) for revision in newest.values()], "folder": folder}
    compared = retyped(file, **last, effect=own_effects(newest.values()), **data)
    console.next_steps(
        (f"palpate add {added} EFFECT --from {first.number}", "go back to a revision, and continue there"),
        (f"palpate compare {compared}", "where the newest still fail"),
        (f"palpate export {retyped(file, **last, **data)}", "as a simulated world"),
    )
