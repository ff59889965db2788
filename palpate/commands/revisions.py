"""`palpate revisions`: the stages of a session's models, to go back to."""

from estimation.study import Revisions
from estimation.study.revisions import own_effects
from palpate.common import console
from palpate.common.files import existing_data
from palpate.common.output_paths import folder_to_read
from palpate.render.terminal import print_revisions
from palpate.workflows.data_options import DataArguments, FolderOption, JsonOption, takes_data


@takes_data
def command(data: DataArguments, as_json: JsonOption = False, folder: FolderOption = None) -> None:
    """List the stages of a session's models: what was added to what, and how large the error was then.

    Options for reading a data file are taken as well, so that a command can be edited into another one.
    """
    existing_data(data.file)
    revisions = Revisions(folder_to_read(data.file, folder)).all()
    if as_json:
        kept = [revision.model_dump(mode="json") for revision in revisions]
        console.print_json({"file": str(data.file), "revisions": kept})
        return
    if not revisions:
        console.stdout().print("no revisions yet: nothing was added to a model")
        console.next_steps((f"palpate diagnose {data.typed()} --apply", "find what is missing, and add it"))
        return
    print_revisions(console.stdout(), revisions)
    first, newest = revisions[0], {revision.channel: revision for revision in revisions}
    added = data.typed(out=folder, effect=own_effects([first]))
    last = {"revision": [str(revision.number) for revision in newest.values()], "folder": folder}
    compared = data.typed(**last, effect=own_effects(list(newest.values())))
    console.next_steps(
        (f"palpate add {added} EFFECT --from {first.number}", "go back to a revision, and continue there"),
        (f"palpate compare {compared}", "where the newest still fail"),
        (f"palpate export {data.typed(**last)}", "as a simulated world"),
    )
