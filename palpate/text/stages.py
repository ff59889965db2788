"""Stages of a model for people: how the held-out error falls, step by step, down to the noise floor."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from estimation.revision import Revision
from palpate import console
from palpate.findings.revisions import KeptRevision
from palpate.findings.story import Story
from palpate.text.bars import Bar
from palpate.text.comparison import ALIKE
from palpate.words import NOT_DETERMINED, safe, significant
from palpate.words import shown as shown_path

SIGMAS_95 = 1.96
_NO_FALL = 0.98  # of the error before
_ROOMY = 100  # columns of a terminal


def fall_sentence(story: Story) -> str:
    """What the stages did to the error, in one sentence."""
    first, last = story.stages[0], story.stages[-1]
    unit, name = story.subject.channel.kind.effort_unit, safe(story.subject.channel.name)
    names = safe(", ".join(stage.added for stage in story.stages[1:]))
    times = last.rmse / last.noise_floor if last.noise_floor > 0 else float("inf")
    ends = "down to the noise floor" if times < ALIKE else f"to {times:.1f} times the noise floor"
    color = "green" if times < ALIKE else "yellow"
    whole = f"[bold]{name}[/bold] with [bold]{names}[/bold]: the error in held-out runs"
    if last.rmse > _NO_FALL * first.rmse:
        stays = "[bold yellow]does not fall[/bold yellow]"
        return f"{whole} {stays}: from {first.rmse:.3g} to {last.rmse:.3g} {unit}."
    falls = (
        f"{whole} falls from {first.rmse:.3g} to {last.rmse:.3g} {unit}, [bold {color}]{ends}[/bold {color}]."
    )
    before = story.stages[-2]
    if last.rmse <= _NO_FALL * before.rmse:
        return falls
    does = "makes it worse" if last.rmse * _NO_FALL > before.rmse else "does next to nothing"
    step = (
        f"The last step, [bold]{last.added}[/bold], {does}: from {before.rmse:.4g} to {last.rmse:.4g} {unit}."
    )
    return f"{falls} {step}"


def parameter_table(stage: Revision) -> Table:
    """The stage's parameters with 95 % intervals."""
    shown = console.table("", "parameter", "value", "± 95 %", "unit", right=("value", "± 95 %"))
    for name, found in stage.parameters.items():
        half = SIGMAS_95 * found.std_err
        known = bool(np.isfinite(half))
        value = significant(found.value, half if known else None)
        interval = significant(half, half) if known else NOT_DETERMINED
        shown.add_row(safe(name), value, interval, safe(found.unit))
    return shown


def print_files(written: Mapping[str, Path]) -> None:
    """The files that were written, one a line."""
    out = console.stdout()
    for what, path in written.items():
        out.print(f"{what:<10} [bold]{shown_path(path)}[/bold]", soft_wrap=True)


def stage_table(stages: Sequence[Revision], unit: str, numbers: Sequence[int | None]) -> Table:
    """One row a stage.

    Args:
        stages: from the base model on.
        unit: of the errors.
        numbers: of the revision that each is kept as; None where it is not kept.
    """
    error = safe(f"held-out\nerror [{unit}]")
    shown = console.table("", "revision", "model", error, "x floor", "", right=("revision", error, "x floor"))
    floor, worst = stages[-1].noise_floor, max(stage.rmse for stage in stages)
    for stage, number in zip(stages, numbers, strict=True):
        times = stage.rmse / floor if floor > 0 else float("inf")
        color = "green" if times < ALIKE else "yellow" if times < 3 else "red"
        shown.add_row(
            "–" if number is None else str(number),
            f"+ [bold]{safe(stage.added)}[/bold]" if stage.added else safe(stage.model.name),
            f"{stage.rmse:.4g}",
            f"{times:.2f}",
            Bar(stage.rmse / worst, color, 30),
        )
    shown.add_row("", "[dim]noise floor[/dim]", f"[dim]{floor:.4g}[/dim]", "", Bar(floor / worst, "dim", 30))
    return shown


def revision_table(revisions: Sequence[KeptRevision], width: int) -> Table:
    """All revisions of a session; one effect a line and no dates where there are few columns (`width`)."""
    roomy = width >= _ROOMY
    numbers = ("revision", "from") if roomy else ("no.",)
    errors = ("held-out\nerror", "x floor")
    words = ("channel", "model") if roomy else ("model",)
    when = ("made",) if roomy else ()
    shown = console.table("", *numbers, *words, *errors, *when, right=(*numbers, *errors))
    for kept in revisions:
        # a better model sees the noise more clearly
        floor = min(other.noise_floor for other in revisions if other.channel == kept.channel)
        times = kept.rmse / floor if floor > 0 else float("inf")
        before = "" if kept.parent is None else str(kept.parent)
        model = safe((" + " if roomy else "\n+ ").join([kept.model, *kept.effects]))
        channel, made = safe(kept.channel), safe(kept.created_utc[:16].replace("T", " "))
        shown.add_row(
            *((str(kept.number), before) if roomy else (f"{before} → {kept.number}".removeprefix(" → "),)),
            *((channel, model) if roomy else (f"[bold]{channel}[/bold]\n{model}",)),
            f"{kept.rmse:.4g} {safe(kept.effort_unit)}",
            f"{times:.2f}",
            *((f"[dim]{made}[/dim]",) if roomy else ()),
        )
    return shown
