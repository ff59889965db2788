"""A comparison in words, as a table for people and as plain data for programs."""

from typing import Any

from rich.table import Table

from estimation.comparison import Comparison, Part
from palpate import console
from palpate.text.bars import Bar

ALIKE = 1.1  # times the noise floor, below which an error passes for noise


def headline(comparison: Comparison) -> str:
    """One line: the channel, the error, and how many times the floor that is."""
    unit, times = comparison.effort_unit, comparison.lack_of_fit
    color, word = (
        ("green", "fits") if times < ALIKE else ("yellow", "misses") if times < 3 else ("red", "misses")
    )
    error, floor = f"{comparison.rmse:.3g} {unit}", f"{comparison.floor.value:.3g} {unit}"
    far = "" if times < ALIKE else f": [bold]{times:.1f} times the floor[/bold]"
    judged = f"[bold {color}]{comparison.model} {word}[/bold {color}] [bold]{comparison.channel}[/bold]"
    return f"{judged}, {error} in held-out runs, noise floor {floor}{far}"


def parts_table(comparison: Comparison) -> Table:
    """The error part by part, each beside the noise floor."""
    unit = comparison.effort_unit
    numbers = (f"rmse\n[{unit}]", f"mean\n[{unit}]", "x floor")
    shown = console.table("", "by", "where", *numbers, "", right=numbers)
    worst = max((part.rmse for parts in comparison.parts.values() for part in parts), default=1.0)
    for by, parts in comparison.parts.items():
        for number, part in enumerate(parts):
            bold = part is max(parts, key=lambda p: p.rmse) and part.excess > ALIKE
            label = f"[bold]{part.label}[/bold]" if bold else part.label
            shown.add_row(
                f"[dim]{by}[/dim]" if number == 0 else "",
                label,
                f"{part.rmse:.3g}",
                f"{part.mean:+.2g}",
                f"{part.excess:.1f}",
                Bar(part.rmse / worst, _color(part.excess)),
                end_section=number == len(parts) - 1,
            )
    return shown


def as_data(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain data; the keys are stable."""
    return {
        "channel": comparison.channel,
        "model": comparison.model,
        "effort_unit": comparison.effort_unit,
        "rmse": comparison.rmse,
        "noise_floor": comparison.floor.value,
        "floor": vars(comparison.floor),
        "lack_of_fit": comparison.lack_of_fit,
        "parameters": dict(comparison.parameters),
        "parts": {by: [_part_data(part) for part in parts] for by, parts in comparison.parts.items()},
        "words": list(comparison.words),
    }


def _color(excess: float) -> str:
    return "green" if excess < ALIKE else "yellow" if excess < 3 else "red"


def _part_data(part: Part) -> dict[str, Any]:
    return vars(part)
