"""A diagnosis for people: first what to do about it, then what speaks for it."""

from collections.abc import Iterator, Sequence

from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.diagnosis.result import Accepted, Fitted, ParameterValue, Suspect
from palpate import console
from palpate.text.bars import Bar
from palpate.words import NOT_DETERMINED, chance, safe, significant

SIGMAS_95 = 1.96
_NO_FALL = 0.98  # of the error before
MOST_RANKED = 5
COLORS = {
    Verdict.ADEQUATE: "green",
    Verdict.MISSING: "yellow",
    Verdict.UNEXPLAINED: "red",
    Verdict.INSUFFICIENT: "magenta",
}


def show(found: ChannelDiagnosis) -> Iterator[RenderableType]:
    """Everything about one channel, in the order in which a person wants to know it."""
    yield Text.from_markup(headline(found))
    yield from _indented(*_evidence(found))
    if found.next_experiment is not None and found.verdict is not Verdict.ADEQUATE:
        yield from _indented(
            Text.from_markup(
                f"[bold]next experiment[/bold]: {found.next_experiment.instruction} "
                f"[dim](to {found.next_experiment.purpose})[/dim]"
            )
        )


def headline(found: ChannelDiagnosis) -> str:
    """The verdict, and the sentence that goes with it."""
    color = COLORS[found.verdict]
    return f"[bold {color}]{found.verdict.upper()}[/bold {color}]  {sentence(found)}"


def sentence(found: ChannelDiagnosis) -> str:
    """The verdict in one sentence that a person can act on."""
    where = f"[bold]{found.channel}[/bold]"
    match found.verdict:
        case Verdict.INSUFFICIENT:
            return f"{where}: this data cannot say: {_ended(found.reason)}"
        case Verdict.ADEQUATE:
            part = " in the contact; the joints were not judged" if found.not_judged else ""
            return f"{where}: nothing is missing that this data can show{part}. {_fall(found)}"
        case Verdict.MISSING:
            names = _enumerated([_or_rivals(entry) for entry in found.accepted])
            verb = "is" if len(found.accepted) == 1 else "are"
            return f"{where}: {names} {verb} missing from the model. {_fall(found)}"
    signals = _enumerated(found.depends_on) or "no single signal"
    if found.leaves_little:
        names = _enumerated([_or_rivals(entry) for entry in found.accepted])
        main = f"{names} explain{'' if len(found.accepted) > 1 else 's'}" if names else "the model explains"
        return (
            f"{where}: {main} nearly all. {_fall(found)} A small rest has a shape that no known "
            f"effect explains; it depends on {signals}."
        )
    rest = f"that no known effect explains; it depends on {signals}"
    if found.accepted:
        names = _enumerated([_or_rivals(entry) for entry in found.accepted])
        return f"{where}: {names} and something more is missing {rest}. {_fall(found)}"
    return f"{where}: something is missing {rest}. {_fall(found)}"


def remarks(found: ChannelDiagnosis) -> Iterator[str]:
    """Why nothing, or nothing more, is named, in sentences, and what a joint was judged by."""
    if found.verdict is not Verdict.UNEXPLAINED:
        if told := force_remark(found.force_ahead_of):
            yield told
        return
    yield f"Why: {_ended(found.reason)}"
    if found.suspects:
        unit = found.effort_unit
        falls = [
            f"{suspect.effect} (to {suspect.rmse_after:.3g} {unit}{_or(suspect)})"
            for suspect in found.suspects
        ]
        yield (
            f"Suspected, one on top of the other: {_enumerated(falls)}. Each lowers the error in held-out "
            "runs, but a name is sure only where nothing but noise is left."
        )


def force_remark(faults: Sequence[str]) -> str:
    """That a joint is about another force than the one that was measured; empty where it is about that."""
    if not faults:
        return ""
    return (
        f"The force on it is that of the contact's model, ahead of the sensor's {_enumerated(list(faults))}."
    )


def parameter_table(fitted: Fitted, title: str = "") -> Table:
    """Parameters with 95 % intervals."""
    shown = console.table(title, "parameter", "value", "± 95 %", "unit", right=("value", "± 95 %"))
    for name, parameter in fitted.parameters.items():
        shown.add_row(name, *value_and_half(parameter), safe(parameter.unit))
    return shown


def value_and_half(parameter: ParameterValue) -> tuple[str, str]:
    """The value, and half of its 95 % interval, with digits that mean something."""
    if parameter.std_err is None:
        return significant(parameter.value), NOT_DETERMINED
    half = SIGMAS_95 * parameter.std_err
    return significant(parameter.value, half), significant(half, half)


def _ended(reason: str) -> str:
    """A reason as a sentence, with one mark at its end: some end with a question."""
    return reason if reason.endswith("?") else f"{reason}."


def _or(suspect: Suspect) -> str:
    return f"; or {_enumerated(suspect.confused_with, 'or')}" if suspect.confused_with else ""


def _or_rivals(entry: Accepted) -> str:
    """The effect, and those that this data cannot tell it from."""
    name = f"[bold]{entry.effect}[/bold]"
    return f"{name} (or {_enumerated(entry.confused_with, 'or')})" if entry.confused_with else name


def _fall(found: ChannelDiagnosis) -> str:
    unit, before, after = found.effort_unit, found.baseline, found.final
    if before is None or after is None:
        return ""
    floor = "" if found.noise_floor is None else f" (noise floor {found.noise_floor:.3g} {unit})"
    if found.verdict is Verdict.UNEXPLAINED and found.leaves_little and found.noise_floor:
        floor = f", {after.rmse / found.noise_floor:.2f} times the noise floor"
    if not found.accepted:
        return f"The error in held-out runs is {after.rmse:.3g} {unit}{floor}."
    if after.rmse > _NO_FALL * before.rmse:
        return f"With that, the error in held-out runs stays at {after.rmse:.3g} {unit}{floor}."
    fall = f"from {before.rmse:.3g} to {after.rmse:.3g} {unit}"
    return f"With that, the error in held-out runs falls {fall}{floor}."


def _evidence(found: ChannelDiagnosis) -> Iterator[RenderableType]:
    if found.baseline is None:
        return
    if found.accepted:
        yield _steps(found)
        for entry in found.accepted:
            yield Text.from_markup(f"[bold]{entry.effect}[/bold]: {safe(entry.physics)}")
            yield Text.from_markup(f"  [dim]signature[/dim] {safe(entry.signature)}")
            yield Text.from_markup(f"  [dim]equation[/dim] {safe(entry.equation)}")
            if entry.told_by:
                yield Text.from_markup(f"  [dim]told by[/dim] {_enumerated(entry.told_by)}")
            if entry.confused_with:
                rivals = _enumerated(entry.confused_with, "or")
                yield Text.from_markup(f"  [yellow]this data cannot tell it from {rivals}[/yellow]")
    for remark in remarks(found):
        yield Text(remark)
    named = found.accepted or found.verdict is not Verdict.UNEXPLAINED
    if named and found.final is not None and found.final.parameters:
        yield parameter_table(found.final)
    if found.ranking and found.verdict is not Verdict.ADEQUATE:
        yield _ranking(found)


def _steps(found: ChannelDiagnosis) -> Table:
    unit = found.effort_unit
    errors = (f"held-out\nerror [{unit}]", "p")
    shown = console.table("", "step", *errors, "", "not to be told from", right=errors)
    floor = found.noise_floor or 0.0
    base = found.baseline.rmse if found.baseline is not None else 1.0
    shown.add_row("base model", f"{base:.4g}", "", Bar(1.0, "red"), "")
    for entry in found.accepted:
        color = "green" if entry.rmse_after < 1.1 * floor else "yellow"
        shown.add_row(
            f"+ [bold]{entry.effect}[/bold]",
            f"{entry.rmse_after:.4g}",
            chance(entry.p_value),
            Bar(entry.rmse_after / base, color),
            ", ".join(entry.confused_with) or "[dim]–[/dim]",
        )
    shown.add_row("[dim]noise floor[/dim]", f"[dim]{floor:.4g}[/dim]", "", "", "")
    return shown


def _ranking(found: ChannelDiagnosis) -> Table:
    error, falls = f"held-out\nerror [{found.effort_unit}]", "error\nfalls by"
    shown = console.table("", "alone beside the base model", error, falls, "", right=(error, falls))
    for entry in found.ranking[:MOST_RANKED]:
        shown.add_row(
            entry.effect,
            f"{entry.rmse_held_out:.4g}",
            f"{100 * entry.score:z.0f} %",
            Bar(entry.score, "blue"),
        )
    return shown


def _indented(*parts: RenderableType) -> Iterator[RenderableType]:
    for part in parts:
        yield Padding(part, (0, 0, 0, 2))


def _enumerated(names: list[str], last: str = "and") -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"
