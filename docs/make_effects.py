"""Renews the tables of docs/effects.md from the registries: `.venv/bin/python docs/make_effects.py`."""

import re
from collections.abc import Iterator
from pathlib import Path

from estimation.channel import ChannelKind
from estimation.effect import Effect, SensorEffect
from estimation.effects import EFFECTS
from estimation.effects.run_variation import RunVariation
from sim_backend.imperfection import (
    IMPERFECTIONS,
    ContactImperfection,
    Imperfection,
    JointImperfection,
)

DOCUMENT = Path(__file__).parent / "effects.md"
GROUPS = ("Contact", "Joints", "Contact and joints", "Sensor and drive readings", "From run to run")


def library() -> Iterator[str]:
    """One table of effects for each group."""
    for group in GROUPS:
        yield f"### {group}\n"
        yield "| effect | equation | what one sees | confused with |"
        yield "|---|---|---|---|"
        for name, effect in sorted(EFFECTS.items()):
            if _group(effect) == group:
                rivals = ", ".join(sorted(effect.confused_with)) or "-"
                yield f"| {name} | `{_cell(effect.equation)}` | {_cell(effect.signature)} | {rivals} |"
        yield ""


def _group(effect: type[Effect]) -> str:
    if issubclass(effect, RunVariation):
        return "From run to run"
    if issubclass(effect, SensorEffect) or effect.name in {"bias", "drift"}:
        return "Sensor and drive readings"
    if ChannelKind.CONTACT not in effect.channels:
        return "Joints"
    return "Contact" if effect.channels == {ChannelKind.CONTACT} else "Contact and joints"


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
    for name, lines in (("library", library()), ("hidden", hidden())):
        made = f"<!-- {name} -->\n\n" + "\n".join(lines).strip() + f"\n\n<!-- end of {name} -->"
        pattern = rf"<!-- {name} -->.*?<!-- end of {name} -->"
        text = re.sub(pattern, lambda _, made=made: made, text, count=1, flags=re.DOTALL)  # type: ignore[misc]
    return text


if __name__ == "__main__":
    DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
