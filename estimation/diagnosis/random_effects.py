"""Random effects: parameters that differ from run to run, added to the result of a search.

The first part of each run determines the run's value, and the rest of the run tests it (C. R. Henderson,
Biometrics 31 (1975)). Such an effect is added last, and only if runs disagree, since it would absorb part of
any slow change.
"""

import numpy as np

from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.diagnosis.search import Search
from palpate.estimation.effects.run_differences import RunGain, RunOffset, RunVariation
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import run_heterogeneity


def add_run_variation(search: Search, fit: FitResult) -> FitResult:
    """Add a gain or a zero for each run if this removes all heterogeneity between runs.

    Effects that the variation makes needless are dropped.

    Args:
        search: the search of the channel.
        fit: the result of the search; it is returned unchanged if nothing is added.
    """
    if run_heterogeneity(fit.problem.blocked, fit.solution) is None:
        return fit
    present = {effect.name for effect in fit.solution.model.effects}
    homogeneous = []
    for effect in search.effects:
        if (
            isinstance(effect, RunGain | RunOffset)
            and effect.name not in present
            and effect.applies_to(fit.data)
        ):
            start = {f"{effect.name}.share": effect.starts(fit.data)[-1]["share"]}
            extended = search.fitted(fit.solution.model.with_effect(effect), fit.solution.parameters | start)
            is_sound = search.is_sound(extended, effect.name)
            if is_sound and run_heterogeneity(extended.problem.blocked, extended.solution) is None:
                homogeneous.append(extended)
    if not homogeneous or not search.is_needed(fit, varied := search.ordered(homogeneous)[0]):
        return fit
    for name in search.added_effects(varied):  # drop effects that imitated the variation between runs
        reduced = search.without(varied, name)
        if not search.is_needed(reduced, varied):
            varied = reduced
    return varied


def run_standard_deviation(end: FitResult, effect: RunVariation) -> ParameterValue:
    """Estimate the standard deviation of a random effect between runs, with its standard error.

    Args:
        end: the model.
        effect: the random effect.
    """
    model, known, data = end.solution.model, end.solution.parameters, end.data
    inner = {parameter.name: known[f"{effect.name}.{parameter.name}"] for parameter in effect.inner}
    value = float(effect.spread(model.without(effect.name).predict(data, known), data, inner)[0])
    error = value / float(np.sqrt(2.0 * (len(data.runs) - 1)))
    unit = "1" if isinstance(effect, RunGain) else data.kind.effort_unit
    return ParameterValue(value=value, std_err=error, unit=unit, at_bound=False)
