"""Two measurements or models side by side, as every medium shows them, and in a terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from estimation.statistics.correlation import Correlation
from estimation.study.paired_comparison import ParameterDifference, Side, Sides
from palpate.console import natural_width, table
from palpate.render.terminal import safe_text
from palpate.render.view import FAR, ChannelView
from palpate.words import safe, significant

LETTERS = ("A", "B")
_CHANCE = 0.05  # of the lags outside a 99 % band; what is above is no chance
_POOR, _ONLY_NOISE = 80.0, 1.2  # a fit [%], and an error in noise levels, that together are worth a word
_PERCENT = 100.0


@dataclass(frozen=True)
class SidesView:
    """One channel on both sides."""

    channel: str  # its name
    views: tuple[ChannelView, ChannelView]  # both, with measurement and model
    found: Sides  # what was compared
    words: tuple[str, ...]  # what comes of it, in sentences

    @property
    def pair(self) -> tuple[Side, Side]:
        """Both sides."""
        return self.found.first, self.found.second

    @property
    def fit_columns(self) -> tuple[str, ...]:
        """To which measurements fits are stated."""
        return ("fit [%]",) if self.found.is_same_data else ("to A [%]", "to B [%]")

    @property
    def fit_rows(self) -> list[tuple[str, tuple[float, ...]]]:
        """What describes, and its fit to each of these measurements [%]."""
        models = [f"{letter}'s model" for letter in LETTERS]
        (a_of_a, a_of_b), (b_of_a, b_of_b) = self.found.fits
        if self.found.is_same_data:
            return [(models[0], (a_of_a,)), (models[1], (b_of_b,))]
        rows: list[tuple[str, tuple[float, ...]]] = [
            (models[0], (a_of_a, a_of_b)),
            (models[1], (b_of_a, b_of_b)),
        ]
        if np.isfinite(self.found.followed):
            rows.append(("B as measured", (self.found.followed, _PERCENT)))
        return rows


@dataclass(frozen=True)
class PairView:
    """All channels that two files share, and the commands that lead here."""

    names: tuple[str, str]
    channels: tuple[SidesView, ...]
    commands: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Both names."""
        return f"{self.names[0]} and {self.names[1]}"


def sides_view(found: Sides, views: tuple[ChannelView, ChannelView]) -> SidesView:
    """The view of what was compared in one channel."""
    return SidesView(found.channel, views, found, tuple(_words(found)))


def _words(found: Sides) -> Iterator[str]:
    for letter, side in zip(LETTERS, (found.first, found.second), strict=True):
        if side.compared is None:
            yield f"{letter} has no model: {side.reason}."
    if np.isfinite(found.followed):
        noise = "; no more than the noise of both is between them" if found.apart < _ONLY_NOISE else ""
        yield f"B follows A to {found.followed:.1f} % over time, run by run{noise}."
    (own_a, a_of_b), (b_of_a, own_b) = found.fits
    if found.is_same_data:
        yield f"A's model describes the measurement to {own_a:.1f} %, B's to {own_b:.1f} %."
    elif np.isfinite(a_of_b) or np.isfinite(b_of_a):
        yield f"A's model describes B to {a_of_b:.1f} % (A to {own_a:.1f} %)."
        yield f"B's model describes A to {b_of_a:.1f} % (B to {own_b:.1f} %)."
    for letter, side, fit in zip(LETTERS, (found.first, found.second), (own_a, own_b), strict=True):
        if side.compared is not None and fit < _POOR and side.compared.lack_of_fit < _ONLY_NOISE:
            yield f"What {letter}'s model leaves is noise, which keeps every fit to {letter} this low."
        elif side.compared is not None and side.compared.lack_of_fit > FAR:
            yield (
                f"{letter}'s model leaves {side.compared.lack_of_fit:.1f} times its noise level, and so its "
                "parameters say little: add what is missing, and compare that (--revision)."
            )
    yield from _of_parameters(found)
    for letter, side in zip(LETTERS, (found.first, found.second), strict=True):
        for what, one in (
            ("is not white: of its autocorrelation,", side.autocorrelation),
            ("goes with the velocity: of their cross-correlation,", side.cross_correlation),
        ):
            if one.outside > _CHANCE:
                share = f"{_PERCENT * one.outside:.0f} % of the lags are outside the 99 % band"
                yield f"What {letter}'s model leaves {what} {share}."


def _of_parameters(found: Sides) -> Iterator[str]:
    told = [one for one in found.differences if one.differs is not None]
    for one in told:
        if one.differs:
            yield f"{one.name} differs: {difference_text(one)} {one.unit}{_relative(one)}."
    if told and not any(one.differs for one in told):
        yield "No parameter differs by more than its 95 % interval."


def _relative(one: ParameterDifference) -> str:
    if one.first is None or not one.first.value:
        return ""
    rounded = float(f"{_PERCENT * one.value / abs(one.first.value):.2g}")
    return f" ({rounded:+z.6g} %)"


def difference_text(one: ParameterDifference) -> str:
    """A difference with half of its 95 % interval, or as much of it as is known."""
    if not np.isfinite(one.value):
        return "–"
    half = f" ± {significant(one.half, one.half)}" if np.isfinite(one.half) else ""
    return f"{significant(one.value, one.half)}{half}"


def print_pair(console: Console, view: PairView) -> None:
    """Which is A and B, then of each channel sentences, fits and parameters."""
    for letter, name in zip(LETTERS, view.names, strict=True):
        console.print(f"[bold]{letter}[/bold]  {safe(name)}", soft_wrap=True)
    for one in view.channels:
        models = " and ".join(dict.fromkeys(side.model for side in one.pair))
        console.print(f"\n[bold]{safe(one.channel)}[/bold]: {safe(models)}")
        for sentence in one.words:
            console.print(Padding(Text(safe_text(sentence)), (0, 0, 0, 2)))
        console.print(_fit_table(one))
        if one.found.differences:
            console.print(difference_table(one.found.differences, console.width))


def _fit_table(view: SidesView) -> Table:
    columns = [safe(name) for name in view.fit_columns]
    made = table("", "fit of", *columns, right=columns)
    for what, fits in view.fit_rows:
        made.add_row(what, *map(percent_text, fits))
    return made


def difference_table(differences: Sequence[ParameterDifference], width: int) -> Table:
    """Each parameter on both sides, and by how much it differs; below each other where columns are few."""
    names = ("A", "B", "B − A")
    beside = _table_of_differences(differences, names)
    below = _table_of_differences(differences, names, "\n")
    narrow = _table_of_differences(differences, names, "\n", narrow=True)
    return next((one for one in (beside, below) if natural_width(one) <= width), narrow)


def _table_of_differences(
    differences: Sequence[ParameterDifference],
    names: tuple[str, ...],
    between: str = "",
    *,
    narrow: bool = False,
) -> Table:
    """One row a parameter; with something `between`, its numbers are in one cell; narrow, its unit is not."""
    right = (between.join(names),) if between else names
    made = table("", "parameter", *right, *["unit"] * (not narrow), right=right)
    for one in differences:
        values = (significant(each.value, each.std_err) if each else "–" for each in (one.first, one.second))
        color = "yellow" if one.differs else "default"
        numbers = (*values, f"[{color}]{difference_text(one)}[/]")
        cells = (between.join(numbers),) if between else numbers
        effect, _, name = one.name.rpartition(".")
        first, unit = f"[dim]{safe(effect)}.[/dim]", safe(one.unit)
        if narrow:
            made.add_row(f"{first}\n  {safe(f'{name} [{one.unit}]')}", *cells)
        else:
            made.add_row(first + safe(name), *cells, unit)
    return made


def percent_text(fit: float) -> str:
    """A fit, or that there is none."""
    return "–" if np.isnan(fit) else f"{fit:.1f}"


def as_data(found: Sides) -> dict[str, Any]:
    """One channel as plain data; the keys are stable."""
    pair = (found.first, found.second)
    return {
        "channel": found.channel,
        "effort_unit": found.first.channel.effort_unit,
        "models": [side.model for side in pair],
        "reasons": [side.reason for side in pair],
        "same_data": found.is_same_data,
        "fit_percent": {"models": found.fits, "measured": found.followed},
        "rmse": [None if side.compared is None else side.compared.rmse for side in pair],
        "parameters": [_difference_data(one) for one in found.differences],
        "residuals": [
            {
                "autocorrelation": _correlation(a),
                "cross_correlation": _correlation(b),
                "step_s": side.step_s,
            }
            for side, a, b in ((side, side.autocorrelation, side.cross_correlation) for side in pair)
        ],
    }


def _difference_data(one: ParameterDifference) -> dict[str, Any]:
    sides = [
        None if each is None else {"value": each.value, "std_err": each.std_err}
        for each in (one.first, one.second)
    ]
    interval = [one.value - one.half, one.value + one.half]
    difference = {"value": one.value, "interval": interval, "differs": one.differs}
    return {"name": one.name, "unit": one.unit, "sides": sides, "difference": difference}


def _correlation(one: Correlation) -> dict[str, Any]:
    return {"lag": one.lag, "value": one.value, "band_99": one.band, "outside": one.outside}
