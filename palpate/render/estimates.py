"""Convert estimates to a table, sentences, plain data, and a view to draw."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from palpate.common.console import (
    AT_BOUND,
    NOT_DETERMINED,
    count,
    natural_width,
    plus_minus,
    safe,
    significant,
    table,
)
from palpate.estimation.channel import MIN_STEPS
from palpate.estimation.data_quality import contaminated
from palpate.estimation.estimate import (
    Determined,
    Estimate,
    Identifiability,
    ParameterEstimate,
    rounded,
    with_unit,
)
from palpate.estimation.estimate_channel import describe_steps, steps_spanned
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.study.estimates import MIN_INLIER_SHARE, OFFSET_NAME, PREFERRED, ChannelEstimates
from palpate.render.build import channel_view, equation_of
from palpate.render.view import ChannelView, StageView, VerdictView
from palpate.robot_io.calibration.applied import parse_calibrations
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import SURFACE

_TO_MILLI = 1e3
_TO_PERCENT = 100.0
NOTABLE = 4.0  # standard errors above which a force in free air is remarked
FEW_STEPS = 20.0  # encoder steps below which a remark is made
POOR = 4.0  # multiple of the noise; correct models stay below 2.6, even on objects of 1e5 N/m or 200 N s/m
_WIDE, _NARROW = 104, 80  # terminal widths from which all table columns fit, and from which the errors fit
_MOST_ABREAST = 3  # parameters shown side by side
_IMPOSSIBLE = "impossible"  # outside the physical bounds
_COLORS = {
    Determined.YES: "green",
    Determined.ROUGHLY: "yellow",
    Determined.NO: "bold red",
    _IMPOSSIBLE: "bold red",
}
Truth = Mapping[str, float]


def print_estimates(console: Console, estimates: ChannelEstimates, truth: Truth) -> None:
    """Print one channel's parameters by every estimator, and remarks.

    Args:
        console: console to print to.
        estimates: the channel with its estimates.
        truth: true parameters by name; unknown ones are missing.
    """
    runs, samples = len(estimates.channel.runs), int(np.count_nonzero(estimates.rows))
    title = (
        f"{estimates.channel.name}: {estimates.model.name}, {count(runs, 'run')}, {count(samples, 'sample')}"
    )
    console.print(f"[bold]{safe(title)}[/bold]")
    console.print(_estimate_table(estimates, truth, console.width))
    for remark in remarks(estimates, truth):
        console.print(Padding(Text.from_markup(safe(remark)), (0, 0, 0, 2), expand=False))


def estimates_view(estimates: ChannelEstimates, truth: Truth) -> ChannelView:
    """Make the view of the best estimate, with the residual of the fitted samples.

    Args:
        estimates: estimates of one channel.
        truth: true parameters by name; unknown ones are missing.
    """
    best, predicted = estimates.best, estimates.prediction()
    stage = StageView(
        number=None,
        label=estimates.model.name,
        name=estimates.model.name,
        rmse=best.rmse,
        predicted=predicted,
        residual=np.where(estimates.rows, estimates.channel.effort - predicted, np.nan),
        parameters=best.parameters,
        effects=estimates.model.effects,
        equation=equation_of(estimates.model),
    )
    unit = estimates.channel.effort_unit
    level = f"; the noise is {estimates.noise.describe(unit)}" if estimates.noise else ""
    sentence = (
        f"{estimates.channel.name}: {estimates.model.name}, fitted by {best.estimator}, leaves an error "
        f"of {with_unit(best.rmse, unit)}{level}."
    )
    share = _TO_PERCENT * (1.0 - float(np.mean(estimates.rows)))
    unfitted = f"{share:.2g} % of the samples are not part of the fit; they are shaded" if share else ""
    view = channel_view(estimates.channel, [stage], estimates.noise, scored=estimates.rows)
    is_invalid = contaminated(estimates.channel, estimates.model) or best.unphysical
    is_known = not np.isnan(estimates.misfit)  # NaN without a noise level
    word = "misses" if is_invalid or estimates.misfit > POOR else "fits" if is_known else ""
    names = (estimates.channel.name, estimates.model.name)
    verdict = VerdictView(word, sentence, (*remarks(estimates, truth), unfitted), names)
    return replace(view, error_steps=(), verdict=verdict)


def _estimate_table(estimates: ChannelEstimates, truth: Truth, width: int) -> Table:
    """Tabulate every estimator's parameters with 95 % intervals, and errors where the truth is known."""
    if len(_shown_parameters(estimates.estimates[0])) <= _MOST_ABREAST:
        for columns in (width, min(width, _NARROW - 1)):
            made = _one_row_an_estimator(estimates, truth, columns)
            if natural_width(made) <= width:
                return made
    # On narrow terminals and for large models, the parameters are listed below their estimator.
    known = {p.name for p in _shown_parameters(estimates.estimates[0]) if p.name in truth}
    numbers = ["value", "95 %", *["truth"] * bool(known)]
    made = table("", "estimator", *numbers, "determined", right=numbers)
    for estimate in estimates.estimates:
        made.add_row(f"[bold]{estimate.estimator}[/bold]")
        for p in _shown_parameters(estimate):
            name = f"  {safe(_short_name(p.name))} {safe(f'[{p.unit}]')}"
            value, _, half = _value_text(p).partition(" ")
            true = [f"{truth[p.name]:g}" if p.name in known else ""] * bool(known)
            made.add_row(name, value, half, *true, _in_color(_state(estimate, p)))
    return made


def _one_row_an_estimator(estimates: ChannelEstimates, truth: Truth, width: int) -> Table:
    parameters = _shown_parameters(estimates.estimates[0])
    known = {p.name for p in parameters if p.name in truth}
    erring = known if width >= _NARROW else set()
    columns = ["estimator"]
    for parameter in parameters:
        heading = safe(_short_name(parameter.name)) + "\n" + safe(f"[{parameter.unit}]")
        columns += [heading, *["error"] * (parameter.name in erring)]
    if width >= _WIDE:
        columns += ["rmse\n" + safe(f"[{estimates.channel.effort_unit}]"), "cond.", "used"]
    made = table("", *columns, "determined", right=columns[1:])
    for estimate in estimates.estimates:
        cells = [estimate.estimator]
        for p in _shown_parameters(estimate):
            cells += [_value_text(p), _error_text(p, truth)] if p.name in erring else [_value_text(p)]
        if width >= _WIDE:
            used = f"{_TO_PERCENT * np.mean(estimate.inliers):.0f} %"
            cells += [rounded(estimate.rmse), f"{estimate.condition_number:.2f}", used]
        names: dict[str, list[str]] = {}
        for p in _shown_parameters(estimate):
            names.setdefault(_state(estimate, p), []).append(_short_name(p.name))
        texts = {_IMPOSSIBLE: "{} impossible", Determined.NO: "not {}", Determined.ROUGHLY: "{} roughly"}
        parts = [_in_color(s, text.format(", ".join(names[s]))) for s, text in texts.items() if s in names]
        made.add_row(*cells, ", ".join(parts) or _in_color(Determined.YES))
    if known:
        cells = ["[dim]truth[/dim]"]
        for p in parameters:
            true = f"[dim]{truth[p.name]:g}[/dim]" if p.name in truth else ""
            cells += [true, *[""] * (p.name in erring)]
        made.add_section()
        made.add_row(*cells)
    return made


def _state(estimate: Estimate, parameter: ParameterEstimate) -> str:
    return _IMPOSSIBLE if parameter.name in estimate.unphysical else parameter.determined


def _in_color(state: str, text: str = "") -> str:
    return f"[{_COLORS[state]}]{safe(text) or state}[/{_COLORS[state]}]"


def remarks(estimates: ChannelEstimates, truth: Truth) -> list[str]:
    """Describe the surface, and list objections to the estimates.

    Args:
        estimates: estimates of one channel.
        truth: true parameters by name; unknown ones are missing.
    """
    remarks = []
    channel, surface = estimates.channel, estimates.surface_of(estimates.best)
    reason = contaminated(channel, estimates.model)
    if reason is not None:
        remarks.append(f"do not rely on these estimates: {reason}")
    if surface is not None:
        half_mm = _TO_MILLI * SIGMAS_95 * surface.std_err_m
        true = f" (truth {significant(_TO_MILLI * truth[SURFACE], half_mm)} mm)" if SURFACE in truth else ""
        place = plus_minus(_TO_MILLI * surface.position_m, half_mm)
        remarks.append(f"surface at {place} mm along the press direction{true}")
    tare = channel.tare
    if tare is not None and np.any(np.abs(tare.effort) > NOTABLE * tare.std_err):
        mean = significant(float(np.mean(tare.effort)), float(np.max(tare.std_err)))
        remarks.append(f"the force in free air, {mean} N, was subtracted")
    if MIN_STEPS <= steps_spanned(channel, estimates.rows) < FEW_STEPS:
        steps = describe_steps(channel, estimates.rows)
        remarks.append(
            f"{steps}; the intervals include this rounding error, but with so few steps the estimated "
            "damping is too low"
        )
    return [*remarks, *_remarks_on_fits(estimates)]


def _remarks_on_fits(estimates: ChannelEstimates) -> Iterator[str]:
    best, unit = estimates.best, estimates.channel.effort_unit
    if estimates.noise is not None and estimates.misfit > POOR:
        yield (
            f"{estimates.model.name} does not describe these data: the error of {best.estimator} is "
            f"{rounded(best.rmse, 2)} {unit} (rms), but the noise is {estimates.noise.describe(unit)}. "
            "The intervals do not include this model error; palpate diagnose looks for what is missing"
        )
    surface = estimates.channel.surface
    offset = next((p for p in best.parameters if p.name == OFFSET_NAME), None)
    if surface is not None and offset is not None:
        deeper_m = surface.position_m + offset.value - surface.deepest_m
        if deeper_m > NOTABLE * offset.std_err:
            yield (
                f"the force of {estimates.model.name} begins {_TO_MILLI * deeper_m:.2g} mm below the "
                "touch, because the model lacks adhesion or the object is softer near its surface"
            )
    yield from (f"{name}: {problem}" for name, problem in estimates.failures.items())
    roomy = len(_shown_parameters(estimates.estimates[0])) <= _MOST_ABREAST
    against: dict[str, list[str]] = {}
    for estimate in estimates.estimates:
        left_out = 1.0 - float(np.mean(estimate.inliers))
        if estimate.estimator == PREFERRED[0] and left_out > 1.0 - MIN_INLIER_SHARE:
            share = f"{_TO_PERCENT * left_out:.0f} % of the samples"
            yield f"{estimate.estimator} excludes {share} as outliers, so the model does not fit all data"
        doubtful = estimate.identifiability is not Identifiability.GOOD or estimate.unphysical
        # Otherwise the table states it for each estimator.
        if doubtful and (roomy or estimate is estimates.best):
            against.setdefault(estimate.note, []).append(estimate.estimator)
    yield from (f"{', '.join(names)}: {note}" for note, names in against.items())


def calibration_remark(session: Session | None) -> list[str]:
    """Describe the calibration uncertainty, a systematic error that the intervals do not include.

    Args:
        session: measured session; None for data from elsewhere.
    """
    if session is None:
        return []
    used = parse_calibrations(session.metadata.calibration, f"{session.path}, its calibration")
    left = []
    if used.force is not None:
        scale = used.force.values.scale
        left.append(f"{_TO_PERCENT * scale.std_err / scale.value:.2g} % of the force")
    if used.encoder is not None:
        left.append(f"{_TO_MILLI * max(used.encoder.values.offset.std_err):.2g} mrad in the joints' zeros")
    if not left:
        return []
    return [
        f"the intervals include noise and resolution of the readings, but not the uncertainty "
        f"of the calibration: {' and '.join(left)} (one standard error)"
    ]


def as_data(estimates: ChannelEstimates, truth: Truth) -> dict[str, Any]:
    """Return one channel's estimates as plain data; the keys are stable.

    Args:
        estimates: estimates of one channel.
        truth: true parameters by name; unknown ones are missing.
    """
    tare, outcomes = estimates.channel.tare, []
    for estimate in estimates.estimates:
        surface, parameters = estimates.surface_of(estimate), dict[str, dict[str, Any]]()
        for p in estimate.parameters:
            data = {"value": p.value, "std_err": p.std_err, "interval": list(p.interval), "unit": p.unit}
            data |= {"determined": str(p.determined), "at_bound": p.at_bound}
            if p.name in truth:
                data |= {"truth": truth[p.name], "error_percent": _error_percent(p, truth)}
            parameters[p.name] = data
        outcomes.append(
            {
                "estimator": estimate.estimator,
                "surface": surface,
                "parameters": parameters,
                **{key: getattr(estimate, key) for key in ("rmse", "rmse_inliers", "condition_number")},
                "inliers": int(np.count_nonzero(estimate.inliers)),
                **{
                    key: getattr(estimate, key)
                    for key in ("identifiability", "unphysical", "note", "details")
                },
            }
        )
    tares = None
    if tare is not None:
        rows = zip(tare.run.tolist(), tare.effort.tolist(), tare.std_err.tolist(), strict=True)
        tares = [{"run": run, "effort": effort, "std_err": error} for run, effort, error in rows]
    return {
        "channel": estimates.channel.name,
        "runs": len(estimates.channel.runs),
        "samples": int(np.count_nonzero(estimates.rows)),
        "truth": dict(truth),
        "tare": tares,
        "spoilt": contaminated(estimates.channel, estimates.model),
        "failures": estimates.failures,
        "misfit": {"noise": estimates.noise.value if estimates.noise else None, "times": estimates.misfit},
        "estimates": outcomes,
    }


def markdown_summary(estimates: ChannelEstimates, truth: Truth, heading: str) -> str:
    """Tabulate the best estimate for Rerun's summary.

    Args:
        estimates: estimates of one channel.
        truth: true parameters by name; unknown ones are missing.
        heading: heading of the table.
    """
    best = estimates.best
    rows = [f"**{heading}**: model `{estimates.model.name}`, estimator `{best.estimator}`", ""]
    rows += ["| | found | 95 % interval | truth | error |", "|---|---|---|---|---|"]
    for p in _shown_parameters(best):
        half = p.half_interval
        interval = f"{significant(p.interval[0], half)} … {significant(p.interval[1], half)}"
        true, error = (f"{truth[p.name]:g}", _error_text(p, truth)) if p.name in truth else ("–", "–")
        value = significant(p.value, half)
        rows.append(f"| {_short_name(p.name)} [{p.unit}] | {value} | {interval} | {true} | {error} |")
    return "\n".join([*rows, "", *(f"- {remark}" for remark in remarks(estimates, truth))])


def _shown_parameters(estimate: Estimate) -> list[ParameterEstimate]:
    """Return all parameters except the surface, which has its own sentence."""
    return [parameter for parameter in estimate.parameters if parameter.name != OFFSET_NAME]


def _short_name(parameter: str) -> str:
    """Return the symbol that equations use, such as "k" for "stiffness.k"."""
    return parameter.rpartition(".")[2]


def _value_text(parameter: ParameterEstimate) -> str:
    """Format a value and half of its 95 % interval, with the justified number of digits."""
    half = parameter.half_interval
    if parameter.at_bound:
        return f"{significant(parameter.value)} ({AT_BOUND})"
    if not np.isfinite(half):
        return f"{significant(parameter.value, half)} ({NOT_DETERMINED})"
    return plus_minus(parameter.value, half)


def _error_percent(parameter: ParameterEstimate, truth: Truth) -> float:
    """Return the deviation from the truth [%]; NaN where the truth is zero."""
    true = truth[parameter.name]
    return _TO_PERCENT * (parameter.value - true) / true if true else float("nan")


def _error_text(parameter: ParameterEstimate, truth: Truth) -> str:
    """Format the deviation from the truth in percent, absolute where the truth is zero."""
    if truth[parameter.name] == 0:
        return f"{parameter.value:+z.2g}"
    return f"{_error_percent(parameter, truth):+z.2f} %"
