"""Print comparison, diagnosis and revisions in a terminal with rich."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.bar import Bar
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from palpate.common.console import (
    AT_BOUND,
    NOT_DETERMINED,
    display_path,
    first_that_fits,
    format_p_value,
    labeled,
    natural_width,
    safe,
    significant,
    table,
)
from palpate.estimation.diagnosis.forms import Form
from palpate.estimation.effects.contact_geometry import ContactOffset
from palpate.estimation.estimate import ParameterEstimate, rounded, with_unit
from palpate.estimation.study import Revision
from palpate.estimation.study.comparison import FAR
from palpate.render.view import (
    NOISE,
    RANGE,
    BudgetView,
    ChannelView,
    StudyView,
    VerdictView,
    percent,
)

COLORS = {
    "adequate": "green",
    "fits": "green",
    "missing": "yellow",
    "misses": "yellow",
    "unexplained": "red",
    "insufficient": "magenta",
}
_ROOMY, _NARROW = 100, 80  # columns of a terminal
_FOLDED = 12  # columns for a kind's description on a narrow terminal
_MOST_RANKED = 5
_BOUNDS = {"": "", "at most": "≤ ", "at least": "≥ "}
_LOPSIDED = 0.1  # asymmetry, relative to the half-width, above which both ends of an interval are shown


def print_diagnosis(console: Console, view: StudyView) -> None:
    """Print each channel's error budget, verdict, stages, parameters, next steps and evidence."""
    for number, channel in enumerate(view.channels):
        if number:
            console.print()
        if channel.budget is not None:
            _print_budget(console, channel.name, channel.budget)
        console.print(_headline(channel.verdict))
        width = console.width - 2  # width of the lines below the heading
        parts: list[RenderableType] = [Text(safe_text(remark)) for remark in channel.verdict.remarks]
        if channel.accepted:
            parts.append(_error_steps_table(channel, width))
        for entry in channel.accepted:
            form = " (approximate form)" if entry.form is Form.APPROXIMATE else ""
            text = f"[bold]{safe(entry.effect)}[/bold]{form}: {safe(entry.physics)}"
            lines = labeled(("signature", entry.signature), ("equation", entry.equation))
            parts += [Text.from_markup(text), Padding(lines, (0, 0, 0, 2))]
            if entry.confused_with:
                rivals = f"these data cannot tell it from {', '.join(entry.confused_with)}"
                parts.append(Padding(Text(safe_text(rivals), style="yellow"), (0, 0, 0, 2)))
        if channel.parameters and (channel.accepted or channel.verdict.word != "unexplained"):
            parts.append(_parameter_table(channel.parameters, width))
        if channel.ranking:
            error, falls = "held-out\n" + safe(f"error [{channel.axes.effort_unit}]"), "error\nfalls by"
            made = table("", "base model and one effect", error, falls, "", right=(error, falls))
            for rank in channel.ranking[:_MOST_RANKED]:
                bar, share = _bar(rank.score, "blue", width), f"{100 * rank.score:z.0f} %"
                made.add_row(safe(rank.effect), rounded(rank.rmse_held_out, 4), share, bar)
            parts.append(made)
        if channel.next_experiment is not None:
            plan = channel.next_experiment
            words = f"[bold]next experiment[/bold]: {safe(plan.instruction)}, to {safe(plan.purpose)}"
            parts.append(Text.from_markup(words))
        console.print(Padding(Group(*parts), (0, 0, 0, 2)))


def _print_budget(console: Console, channel: str, budget: BudgetView) -> None:
    """Print the error budget: one sentence, a bar for each part, and indistinguishable effects."""
    console.print(Text.from_markup(f"[bold]{safe(channel)}[/bold]  {safe(budget.sentence)}"))
    if len(budget.parts) > 1:
        ways = ((_ROOMY, 2), (_ROOMY, 1), (_NARROW, 1), (0, 1), (0, 0))
        tables = (_budget_table(budget, bars, columns) for bars, columns in ways)
        console.print(Padding(first_that_fits(tables, console.width - 2), (0, 0, 0, 2)))
        if meanings := "\n".join(budget.form_meanings):
            console.print(Padding(Text(meanings, style="dim"), (0, 0, 1, 2)))
    for sentence in budget.confusions:
        console.print(Padding(Text(safe_text(sentence), style="yellow"), (0, 0, 1, 2)))


def _budget_table(budget: BudgetView, bars: int, columns: int) -> Table:
    """Tabulate share, range, form and effects of each part, with bars for a terminal of width `bars`.

    Form and effects have 0 to 2 columns of their own; without one, they are below the kind.
    """
    limits = RANGE.replace(" or ", "\nor " if columns else " or\n")
    last = ("form", "effects")[:columns]
    made = table("", "", *[""] * bool(bars), "share", limits, *last, right=("share", limits))
    for part in budget.parts:
        share = f"{_BOUNDS[part.bound]}{percent(part.share, bound=part.bound)}"
        effects = ",\n".join(map(safe, part.effects_text.split(", ")))  # so that no name is broken
        form = part.form if columns > 1 or not effects else f"{part.form}\n[dim]{effects}[/dim]"
        bar = [_bar(round(part.share, 2), part.color, bars)] * bool(bars)
        below = "" if columns else "\n" + form.replace(",\n", "\n").replace(": ", ":\n")
        word = safe(part.word) + below.rstrip().replace("\n", "\n  ")
        made.add_row(word, *bar, share, part.range_text, *(form, effects)[:columns])
    if bars < _NARROW and columns:
        made.columns[0].max_width = _FOLDED
    return made


def print_comparison(console: Console, channels: Sequence[ChannelView]) -> None:
    """Print each channel's error and the noise level, with tables if a model does not fit."""
    for channel in channels:
        _print_verdict(console, channel.verdict)
        if channel.parts and (channel.verdict.word not in {"fits", ""} or len(channels) == 1):
            console.print(_parts_table(channel, console.width))


def print_stages(console: Console, channel: ChannelView) -> None:
    """Print the error of each stage, and the last stage's parameters."""
    _print_verdict(console, channel.verdict)
    console.print(_error_steps_table(channel, console.width))
    console.print(_parameter_table(channel.parameters, console.width))


def print_revisions(console: Console, kept: Sequence[Revision]) -> None:
    """Print all revisions of a session; on a narrow terminal in a shorter form."""
    roomy = console.width >= _ROOMY
    numbers = ("revision", "from") if roomy else ("no.",)
    errors, when = ("held-out\nerror", "× noise"), ("made",) if roomy else ()
    words = ("channel", "model") if roomy else ("model",)
    made = table("", *numbers, *words, *errors, *when, right=(*numbers, *errors))
    least: dict[tuple[str, str, str], float] = {}
    for each in kept:
        least[each.key] = min(each.rmse, least.get(each.key, each.rmse))
    for each in kept:
        # Every model's error also bounds the noise.
        noise = min(each.noise_floor, least[each.key]) if each.noise_at_most else each.noise_floor
        times = each.rmse / noise if noise > 0.0 else float("inf")
        before = "" if each.parent is None else str(each.parent)
        number = [str(each.number), before] if roomy else [f"{before} → {each.number}".removeprefix(" → ")]
        model = (" + " if roomy else "\n+ ").join(map(safe, [each.model, *each.effects]))
        last = [f"[dim]{safe(each.created_utc[:16].replace('T', ' '))}[/dim]"] if roomy else []
        words = (safe(each.channel), model) if roomy else (f"[bold]{safe(each.channel)}[/bold]\n{model}",)
        error = safe(with_unit(each.rmse, each.effort_unit, 4))
        ratio = f"[{_grade(times)}]{'≥ ' * each.noise_at_most}{times:.2f}[/]"
        made.add_row(*number, *words, error, ratio, *last)
    console.print(made)


def print_files(console: Console, written: Mapping[str, Path]) -> None:
    """Print the written files, one per line."""
    for what, path in written.items():
        console.print(f"{what:<10} [bold]{display_path(path)}[/bold]", soft_wrap=True)


def _print_verdict(console: Console, verdict: VerdictView) -> None:
    console.print(_headline(verdict))
    for remark in verdict.remarks:
        console.print(Padding(Text(safe_text(remark)), (0, 0, 0, 2)))


def _headline(verdict: VerdictView) -> Text:
    """Return the verdict as a colored word, and its sentence with the effects in bold."""
    color = f"bold {COLORS.get(verdict.word, '')}"
    text = Text(safe_text(verdict.sentence))
    for name in filter(None, (*verdict.names, verdict.sentence.partition(":")[0])):
        text.highlight_regex(rf"(?<!\w){re.escape(name)}(?!\w)", "bold")
    if verdict.tag:
        return Text(f"{verdict.tag}  ", style=color) + text
    text.highlight_words([f" {verdict.word} "], color)
    return text


def safe_text(text: str) -> str:
    """Return text from a file without escape sequences; its markup is not interpreted."""
    return Text.from_markup(safe(text)).plain


def _grade(times: float) -> str:
    """Return an error's color by its ratio to the noise level."""
    return "green" if times < NOISE else "yellow" if times < FAR else "red"


def _error_steps_table(channel: ChannelView, width: int, *, narrow: bool = False) -> Table:
    """Tabulate the held-out error, one row per stage; without bars if narrow."""
    error = "held-out\nerror" + ("\n" if narrow else " ") + safe(f"[{channel.axes.effort_unit}]")
    revisions = ["" if stage.number is None else str(stage.number) for stage in channel.stages]
    number = ("no." if narrow else "revision",) if any(revisions) else ()
    labels = {label for label, _ in channel.error_steps}
    tested = [entry for entry in channel.accepted if f"+ {entry.effect}" in labels]
    evidence = {f"+ {entry.effect}": format_p_value(entry.p_value) for entry in tested}
    last = ("p",) if evidence else ()
    right = (*number, error, "× noise", "p")
    made = table("", *number, "model", error, "× noise", *[""] * (not narrow), *last, right=right)
    worst = max(value for _, value in channel.error_steps)
    for row, (label, value) in enumerate(channel.error_steps):
        times = channel.times_noise(value)
        name = f"{safe(label[:2])}[bold]{safe(label[2:])}[/bold]" if row else safe(label)
        bar = [_bar(value / worst, _grade(times), width)] * (not narrow)
        chance = [evidence.get(label, "")] * len(last)
        shown_revision = revisions[row : row + len(number)]
        ratio = channel.times_noise_text(value)
        made.add_row(*shown_revision, name, rounded(value, 4), ratio, *bar, *chance)
    level = f"[dim]{rounded(channel.noise_level, 4)}[/dim]"
    bar = [_bar(channel.noise_level / worst, "bright_black", width)] * (not narrow)
    made.add_row(*[""] * len(number), f"[dim]{channel.noise_label}[/dim]", level, "", *bar)
    return made if narrow or natural_width(made) <= width else _error_steps_table(channel, width, narrow=True)


def _parameter_table(
    parameters: Sequence[ParameterEstimate], width: int, *, narrow: bool = False
) -> RenderableType:
    """Tabulate parameters with 95 % intervals; if narrow, with units below effects' names."""
    if not parameters:
        return Text("The model has no free parameter.", style="dim")
    units = () if narrow else ("unit",)
    made = table("", "parameter", "value", "95 % interval", *units, right=("value", "95 % interval"))
    for parameter in parameters:
        effect, _, name = parameter.name.rpartition(".")
        place = f"[dim]{safe(effect)}.[/dim]"
        if narrow:
            unit = safe(f"[{parameter.unit}]")
            made.add_row(f"{place}\n  {safe(name)} {unit}", *with_interval(parameter))
        else:
            made.add_row(place + safe(name), *with_interval(parameter), safe(parameter.unit))
    if not narrow and natural_width(made) > width:
        return _parameter_table(parameters, width, narrow=True)
    if any(parameter.name.startswith(f"{ContactOffset.name}.") for parameter in parameters):
        note = f"{ContactOffset.name}: depth of the surface below its first estimate"
        return Group(made, Text(note, style="italic dim"))
    return made


def with_interval(parameter: ParameterEstimate) -> tuple[str, str]:
    """Format a value and half of its 95 % interval, or both ends of an asymmetric one.

    Args:
        parameter: the parameter.

    Returns:
        Value and interval without unit; a remark replaces an interval at a bound, or one that is not known.
    """
    if parameter.at_bound:
        return significant(parameter.value), AT_BOUND
    (lower, upper), half = parameter.interval, parameter.half_interval
    value = significant(parameter.value, half)
    if not half < float("inf"):  # true for NaN as well
        return value, NOT_DETERMINED
    if abs(upper + lower - 2 * parameter.value) < _LOPSIDED * half:
        return value, f"± {significant(half, half)}"
    return value, f"{significant(lower, half)} … {significant(upper, half)}"


def _parts_table(channel: ChannelView, width: int, *, narrow: bool = False) -> Table:
    """Tabulate the error of each part relative to the noise level, with each kind's worst part in bold."""
    unit = channel.axes.effort_unit
    numbers = ("rmse\n" + safe(f"[{unit}]"), "mean\n" + safe(f"[{unit}]"), "× noise")
    made = table("", *["by"] * (not narrow), "where", *numbers, *[""] * (not narrow), right=numbers)
    most = max(part.rmse for parts in channel.parts.values() for part in parts)
    for kind, parts in channel.parts_by():
        worst = max(parts, key=lambda part: part.rmse)
        heading = f"[dim]{safe(kind)}[/dim]"
        if narrow:
            made.add_row(heading)
        for row, part in enumerate(parts):
            times = channel.times_noise(part.rmse)
            bold = part is worst and times > NOISE
            label = f"[bold]{safe(part.label)}[/bold]" if bold else safe(part.label)
            place = (f"  {label}",) if narrow else (heading if row == 0 else "", label)
            bar = () if narrow else (_bar(part.rmse / most, _grade(times), width),)
            ratio = channel.times_noise_text(part.rmse, 1)
            cells = (*place, rounded(part.rmse), f"{part.mean:+.2g}", ratio, *bar)
            made.add_row(*cells, end_section=row == len(parts) - 1)
    return made if narrow or natural_width(made) <= width else _parts_table(channel, width, narrow=True)


def _bar(share: float, color: str, width: int) -> Bar:
    size = 18 if width >= _ROOMY else 8 if width >= _NARROW else 3
    return Bar(1.0, 0.0, min(max(share, 0.0), 1.0), width=size, color=color)
