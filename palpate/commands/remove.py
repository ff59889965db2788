"""`palpate remove`: take an effect out of the newest model again."""

from typing import Annotated

import typer

from palpate.common import console
from palpate.common.options import effect_names
from palpate.common.output_paths import folder_to_read
from palpate.render.build import result_view
from palpate.render.terminal import print_stages
from palpate.workflows.data_options import DataArguments, FolderOption, JsonOption, ModelOption, takes_data


@takes_data
def command(
    data: DataArguments,
    *,
    effect_name: Annotated[
        str, typer.Argument(help="Effect to take out.", metavar="EFFECT", autocompletion=effect_names)
    ],
    model: ModelOption = None,
    channel: Annotated[str | None, typer.Option(help="Where, such as joint_2.")] = None,
    folder: FolderOption = None,
    as_json: JsonOption = False,
) -> None:
    """Refit the newest model without one of the effects that were added, and keep that as a revision.

    palpate remove press.csv bias
    """
    study = data.study(model, folder_to_read(data.file, folder))
    change = study.remove(effect_name, channel)
    if as_json:
        kept = [revision.model_dump(mode="json") for revision in change.revisions]
        name = change.result.channel.name
        console.print_json({"file": str(data.file), "channel": name, "revisions": kept})
        return
    print_stages(console.stdout(), result_view(change.result))
    console.next_steps((f"palpate revisions {data.typed(folder=folder)}", "all stages, to go back to"))
