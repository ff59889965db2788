"""Estimates as tables for people."""

from collections.abc import Mapping

import numpy as np
from rich.table import Table

from estimation.estimate import Estimate, Identifiability
from palpate import console
from palpate.findings.estimation_run import ChannelEstimates
from palpate.text.estimate_report import PERCENT, error_text, short_name, shown_parameters, with_interval
from palpate.words import count

WIDE = 104  # characters that all columns of the short table need
NARROW = 80  # below, the errors are left to the reader
MOST_ABREAST = 3  # parameters that stand side by side
JUDGED = {
    Identifiability.GOOD: "[green]good[/green]",
    Identifiability.WEAK: "[yellow]weak[/yellow]",
    Identifiability.NONE: "[bold red]none[/bold red]",
}


def estimate_table(found: ChannelEstimates, truth: Mapping[str, float], width: int) -> Table:
    """Every estimator's parameters with their 95 % intervals; errors where the truth is known.

    Args:
        found: a channel with its estimates.
        truth: true parameters, as far as they are known.
        width: of the terminal [characters]; a narrow one gets fewer columns.
    """
    if len(shown_parameters(found.estimates[0])) > MOST_ABREAST:
        return _one_row_a_parameter(found)
    return _one_row_an_estimator(found, truth, width)


def _one_row_an_estimator(found: ChannelEstimates, truth: Mapping[str, float], width: int) -> Table:
    parameters = shown_parameters(found.estimates[0])
    columns = ["estimator"]
    for parameter in parameters:
        columns.append(f"{short_name(parameter.name)}\n[{parameter.unit}]")
        columns += ["error"] if parameter.name in truth and width >= NARROW else []
    columns += [f"rmse\n[{found.channel.kind.effort_unit}]", "cond.", "used"] if width >= WIDE else []
    columns += ["determined"]
    table = console.table(_title(found), *columns, right=columns[1:-1])
    for estimate in found.estimates:
        cells = [estimate.estimator]
        for parameter in shown_parameters(estimate):
            cells.append(with_interval(parameter))
            cells += [error_text(parameter, truth)] if parameter.name in truth and width >= NARROW else []
        cells += _quality(estimate) if width >= WIDE else []
        table.add_row(*cells, JUDGED[estimate.identifiability])
    if any(parameter.name in truth for parameter in parameters):
        cells = ["[dim]truth[/dim]"]
        for parameter in parameters:
            cells.append(f"[dim]{truth[parameter.name]:g}[/dim]" if parameter.name in truth else "")
            cells += [""] if parameter.name in truth and width >= NARROW else []
        table.add_section()
        table.add_row(*cells)
    return table


def _one_row_a_parameter(found: ChannelEstimates) -> Table:
    """For models with many parameters, each estimator's below those of the one before."""
    table = console.table(
        _title(found), "estimator", "parameter", "value", "unit", "determined", right=("value",)
    )
    for estimate in found.estimates:
        for number, parameter in enumerate(shown_parameters(estimate)):
            first = number == 0
            name, judged = (estimate.estimator, JUDGED[estimate.identifiability]) if first else ("", "")
            table.add_row(name, short_name(parameter.name), with_interval(parameter), parameter.unit, judged)
        rmse, condition, used = _quality(estimate)
        unit = found.channel.kind.effort_unit
        table.add_row("", "[dim]rmse[/dim]", f"[dim]{rmse}[/dim]", f"[dim]{unit}[/dim]")
        table.add_row("", "[dim]cond., used[/dim]", f"[dim]{condition}, {used}[/dim]", end_section=True)
    return table


def _quality(estimate: Estimate) -> list[str]:
    used = f"{PERCENT * np.mean(estimate.inliers):.0f} %"
    return [f"{estimate.rmse:.4f}", f"{estimate.condition_number:.2f}", used]


def _title(found: ChannelEstimates) -> str:
    runs, samples = len(found.channel.runs), int(np.count_nonzero(found.rows))
    return f"{found.channel.name}: {found.model.name}, {count(runs, 'run')}, {count(samples, 'sample')}"
