"""Renews the tables of docs/reference/effects.md: `.venv/bin/python docs/make_effects.py`."""

import re
from collections.abc import Iterator
from pathlib import Path

from palpate.render.effects import GROUPS, group_of, library
from palpate.sim_backend.imperfection import (
    IMPERFECTIONS,
    ContactImperfection,
    Imperfection,
    JointImperfection,
)

DOCUMENT = Path(__file__).parent / "reference" / "effects.md"


def effects() -> Iterator[str]:
    """One table of effects for each group."""
    for group in GROUPS:
        yield f"### {group}\n"
        yield "| effect | equation | signature | confused with |"
        yield "|---|---|---|---|"
        for one in library():
            if group_of(one) == group:
                rivals = ", ".join(sorted(one.confused_with)) or "-"
                yield f"| {one.name} | `{_cell(one.equation)}` | {_cell(one.signature)} | {rivals} |"
        yield ""


def hidden() -> Iterator[str]:
    """One table of all that the simulator can hide."""
    yield "| effect | in | physics | parameters (typical) |"
    yield "|---|---|---|---|"
    for name, kind in sorted(IMPERFECTIONS.items(), key=lambda pair: (_place(pair[1]), pair[0])):
        parameters = "<br>".join(f"`{p.name}` [{p.unit}] {p.low:g} to {p.high:g}" for p in kind.parameters())
        physics = _cell((kind.__doc__ or "").partition("\n")[0])
        yield f"| `{name}` | {_place(kind)} | {physics} | {parameters} |"


def _place(kind: type[Imperfection]) -> str:
    if issubclass(kind, ContactImperfection):
        return "contact"
    if issubclass(kind, JointImperfection):
        return "joint"
    return "arm" if kind.name == "gravity_tilt" else "sensor"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def renewed(text: str) -> str:
    """The document with its tables made anew, each between its two markers."""
    for name, lines in (("library", effects()), ("hidden", hidden())):
        made = f"<!-- {name} -->\n\n" + "\n".join(lines).strip() + f"\n\n<!-- end of {name} -->"
        pattern = rf"<!-- {name} -->.*?<!-- end of {name} -->"
        text = re.sub(pattern, lambda _, made=made: made, text, count=1, flags=re.DOTALL)  # type: ignore[misc]
    return text


if __name__ == "__main__":
    DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
