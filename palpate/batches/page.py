"""Page of a batch: missing effects, distributions, pooled model, differences and outliers."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import plotly.graph_objects as go
import pyarrow as pa
from markupsafe import Markup

from palpate.batches.pooling import BatchResult
from palpate.batches.table import BUDGET, floats, parameter_columns, texts
from palpate.batches.trend import Series, TrendChange, least_for_step
from palpate.common.console import as_shell_word, count, duration, format_computed_p_value, significant
from palpate.common.files import write_text
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.kinds import Kind
from palpate.render import palette
from palpate.render.report import as_html, rendered, styled
from palpate.render.thinning import even_places

_TEMPLATE = Path(__file__).parent / "page.html"
_MOST_ROWS = 300  # rows of the table on the page, besides outliers and errors
_MOST_POINTS = 400  # points of one parameter in one group
_MOST_FIGURES = 12
_MOST_SERIES = 60  # series on the page of a trend
_MOST_EFFECTS = 4
_SIGNIFICANT = 0.05
_COLORS = {kind.word: palette.KINDS[kind] for kind in Kind} | {
    "noise": palette.NOISE,
    "unexplained": palette.UNEXPLAINED,
}
_ALREADY = ("measurement", "group", "channel", "model", "verdict", "effects", "times_noise")


@dataclass(frozen=True)
class PageSection:
    """A part of the page."""

    title: str  # heading
    columns: tuple[str, ...] = ()  # heads of its table
    rows: Sequence[Sequence[Any]] = ()  # cells
    figure: Markup | None = None  # above the table
    words: tuple[str, ...] = ()  # below it
    anchors: Sequence[int] = field(default_factory=tuple)  # row of the batch's table that each row shows


def write_page(batch: BatchResult) -> None:
    """Write the page of a batch.

    Args:
        batch: result with its table, pooled parameters, differences and outliers.

    Raises:
        InputError: the page cannot be written.
    """
    names, files = texts(batch.table, "measurement"), texts(batch.table, "files")
    # the channels of a measurement state the same time
    spent = dict(zip(names, floats(batch.table, "seconds"), strict=True))
    facts = {
        "measurements": f"{batch.finished:,} of {batch.measurements:,} done",
        "unreadable": f"{len(batch.errors):,}",
        "processor time": duration(float(np.nansum(list(spent.values())))),
    }
    outliers = []
    for entry in sorted(batch.outliers, key=lambda entry: -abs(entry.z))[:_MOST_ROWS]:
        name, report = names[entry.row], ""
        if name in batch.reports:
            report = Markup('<a href="{}">report</a>').format(quote(batch.reports[name]))
        else:  # the command that writes it
            where = batch.where.get(name, {}).items()
            options = [f"--where {as_shell_word(f'{key}={text}')}" for key, text in where]
            report = " ".join(["palpate report", *map(as_shell_word, files[entry.row].split("; ")), *options])
        place = Markup('<a href="#row-{}">{}</a>').format(entry.row, name)
        value = f"{significant(entry.value)} {entry.unit}"
        outliers.append((place, entry.parameter, value, f"{entry.z:+.1f}", report))
    about_outliers = (
        "These values are far from the median of their group. Only 1 % of normally distributed groups of "
        "this size contain a value as far from the median. z is the distance from the median, divided by a "
        "scale that combines the median absolute deviation (times 1.48) and the value's standard error.",
    )
    errors = list(batch.errors.items())[:_MOST_ROWS]
    # the first rows of the table and the rows of outliers, in few columns
    outlying = sorted({entry.row for entry in batch.outliers})[:_MOST_ROWS]
    places = sorted({*range(min(len(batch.table), _MOST_ROWS)), *outlying})
    shown = batch.table.take(pa.array(places, pa.int64()))
    heads = [column.head for column in parameter_columns(batch.table)]
    columns = [name for name in (*_ALREADY, *dict.fromkeys(heads)) if name in shown.column_names]
    cells = {name: texts(shown, name) for name in columns}
    for name in columns:
        if pa.types.is_floating(shown.schema.field(name).type):
            cells[name] = [
                "" if value is None else f"{value:.4g}" if np.isfinite(value) else "–"
                for value in shown[name].to_pylist()
            ]
    lines = list(zip(*cells.values(), strict=True))
    words = (f"{len(places):,} of {len(batch.table):,} rows.",) if len(places) < len(batch.table) else ()
    sections = [
        _overview(batch),
        _entry_section(batch.common_effects, _COMMON),
        _distributions(batch),
        _entry_section(batch.pooled, _POOLED),
        _entry_section(batch.shared, _SHARED),
        _entry_section(sorted(batch.differences, key=lambda entry: entry.p_corrected), _DIFFERENCES),
        PageSection("Outliers", _OUTLIER, outliers, words=about_outliers),
        PageSection("Measurements that could not be evaluated", ("measurement", "reason"), errors),
        PageSection("Measurements", tuple(columns), lines, words=words, anchors=places),
    ]
    _write(batch.page, f"Batch {batch.folder.name}", facts, sections)


def write_trend(path: Path, tested: Sequence[tuple[Series, Sequence[TrendChange]]], what: str) -> None:
    """Write the page of all series over time, those that change first.

    Args:
        path: path of the page.
        tested: series with their changes.
        what: the times count.

    Raises:
        InputError: it cannot be written.
    """
    sections = []
    for series, changes in sorted(tested, key=lambda pair: not pair[1])[:_MOST_SERIES]:
        days = series.times.astype("datetime64[D]") if what == "date" else series.times
        errors = {"array": SIGMAS_95 * series.std_errs, "width": 0, "thickness": 1}
        figure = go.Figure()
        figure.add_scatter(
            x=days, y=series.values, error_y=errors, mode="markers", marker={"color": palette.MEASURED}
        )
        for change in changes:
            before = change.first - 1 if change.kind == "step" else change.first
            ends = [days[max(before, 0)], days[change.first], days[change.last]]
            values = [change.before, change.after, change.after]
            if change.kind == "drift":
                ends, values = ends[1:], [change.before, change.after]
            figure.add_scatter(x=ends, y=values, mode="lines", line={"color": palette.TRUTH})
        figure.update_layout(showlegend=False, xaxis_title=what, yaxis_title=series.unit)
        title = " ".join([series.group, series.channel, series.name])
        words = tuple(f"{change.kind}, p = {change.p_value:.2g}" for change in changes)
        if series.left_out:
            far = ", ".join(f"{value:.3g}" for _, value in series.left_out)
            words += (f"left out because they are far from their neighbors: {far}",)
        sections.append(PageSection(title, figure=as_html(styled(figure, 260)), words=words))
    changing = sum(bool(changes) for _, changes in tested)
    facts = {"series": str(len(tested)), "that change": str(changing)}
    least = least_for_step(len(tested))
    if short := sum(len(series.values) < least for series, _ in tested):
        facts["too short to detect a step"] = f"{short} (this takes {least} measurements)"
    _write(path, "Trend", facts, sections)


def _write(path: Path, title: str, facts: Mapping[str, str], sections: Sequence[PageSection]) -> None:
    shown = [section for section in sections if section.rows or section.figure]
    write_text(path, rendered(_TEMPLATE, {}, title=title, facts=facts, sections=shown))


def _overview(batch: BatchResult) -> PageSection:
    """Tabulate verdicts, effects and the mean budget of each group and channel."""
    table = batch.table
    names = ("group", "channel", "verdict", "effects")
    group, channel, verdict, effects = (texts(table, name) for name in names)
    places: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(group, channel, strict=True)):
        if key[1]:
            places.setdefault(key, []).append(row)
    budget = [name for name in table.column_names if name.startswith(BUDGET)]
    shares = {name: np.nan_to_num(floats(table, name)) for name in budget}
    times = floats(table, "times_noise")
    lines, bars = [], []
    for key, rows in places.items():
        verdicts = Counter(verdict[row] for row in rows if verdict[row])
        named = Counter(name for row in rows for name in effects[row].split(", ") if name)
        means = {name.removeprefix(BUDGET): float(shares[name][rows].mean()) for name in budget}
        bars.append(means)
        largest = sorted(means.items(), key=lambda item: -item[1])[:3]
        known = times[rows][np.isfinite(times[rows])]
        times_noise = f"{np.median(known):.2g}" if len(known) else "–"
        mean = ", ".join(f"{name} {100 * share:.0f} %" for name, share in largest if share > 0.005)
        counts = (verdicts.most_common(), named.most_common(_MOST_EFFECTS))
        said, shown = (", ".join(f"{name} {number}" for name, number in each) for each in counts)
        lines.append((*key, len(rows), said, times_noise, mean, shown))
    bar_names = [" ".join(filter(None, key)) for key in places]
    figure = go.Figure()
    for word, color in _COLORS.items():
        values = [100 * means.get(word, 0.0) for means in bars]
        if any(values):
            figure.add_bar(y=bar_names, x=values, name=word, orientation="h", marker_color=color)
    figure.update_layout(barmode="stack", showlegend=True, xaxis_title="mean share of the squared error [%]")
    styled(figure, 130 + 34 * len(bar_names)).update_yaxes(autorange="reversed")
    first, error = ("group", "channel", "measurements"), "error / noise (median)"
    if not any(verdict):  # the columns behind the error would be empty
        errors = [(*line[:3], line[4]) for line in lines]
        words = (
            "Nothing was diagnosed; to add verdicts, error budgets and named effects, repeat the batch with "
            "--diagnose.",
        )
        return PageSection("Error over noise", (*first, error), errors, words=words)
    columns = (*first, "verdicts", error, "mean budget", "effects named")
    words = (
        "A measurement without a missing effect has no error budget; in the mean budget, its shares count "
        "as zero.",
    )
    return PageSection("Missing effects", columns, lines, as_html(figure) if any(bars) else None, words)


def _distributions(batch: BatchResult) -> PageSection:
    """Draw each parameter with its 95 % intervals, by group."""
    columns = list(parameter_columns(batch.table))
    shown = sorted(columns, key=lambda column: -len(column.rows))[:_MOST_FIGURES]
    shown = [column for column in columns if any(column is item for item in shown)]
    if not shown:
        return PageSection("Parameters")
    groups, names = texts(batch.table, "group"), texts(batch.table, "measurement")
    order = list(dict.fromkeys(groups))
    means = {
        (entry.channel, entry.parameter, entry.unit, entry.group): entry.effects for entry in batch.pooled
    }
    figures = []
    for column in shown:
        title = {"text": f"{column.channel} {column.head}", "font": {"size": 13}, "x": 0.02}
        figure = go.Figure(layout={"title": title})
        for index, group in enumerate(order):
            own = np.flatnonzero([groups[row] == group for row in column.rows])
            effects = means.get((column.channel, column.name, column.unit, group))
            if not len(own) or effects is None:
                continue
            color = palette.JOINTS[index % len(palette.JOINTS)]
            some = own[even_places(len(own), _MOST_POINTS)]
            x = index + np.linspace(-0.35, 0.25, len(some)) * min(1.0, len(some) / 8)
            errors: Any = {"array": SIGMAS_95 * column.std_errs[some], "width": 0, "thickness": 1}
            about = [names[column.rows[item]] for item in some]
            look: Any = {"name": group, "mode": "markers", "marker": {"size": 5, "color": color}}
            figure.add_scatter(x=x, y=column.values[some], error_y=errors, text=about, **look)
            half = effects.interval[1] - effects.mean
            errors = {"array": [half if np.isfinite(half) else 0.0], "width": 6}
            look["marker"] = {"size": 10, "symbol": "diamond", "color": color}
            mean = f"mean of {count(effects.count, 'measurement')}"
            figure.add_scatter(x=[index + 0.38], y=[effects.mean], error_y=errors, hovertext=mean, **look)
        figure.update_layout(showlegend=False)
        figure.update_xaxes(tickvals=list(range(len(order))), ticktext=order, range=[-0.6, len(order) - 0.4])
        figures.append(as_html(styled(figure, 320).update_layout(modebar_orientation="v")))
    words = [
        "Dots: measurements with 95 % intervals (1.96 standard errors). Diamonds: mean of the group with its "
        "95 % interval."
    ]
    if len(columns) > len(shown):
        words.append(f"{len(columns) - len(shown)} further parameters are in the tables only.")
    tiles = Markup('<div class="tiled">{}</div>').format(Markup().join(figures))
    return PageSection("Parameters", figure=tiles, words=tuple(words))


_EntryTable = tuple[str, Mapping[str, Callable[[Any], object]], str]  # title, cells by heads, words below


def _entry_section(entries: Sequence[Any], table: _EntryTable) -> PageSection:
    """Tabulate entries of a batch, one per row."""
    title, columns, words = table
    rows = [[cell(entry) for cell in columns.values()] for entry in entries]
    return PageSection(title, tuple(columns), rows, words=(words,))


_COMMON: _EntryTable = (
    "Effects missing in the pooled data",
    {
        "channel": lambda entry: entry.channel,
        "effect": lambda entry: entry.effect,
        "share of the squared error": lambda entry: f"{100 * entry.share:.2g} %",
        "improved": lambda entry: f"{entry.improved} of {entry.measurements}",
        "p corrected": lambda entry: format_computed_p_value(entry.p_value),
        "gains as much": lambda entry: ", ".join(entry.confused_with),
    },
    "Evidence of all measurements together: mean gain in logarithmic score on held-out runs when effects are "
    "added one after the other. If no effect is missing, a step names one with a probability of at most 1 %.",
)
_POOLED: _EntryTable = (
    "Pooled model, and how much measurements differ",
    {
        "channel": lambda entry: entry.channel,
        "parameter": lambda entry: entry.parameter,
        "group": lambda entry: entry.group,
        "measurements": lambda entry: entry.effects.count,
        "mean": lambda entry: significant(entry.effects.mean, entry.effects.std_err),
        "95 % interval": lambda entry: range_text(entry.effects.interval, entry.effects.std_err),
        "spread": lambda entry: significant(entry.effects.spread, entry.effects.std_err),
        "95 % of measurements": lambda entry: range_text(entry.effects.prediction, entry.effects.std_err),
        "I²": lambda entry: f"{100 * entry.effects.inconsistency:.0f} %",
        "unit": lambda entry: entry.unit,
    },
    "Random effects: each measurement has a true value of its own around the mean. Spread: standard "
    "deviation of the true values. I²: share of the variance between the values that is not due to their "
    "standard errors. In the table, the columns “shrunk” contain each measurement's value after shrinkage "
    "towards the mean. The larger the standard error relative to the spread, the stronger the shrinkage.",
)
_SHARED: _EntryTable = (
    "Shared by all channels of a group",
    {
        "parameter": lambda entry: entry.parameter,
        "group": lambda entry: entry.group,
        "channels": lambda entry: ", ".join(entry.channels),
        "estimates": lambda entry: entry.count,
        "shared value": lambda entry: (
            "contradicted" if entry.contradicted else significant(entry.value, entry.std_err)
        ),
        "95 % interval": lambda entry: range_text(entry.interval, entry.std_err),
        "unit": lambda entry: entry.unit,
        "p": lambda entry: format_computed_p_value(entry.p_corrected),
    },
    "p: probability that the estimates differ at least this much although all channels have the same true "
    "value (Cochran's Q, corrected by Holm). If p is below 0.01, no shared value is given.",
)
_DIFFERENCES: _EntryTable = (
    "Do groups differ?",
    {
        "channel": lambda entry: entry.channel,
        "parameter": lambda entry: entry.parameter,
        "groups": lambda entry: f"{entry.groups[1]} − {entry.groups[0]}",
        "difference": lambda entry: significant(entry.difference, entry.std_err),
        "95 % interval": lambda entry: range_text(entry.interval, entry.std_err),
        "p": lambda entry: format_computed_p_value(entry.p_value),
        "p corrected": lambda entry: format_computed_p_value(entry.p_corrected),
        "unit": lambda entry: entry.unit,
        "": lambda entry: "differs" if entry.p_corrected < _SIGNIFICANT else "",
    },
    "Welch's test of the groups' means; corrected by Holm over all parameters and pairs of groups. It "
    "assumes independent measurements, so join several files of one specimen (--join specimen).",
)
_OUTLIER = ("measurement", "parameter", "value", "z", "its own report")  # heads of the table of outliers


def range_text(interval: tuple[float, float], std_err: float) -> str:
    """Format an interval; a dash if there is none.

    Args:
        interval: lower and upper end.
        std_err: standard error of the value, which determines the number of digits.
    """
    if not np.isfinite(interval).all():
        return "–"
    return " to ".join(significant(end, std_err) for end in interval)
