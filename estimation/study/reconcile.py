"""Makes a diagnosis state the study's own numbers, so that no other command can state others."""

import re
from collections.abc import Callable, Mapping, Sequence

from estimation.diagnosis import ChannelDiagnosis
from estimation.diagnosis.bootstrap import SMALL
from estimation.diagnosis.result import Accepted, ParameterValue, Ranked, Verdict
from estimation.diagnosis.result import Fitted as FittedEntry
from estimation.estimate import ParameterEstimate
from estimation.fit.fit_result import FitResult
from estimation.study.channels import StudyChannel
from robot_io.errors import InputError

Fit = Callable[[Sequence[str]], FitResult]  # from the effects that are added to the base model
MOST_FITTED = 3  # candidates that are fitted as `add` would


def reconcile(fit: Fit, channel: StudyChannel, found: ChannelDiagnosis) -> ChannelDiagnosis:
    """The answer with errors, parameters and floor from the fits that all other commands show."""
    if channel.held_out:  # a diagnosis judges each run that is fitted by the others
        return found
    if found.baseline is None or found.noise_floor is None:
        return found
    names = [entry.effect for entry in found.accepted]
    fits = [fit(names[:count]) for count in range(len(names) + 1)]
    accepted = [_accepted(*one) for one in zip(found.accepted, fits, fits[1:], strict=False)]
    last = fits[-1].rmse
    times = last / found.noise_floor if found.noise_floor > 0.0 else 1.0
    left = found.remaining
    ranking = _ranking(fit, found.ranking)
    return found.model_copy(
        update={
            "reason": _with_errors(reason_of(found, ranking), found, fits[0].rmse, last),
            "remaining": left and left.model_copy(update={"rmse": last, "times_floor": times}),
            "baseline": _entry(fits[0]),
            "final": _entry(fits[-1]),
            "accepted": accepted,
            "ranking": ranking,
        }
    )


def reason_of(found: ChannelDiagnosis, ranking: Sequence[Ranked]) -> str:
    """The reason; where nothing is established, with the single effect that takes away most."""
    if found.verdict is not Verdict.UNEXPLAINED or not ranking or ranking[0].score < SMALL:
        return found.reason
    best = f"{ranking[0].effect}, takes away {100 * ranking[0].score:.0f} % of the error"
    return f"{found.reason}; the best single effect, {best}, and is not established"


def _with_errors(reason: str, found: ChannelDiagnosis, base: float, last: float) -> str:
    """A reason with the study's errors in the place of the diagnosis's own."""
    told = {
        f"{entry.rmse:.3g} {found.effort_unit}": f"{error:.3g} {found.effort_unit}"
        for entry, error in ((found.baseline, base), (found.final, last))
        if entry
    }
    return re.sub("|".join(map(re.escape, told)), lambda one: told[one[0]], reason) if told else reason


def _accepted(entry: Accepted, before: FitResult, after: FitResult) -> Accepted:
    prefix = f"{entry.effect}."
    own = {n.removeprefix(prefix): p for n, p in _values(after.parameters).items() if n.startswith(prefix)}
    return entry.model_copy(
        update={
            "rmse_before": before.rmse,
            "rmse_after": after.rmse,
            "parameters": {**entry.parameters, **own},
        }
    )


def _ranking(fit: Fit, ranked: Sequence[Ranked]) -> list[Ranked]:
    """Those that promise to take away more than a small share of the error, as `add` would fit them."""
    base, fitted = fit([]).rmse, list[Ranked]()
    for entry in [one for one in ranked if one.score >= SMALL][:MOST_FITTED]:
        try:
            error = fit([entry.effect]).rmse
        except InputError:  # it cannot be fitted alone
            error = entry.rmse_held_out
        score = 1.0 - error / base if base > 0.0 else 0.0
        fitted.append(entry.model_copy(update={"rmse_held_out": error, "score": score}))
    return sorted(fitted, key=lambda one: one.rmse_held_out)


def _entry(fitted: FitResult) -> FittedEntry:
    return FittedEntry(rmse=fitted.rmse, parameters=_values(fitted.parameters))


def _values(parameters: Mapping[str, ParameterEstimate]) -> dict[str, ParameterValue]:
    return {name: ParameterValue.of(one) for name, one in parameters.items()}
