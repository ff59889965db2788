"""`palpate reveal`: what was hidden in a simulated session?"""

from pathlib import Path
from typing import Annotated, Any

import typer

from estimation.effects import EFFECTS
from palpate.common import console
from palpate.common.files import open_session
from palpate.common.formatting import shown, significant, typed
from palpate.runs.hidden_effects import open_answer, was_sealed
from sim_backend.hidden import SealedAnswer
from sim_backend.imperfection import Imperfection


def command(
    session: Annotated[Path, typer.Argument(help="Session file (.mcap) that was probed with --hidden.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")] = False,
) -> None:
    """Open the sealed answer beside a session: which effects were hidden, where, and how strong."""
    found = open_session(session)
    answer = open_answer(found) if was_sealed(found) else SealedAnswer((), None, found.metadata.created_utc)
    if as_json:
        console.print_json(describe(session, answer))
    elif answer.hidden:
        table = console.table(f"Hidden in {shown(session)}", "effect", "shows in", "parameters", "physics")
        for entry in answer.hidden:
            values = (
                f"{name} = {significant(about['value'])} {about['unit']}"
                for name, about in _parameters(entry).items()
            )
            physics = (entry.__doc__ or "").partition("\n")[0]
            table.add_row(f"[bold]{entry.name}[/bold]", ", ".join(entry.channels), "\n".join(values), physics)
        console.stdout().print(table)
        known = [entry.name for entry in answer.hidden if entry.name in EFFECTS]
        diagnosed = (f"palpate diagnose {typed(session)}", "whether that is found")
        console.next_steps(*((f"palpate effects {name}", "what that is") for name in known[:1]), diagnosed)
    else:
        said = f"nothing is sealed beside {shown(session)}: nothing was hidden with palpate probe --hidden"
        console.stdout().print(said, soft_wrap=True)
        console.next_steps(("palpate probe --hidden random -o secret.mcap", "hide something"))


def describe(session: Path, answer: SealedAnswer) -> dict[str, Any]:
    """The answer as plain data; the keys are stable."""
    return {
        "session": str(session),
        "seed": answer.seed,
        "hidden": [
            {"effect": entry.name, "channels": entry.channels, "parameters": _parameters(entry)}
            for entry in answer.hidden
        ],
    }


def _parameters(entry: Imperfection) -> dict[str, dict[str, Any]]:
    return {name: {"value": value, "unit": unit} for name, (value, unit) in entry.values().items()}
