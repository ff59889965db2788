"""View of a paired comparison of two measurements or models, and its output in a terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from palpate.common.console import first_that_fits, plus_minus, safe, significant, table
from palpate.estimation.statistics.correlation import Correlation
from palpate.estimation.study.comparison import FAR
from palpate.estimation.study.paired_comparison import ComparedModel, PairedComparison, ParameterDifference
from palpate.render.terminal import safe_text
from palpate.render.view import ChannelView

LETTERS = ("A", "B")
_CHANCE = 0.05  # share of lags outside a 99 % band above which the correlation is significant
# A fit below the first [%] with an error below the second [noise levels] leaves only noise.
_POOR, _ONLY_NOISE = 80.0, 1.2
_TO_PERCENT = 100.0
_NOISE_ALONE = "only noise"  # end of the sentence on the remaining error
PAIRED = (
    "The intervals of the differences are paired: a model error that both measurements share cancels in the "
    "difference."
)


@dataclass(frozen=True)
class ChannelPairView:
    """View of one channel in both measurements."""

    sides: PairedComparison  # the comparison
    views: tuple[ChannelView, ChannelView]  # views of both sides, with measurement and model

    @property
    def words(self) -> tuple[str, ...]:
        """Result in sentences."""
        return tuple(_words(self.sides))

    @property
    def pair(self) -> tuple[ComparedModel, ComparedModel]:
        """Both sides."""
        return self.sides.first, self.sides.second

    @property
    def on_intervals(self) -> str:
        """Explain the intervals of differences."""
        if self.sides.is_same_data:
            return (
                "Both models were fitted to the same measurement, so their errors are correlated. The "
                "differences are therefore given without intervals."
            )
        if any(difference.paired_std_err is not None for difference in self.sides.differences):
            return PAIRED
        return "95 % intervals, assuming independent errors; SI units."

    @property
    def fit_columns(self) -> tuple[str, ...]:
        """Column titles of the table of fits."""
        return ("fit [%]",) if self.sides.is_same_data else ("to A [%]", "to B [%]")

    @property
    def fit_rows(self) -> list[tuple[str, tuple[str, ...]]]:
        """Rows of the table of fits: the model, and its fit to each measurement [%]."""
        rows = []
        for letter, side in zip(LETTERS, self.pair, strict=True):
            measured = (side,) if self.sides.is_same_data else self.pair
            fits = (
                _NOISE_ALONE if _is_only_noise(side, data) else _percent_text(side.fit_of(data))
                for data in measured
            )
            rows.append((f"{letter}'s model", tuple(fits)))
        if np.isfinite(self.sides.agreement_percent):
            followed = _NOISE_ALONE if self.sides.repeats else _percent_text(self.sides.agreement_percent)
            rows.append(("B as measured", (followed, _percent_text(_TO_PERCENT))))
        return rows


@dataclass(frozen=True)
class PairView:
    """View of all channels that two files share, with the commands that repeat the comparison."""

    names: tuple[str, str]
    channels: tuple[ChannelPairView, ...]
    commands: tuple[str, ...] = ()


def _words(sides: PairedComparison) -> Iterator[str]:
    pair = tuple(zip(LETTERS, (sides.first, sides.second), strict=True))
    for letter, side in pair:
        if side.compared is None:
            yield f"{letter} has no model: {side.reason}."
    if sides.repeats:
        yield "B repeats A: the two differ by no more than the noise of both."
    elif np.isfinite(sides.agreement_percent):
        yield f"B repeats A with a fit of {sides.agreement_percent:.1f} % (100 % if they are identical)."
    if sides.is_same_data:
        texts = [f"{letter}'s model {_describe_fit(side, side)}" for letter, side in pair]
        yield f"{'; '.join(texts)}."
    elif sides.first.compared is not None and sides.second.compared is not None:
        for (letter, side), (other_letter, data) in (pair, pair[::-1]):
            yield (
                f"{letter}'s model {_describe_fit(side, data)} on {other_letter}, and "
                f"{_describe_fit(side, side)} on {letter}."
            )
    compared = [(letter, side.compared) for letter, side in pair if side.compared is not None]
    far = {letter: comparison.lack_of_fit for letter, comparison in compared if comparison.lack_of_fit > FAR}
    for letter, times in far.items():
        yield (
            f"The error of {letter}'s model is {times:.1f} times the noise level, so the model's parameters "
            "may be far from the true values. Add the missing effects (palpate diagnose --apply), and "
            "compare again with --revision."
        )
    yield from _compare_parameters(sides, lacks_effects=bool(far))
    for letter, side in pair:
        for what, correlation in (
            ("autocorrelated", side.autocorrelation),
            ("correlated with the velocity", side.cross_correlation),
        ):
            if correlation.outside > _CHANCE:
                share = f"{_TO_PERCENT * correlation.outside:.0f} % of the lags are outside the 99 % band"
                yield f"{letter}'s residuals are {what}: {share}."


def _is_only_noise(model: ComparedModel, measured: ComparedModel) -> bool:
    """Return whether the measurement is close to the noise level and the model's residual is only noise.

    The fit [%] to such a measurement depends on its noise rather than on the model.
    """
    fit = model.fit_of(measured)
    return bool(fit < _POOR and model.noise_ratio_of(measured) < _ONLY_NOISE)


def _describe_fit(model: ComparedModel, measured: ComparedModel) -> str:
    if _is_only_noise(model, measured):
        return "leaves only noise"
    fit = model.fit_of(measured)
    if np.isnan(fit):
        return "has no fit"
    return f"has a fit of {fit:.1f} %" + (" (worse than a constant)" if fit < 0.0 else "")


def _compare_parameters(sides: PairedComparison, *, lacks_effects: bool) -> Iterator[str]:
    cause = ", which may come from missing effects" if lacks_effects else ""
    known = [difference for difference in sides.differences if difference.differs is not None]
    for difference in known:
        if difference.differs:
            share, first = "", difference.first
            # a share of a value that may be zero is only noise, and a coordinate's zero is arbitrary
            is_share = first is not None and (first.interval[0] > 0.0 or first.interval[1] < 0.0)
            if first is not None and is_share and not difference.is_coordinate:
                rounded = float(f"{_TO_PERCENT * difference.value / abs(first.value):.2g}")
                share = f" ({rounded:+z.6g} %)"
            size = f"{difference_text(difference)} {difference.unit}{share}"
            yield f"{difference.name} differs: {size}{cause}."
    if known and not any(difference.differs for difference in known):
        yield "No parameter differs by more than its 95 % interval."
    if any(difference.paired_std_err is not None for difference in known):
        yield PAIRED


def difference_text(difference: ParameterDifference) -> str:
    """Format a difference with half of its 95 % interval, if the interval is known."""
    if not np.isfinite(difference.value):
        return "–"
    return plus_minus(difference.value, difference.half)


def print_pair(console: Console, view: PairView) -> None:
    """Print both names, then each channel's sentences, fits and parameters."""
    for letter, name in zip(LETTERS, view.names, strict=True):
        console.print(f"[bold]{letter}[/bold]  {safe(name)}", soft_wrap=True)
    for channel in view.channels:
        models = " and ".join(dict.fromkeys(side.model for side in channel.pair))
        console.print(f"\n[bold]{safe(channel.sides.channel)}[/bold]: {safe(models)}")
        for sentence in channel.words:
            console.print(Padding(Text(safe_text(sentence)), (0, 0, 0, 2)))
        columns = [safe(name) for name in channel.fit_columns]
        fits = table("", "fit of", *columns, right=columns)
        for what, values in channel.fit_rows:
            fits.add_row(what, *values)
        console.print(fits)
        if channel.sides.differences:
            console.print(_difference_table(channel.sides.differences, console.width))


def _difference_table(differences: Sequence[ParameterDifference], width: int) -> Table:
    """Tabulate the parameters of both sides with their differences, stacked on a narrow terminal."""
    made, names = list[Table](), ("A", "B", "B − A")
    for between, narrow in (("", False), ("\n", False), ("\n", True)):
        # with a separator `between`, all numbers share one cell
        right = (between.join(names),) if between else names
        made.append(table("", "parameter", *right, *["unit"] * (not narrow), right=right))
        for difference in differences:
            values = (
                significant(each.value, each.std_err) if each else "–"
                for each in (difference.first, difference.second)
            )
            color = "yellow" if difference.differs else "default"
            numbers = (*values, f"[{color}]{difference_text(difference)}[/]")
            cells = (between.join(numbers),) if between else numbers
            effect, _, name = difference.name.rpartition(".")
            first, unit = f"[dim]{safe(effect)}.[/dim]", safe(difference.unit)
            if narrow:
                made[-1].add_row(f"{first}\n  {safe(f'{name} [{difference.unit}]')}", *cells)
            else:
                made[-1].add_row(first + safe(name), *cells, unit)
    return first_that_fits(made, width)


def _percent_text(fit: float) -> str:
    """Format a fit [%], or state that there is none."""
    return "–" if np.isnan(fit) else f"{fit:.1f}"


def as_data(sides: PairedComparison) -> dict[str, Any]:
    """Return one channel as plain data; the keys are stable.

    Args:
        sides: both sides of one channel, compared.
    """
    pair = (sides.first, sides.second)
    parameters = [
        {
            "name": difference.name,
            "unit": difference.unit,
            "sides": [
                None if side is None else {"value": side.value, "std_err": side.std_err}
                for side in (difference.first, difference.second)
            ],
            "difference": {
                "value": difference.value,
                "interval": [difference.value - difference.half, difference.value + difference.half],
                "differs": difference.differs,
                "paired": difference.paired_std_err is not None,
            },
        }
        for difference in sides.differences
    ]
    return {
        "channel": sides.channel,
        "effort_unit": sides.first.channel.effort_unit,
        "models": [side.model for side in pair],
        "reasons": [side.reason for side in pair],
        "same_data": sides.is_same_data,
        "fit_percent": {"models": sides.fit_matrix, "measured": sides.agreement_percent},
        "rmse": [None if side.compared is None else side.compared.rmse for side in pair],
        "parameters": parameters,
        "residuals": [
            {"autocorrelation": _correlation(a), "cross_correlation": _correlation(b), "step_s": side.step_s}
            for side, a, b in ((side, side.autocorrelation, side.cross_correlation) for side in pair)
        ],
    }


def _correlation(made: Correlation) -> dict[str, Any]:
    return {"lag": made.lag, "value": made.value, "band_99": made.band, "outside": made.outside}
