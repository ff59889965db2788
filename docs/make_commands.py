"""Writes docs/reference/commands.md from the commands' own help: `.venv/bin/python docs/make_commands.py`."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from palpate.commands import COMMANDS, load_command

DOCUMENT = Path(__file__).parent / "reference" / "commands.md"
INTRODUCTION = """# Commands

`docs/make_commands.py` generates this page from the output of `palpate COMMAND --help`.

A command ends with exit code 0 (done), 1 (failed), 2 (bad input), 3 (disk full) or 130 (Ctrl-C).
`palpate diagnose --exit-code` ends with 10, 11 or 12 for *missing*, *unexplained* or *insufficient*. With
`--json` a command prints its result, or `{"error", "exit_code"}`, as JSON ([JSON](json.md)).
`palpate --install-completion` installs completion for your shell.
"""


def document() -> str:
    """The whole page."""
    sections = (section(name, load_command(name), 2) for name in COMMANDS)
    return "\n".join([INTRODUCTION, *(line for lines in sections for line in lines)])


def section(name: str, command: Any, level: int) -> Iterator[str]:  # noqa: ANN401, typer's own click has no types
    """One command, and then the commands in it.

    Args:
        name: what is typed behind `palpate`.
        command: the loaded command or group.
        level: of the heading.
    """
    context = command.context_class(command, info_name=f"palpate {name}")
    yield f"{'#' * level} palpate {name}\n"
    yield f"{_prose(command.help)}\n"
    yield f"```\n{command.get_usage(context).removeprefix('Usage: ')}\n```\n"
    params = sorted(command.params, key=lambda param: param.param_type_name)  # arguments, then options
    records = [param.get_help_record(context) for param in params if not param.hidden]
    rows = [f"| `{_cell(left)}` | {_cell(_prose(right))} |" for left, right in filter(None, records)]
    if rows:
        yield "\n".join(["| argument or option | meaning |", "|---|---|", *rows, ""])
    for child, subcommand in getattr(command, "commands", {}).items():
        yield from section(f"{name} {child}", subcommand, level + 1)


def _prose(text: str) -> str:
    """Help without the marks of the terminal's markup, as Markdown; indented lines are code."""
    plain = re.sub(r"\[/?bold\]", "", text).replace("\\[", "[")
    parts = re.split(r"\n((?:  .+(?:\n|$))+)", plain)  # prose and code in turn
    prose = [part.replace("<", "&lt;").replace("*", "\\*") for part in parts[::2]]
    code = ["\n\n```\n" + re.sub("(?m)^  ", "", part).rstrip() + "\n```\n" for part in parts[1::2]]
    return "".join(first + second for first, second in zip(prose, [*code, ""], strict=True)).rstrip()


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    DOCUMENT.write_text(document(), encoding="utf-8")
