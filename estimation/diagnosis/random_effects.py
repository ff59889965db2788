"""What differs from run to run, beside a model whose search has ended.

Such an effect is a random one: each run has a value of its own, which its first part tells and the rest of
it confirms (C. R. Henderson, Biometrics 31 (1975)). It is tried last and only where runs disagree, since it
would take up a part of anything that changes slowly.
"""

import numpy as np

from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.diagnosis.search import Search
from palpate.estimation.effects.run_differences import RunGain, RunOffset, RunVariation
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.run_heterogeneity import run_heterogeneity


def add_run_variation(search: Search, fit: FitResult) -> FitResult:
    """The model with a gain or a zero for each run where that is all that runs differ in; else as it is.

    Effects that the variation makes needless are left out.

    Args:
        search: of the channel.
        fit: the model that its search has led to.
    """
    if run_heterogeneity(fit.problem.blocked, fit.solution) is None:
        return fit
    present = {part.name for part in fit.solution.model.effects}
    made = []
    for effect in search.effects:
        if (
            isinstance(effect, RunGain | RunOffset)
            and effect.name not in present
            and effect.applies_to(fit.data)
        ):
            start = {f"{effect.name}.share": effect.starts(fit.data)[-1]["share"]}
            with_it = search.fitted(fit.solution.model.with_effect(effect), fit.solution.parameters | start)
            if search.is_sound(with_it, effect.name):
                made.append(with_it)
    same = [
        made_fit
        for made_fit in made
        if run_heterogeneity(made_fit.problem.blocked, made_fit.solution) is None
    ]
    if not same or not search.is_needed(fit, varied := search.ordered(same)[0]):
        return fit
    for name in search.added_effects(varied):  # drop effects that stood for the difference between runs
        less = search.without(varied, name)
        if not search.is_needed(less, varied):
            varied = less
    return varied


def run_standard_deviation(end: FitResult, effect: RunVariation) -> ParameterValue:
    """How far a value lies from run to run, as a standard deviation, with its own error.

    Args:
        end: the model.
        effect: which varies from run to run.
    """
    model, known, data = end.solution.model, end.solution.parameters, end.data
    inner = {parameter.name: known[f"{effect.name}.{parameter.name}"] for parameter in effect.inner}
    value = float(effect.spread(model.without(effect.name).predict(data, known), data, inner)[0])
    error = value / float(np.sqrt(2.0 * (len(data.runs) - 1)))
    unit = "1" if isinstance(effect, RunGain) else data.kind.effort_unit
    return ParameterValue(value=value, std_err=error, unit=unit, at_bound=False)
