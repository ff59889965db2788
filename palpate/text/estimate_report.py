"""Says what was estimated: in words, as markdown for Rerun, as plain data for programs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimation.channel import ChannelData
from estimation.gate.gate import spoilt
from estimation.estimate import Estimate, Identifiability, ParameterEstimate
from estimation.fitting.misfit import Misfit, misfit
from estimation.rounding import in_steps, steps_spanned
from estimation.surface import FEWEST_STEPS
from palpate.findings.estimation_run import BEST, MOST, OFFSET, ChannelEstimates
from palpate.findings.truth import SURFACE
from palpate.words import NOT_DETERMINED, significant
from robot_io.calibration import parse_calibrations
from robot_io.session import Session

MILLI = 1e3
PERCENT = 100.0
SIGMAS_95 = 1.96
NOTABLE = 4.0  # standard errors of a force in free air that is worth a word
FEW_STEPS = 20.0  # of an encoder, that are worth a word
POOR = 4.0  # times the noise: right models stay below 2.6, also on objects of 1e5 N/m or 200 N s/m


def remarks(found: ChannelEstimates, truth: Mapping[str, float]) -> list[str]:
    """What the table does not say: the surface, and what the data cannot determine."""
    lines = _spoilt_remark(found)
    surface = found.surface_of(found.best)
    if surface is not None:
        place = f"{MILLI * surface.position_m:.3f} mm along the press direction"
        sure = f" ± {MILLI * SIGMAS_95 * surface.std_err_m:.3f} mm" if np.isfinite(surface.std_err_m) else ""
        true = f" (truth {MILLI * truth[SURFACE]:.3f} mm)" if SURFACE in truth else ""
        lines.append(f"surface found at {place}{sure}{true}")
    lines += _tare_remark(found.channel)
    lines += _misfit_remark(found)
    lines += _pull_remark(found) + _steps_remark(found)
    lines += [f"{name}: {problem}" for name, problem in found.failures.items()]
    for estimate in found.estimates:
        left_out = 1.0 - float(np.mean(estimate.inliers))
        if estimate.estimator == BEST[0] and left_out > 1.0 - MOST:
            share = f"{PERCENT * left_out:.0f} % of the samples"
            lines.append(f"{estimate.estimator} set {share} aside: the model does not describe them")
    return lines + _notes(found)


def spoilt_by(found: ChannelEstimates) -> str | None:
    """What is wrong with the data, so that no estimate of them means anything; None if nothing shows."""
    return spoilt(found.channel, found.model)


def _spoilt_remark(found: ChannelEstimates) -> list[str]:
    reason = spoilt_by(found)
    return [] if reason is None else [f"do not rely on these estimates: {reason}"]


def _notes(found: ChannelEstimates) -> list[str]:
    """What speaks against the estimates, once for all that it speaks against."""
    against: dict[str, list[str]] = {}
    for estimate in found.estimates:
        if estimate.identifiability is not Identifiability.GOOD or estimate.unphysical:
            against.setdefault(estimate.note, []).append(estimate.estimator)
    return [f"{', '.join(names)}: {note}" for note, names in against.items()]


def _pull_remark(found: ChannelEstimates) -> list[str]:
    """That the model's force begins below the touch, though the object was touched there."""
    surface, offset = (
        found.channel.surface,
        next((p for p in found.best.parameters if p.name == OFFSET), None),
    )
    if surface is None or offset is None:
        return []
    deeper_m = surface.position_m + offset.value - surface.deepest_m
    if not deeper_m > NOTABLE * offset.std_err:
        return []
    return [
        f"the force of {found.model.name} begins {MILLI * deeper_m:.2g} mm below the touch: something pulls "
        "that it does not know, or the object begins softly"
    ]


def _steps_remark(found: ChannelEstimates) -> list[str]:
    """That an encoder is coarse for this press, where something can be said all the same."""
    if not FEWEST_STEPS <= steps_spanned(found.channel, found.rows) < FEW_STEPS:
        return []
    return [
        f"{in_steps(found.channel, found.rows)}: what they leave uncertain is in the intervals, but "
        "a damping from so few comes out too low"
    ]


def calibration_remark(session: Session | None) -> list[str]:
    """What calibrations leave uncertain: one error in all samples, so that no interval holds it."""
    if session is None:
        return []
    used = parse_calibrations(session.metadata.calibration, f"{session.path}, its calibration")
    left = []
    if used.force is not None:
        scale = used.force.values.scale
        left.append(f"{PERCENT * scale.std_err / scale.value:.2g} % of the force")
    if used.encoder is not None:
        left.append(f"{MILLI * max(used.encoder.values.offset.std_err):.2g} mrad of the joints' zeros")
    if not left:
        return []
    return [
        f"the intervals hold noise and steps; what the calibration leaves uncertain comes on top: "
        f"{' and '.join(left)} (one standard error)"
    ]


def _misfit_remark(found: ChannelEstimates) -> list[str]:
    """That the model does not describe the data, however narrow its intervals are."""
    left, best, unit = misfit_of(found), found.best, found.channel.kind.effort_unit
    if not left.times > POOR:
        return []
    sizes = f"{best.rmse:.2g} {unit} (rms), and the noise from sample to sample is {left.noise:.2g} {unit}"
    return [
        f"{best.estimator} leaves {sizes}: {found.model.name} does not describe these data, whatever the "
        "intervals say"
    ]


def misfit_of(found: ChannelEstimates) -> Misfit:
    """What the best estimate leaves beside the noise."""
    best = found.best
    return misfit(best.residuals, found.channel.run[found.rows], best.inliers)


def _tare_remark(channel: ChannelData) -> list[str]:
    """What was taken off the force, where that is more than the noise of its mean."""
    tare = channel.tare
    if tare is None or not np.any(np.abs(tare.effort) > NOTABLE * tare.std_err):
        return []
    mean_n, std_err_n = float(np.mean(tare.effort)), float(np.max(tare.std_err))
    return [f"the force in free air, {significant(mean_n, std_err_n)} N, was taken off"]


def as_data(found: ChannelEstimates, truth: Mapping[str, float]) -> dict[str, Any]:
    """One channel's outcome as plain data; the keys are stable."""
    return {
        "channel": found.channel.name,
        "runs": len(found.channel.runs),
        "samples": int(np.count_nonzero(found.rows)),
        "truth": dict(truth),
        "tare": _tare_data(found.channel),
        "spoilt": spoilt_by(found),
        "failures": found.failures,
        "misfit": vars(misfit_of(found)),
        "estimates": [_estimate_data(found, estimate, truth) for estimate in found.estimates],
    }


def _tare_data(channel: ChannelData) -> list[dict[str, float]] | None:
    tare = channel.tare
    if tare is None:
        return None
    names = ("run", "effort", "std_err")
    return [
        dict(zip(names, values, strict=True))
        for values in zip(tare.run.tolist(), tare.effort.tolist(), tare.std_err.tolist(), strict=True)
    ]


def _estimate_data(found: ChannelEstimates, estimate: Estimate, truth: Mapping[str, float]) -> dict[str, Any]:
    surface = found.surface_of(estimate)
    return {
        "estimator": estimate.estimator,
        "surface": vars(surface) if surface is not None else None,
        "parameters": {p.name: _parameter_data(p, truth) for p in estimate.parameters},
        "rmse": estimate.rmse,
        "condition_number": estimate.condition_number,
        "inliers": int(np.count_nonzero(estimate.inliers)),
        "identifiability": str(estimate.identifiability),
        "note": estimate.note,
        "details": estimate.details,
    }


def _parameter_data(parameter: ParameterEstimate, truth: Mapping[str, float]) -> dict[str, Any]:
    data: dict[str, Any] = {
        "value": parameter.value,
        "std_err": parameter.std_err,
        "interval": list(parameter.interval),
        "unit": parameter.unit,
    }
    if parameter.name in truth:
        data |= {"truth": truth[parameter.name], "error_percent": error_percent(parameter, truth)}
    return data


def markdown_summary(found: ChannelEstimates, truth: Mapping[str, float], heading: str) -> str:
    """The best estimate as a small table, for Rerun's summary."""
    best = found.best
    rows = [f"**{heading}**: model `{found.model.name}`, estimator `{best.estimator}`", ""]
    rows += ["| | found | 95 % interval | truth | error |", "|---|---|---|---|---|"]
    for p in shown_parameters(best):
        interval = f"{significant(p.interval[0], p.std_err)} … {significant(p.interval[1], p.std_err)}"
        true, error = (f"{truth[p.name]:g}", error_text(p, truth)) if p.name in truth else ("–", "–")
        value = significant(p.value, p.std_err)
        rows.append(f"| {short_name(p.name)} [{p.unit}] | {value} | {interval} | {true} | {error} |")
    return "\n".join([*rows, "", *remarks(found, truth)])


def shown_parameters(estimate: Estimate) -> list[ParameterEstimate]:
    """All but the surface, which is told in its own words."""
    return [parameter for parameter in estimate.parameters if parameter.name != OFFSET]


def short_name(parameter: str) -> str:
    """The symbol that the equations use, such as "k" for "stiffness.k"."""
    return parameter.rpartition(".")[2]


def with_interval(parameter: ParameterEstimate) -> str:
    """Value and half of its 95 % interval."""
    lower, upper = parameter.interval
    half = (upper - lower) / 2
    if not np.isfinite(half):
        return f"{significant(parameter.value)} ({NOT_DETERMINED})"
    return f"{significant(parameter.value, half)} ± {significant(half, half)}"


def error_percent(parameter: ParameterEstimate, truth: Mapping[str, float]) -> float:
    """Deviation from the truth [%]; NaN where the truth is zero."""
    true = truth[parameter.name]
    return PERCENT * (parameter.value - true) / true if true else float("nan")


def error_text(parameter: ParameterEstimate, truth: Mapping[str, float]) -> str:
    """Deviation from the truth in percent, absolute where the truth is zero."""
    if truth[parameter.name] == 0:
        return f"{parameter.value:+.2g}"
    return f"{error_percent(parameter, truth):+.2f} %"
