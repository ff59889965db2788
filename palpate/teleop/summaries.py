"""What is known of an object, in one line for a person."""

from math import isfinite

from palpate.words import count, significant
from robot_io.link import EstimatedParameter, ObjectEstimate, short_number

_SHORT = {"stiffness.k": "k", "damping.c": "c"}
GEOMETRY = ("contact_offset.offset",)


def summarize_estimate(estimate: ObjectEstimate) -> str:
    """Its parameters with their 95 % intervals, what they leave, and the verdict."""
    shown = ", ".join(_parameter(one) for one in estimate.parameters if one.name not in GEOMETRY)
    verdict = f"; {estimate.verdict}" if estimate.verdict else ""
    return f"{shown}; {estimate.rmse_n:.3g} N left, {count(estimate.runs, 'run')}{verdict}"


def _parameter(one: EstimatedParameter) -> str:
    name, half = _SHORT.get(one.name, one.name), 0.5 * (one.upper - one.lower)
    if not (isfinite(half) and half > 0.0):
        return f"{name} {significant(one.value, half)} {one.unit}"
    return f"{name} {significant(one.value, half)} ± {significant(half, half)} {one.unit}"


def summarize_trust(estimate: ObjectEstimate | None, age_s: float, away_m: float) -> str:
    """How far the virtual object can be trusted.

    Args:
        estimate: that is felt; None for the scene's guess.
        age_s: of the measurement that it rests on [s]; NaN if not known.
        away_m: from where it was measured, across the press direction [m]; NaN if not known.
    """
    if estimate is None:
        return "virtual object: a guess, nothing was probed yet"
    age = f", {age_s:.0f} s old" if isfinite(age_s) else ""
    away = f", {1e3 * away_m:.0f} mm away" if isfinite(away_m) else ""
    verdict = "" if estimate.verdict else "; not diagnosed"
    return f"target {short_number(estimate.target)}{away}{age}: {summarize_estimate(estimate)}{verdict}"
