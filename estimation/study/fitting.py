"""Fit, preview and diagnose models of a channel for a study.

All random generators have a fixed seed, so that the same data give the same results in any process.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from multiprocessing import current_process

import numpy as np

from palpate.estimation import diagnosis
from palpate.estimation.base_model import ModelContext
from palpate.estimation.budget.laws import OBJECT_KINDS
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data_quality import reject_reason, usable
from palpate.estimation.diagnosis import Diagnosis
from palpate.estimation.diagnosis.candidates import extended_models
from palpate.estimation.diagnosis.forms import error_of_kinds
from palpate.estimation.effect import Effect
from palpate.estimation.effects.elastic_shape import CubicStiffness
from palpate.estimation.effects.time_memory import RelaxationSpectrum, StressRelaxation
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import NOISE_RATIO, FitResult, Validation, fit_model
from palpate.estimation.fit.inner_search import optimize_inner, search_inner
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.signals.blocks import has_one_clock, number_stretches
from palpate.estimation.workers import single_threaded
from palpate.robot_io.errors import InputError

SEED = 1  # seed of the random generator of a diagnosis
_PREVIEW_STARTS = 6  # approximate number of start values of a preview
_PREVIEW_TOLERANCE = 0.01  # least relative decrease of the squared error in a step of a preview
Progress = Callable[[str, float], None]  # receives the current step and its completed share, from 0 to 1
Judge = Callable[[Sequence[ChannelData], Sequence[Model], Sequence[Effect], Progress, str], Diagnosis]


def fit_base(data: ChannelData, model: Model, full_data: ChannelData | None = None) -> FitResult:
    """Fit a base model to a channel.

    Args:
        data: the channel with the runs used for fitting.
        model: the base model.
        full_data: the channel with all runs, if the user holds out some; None to score by cross-validation.

    Raises:
        InputError: the channel cannot be fitted; the message states the reason.
    """
    if reason := reject_reason(data):
        raise InputError(f"channel '{data.name}': {reason}")
    with single_threaded():
        fit = fit_model(data, model, {}, usable(data))
        return fit if full_data is None else replace(fit, validation=Validation(full_data, usable(full_data)))


_RELAXING_RATIO = 0.9  # ratio of held-out errors below which an object relaxes
_RECOVERED_RATIO = 0.9  # the same below which it is taken to recover between runs
_WORSE_RATIO = 1.05  # the same above which it is not, whatever the flexible laws show
_REPEATS = 20  # most fits until the ratio of a recovery agrees with the shares of the object's branches
_CONVERGED = 1e-3  # relative change of this ratio at which they agree
_SMALLEST_RATIO = 0.01
_FIRST_RATIO = 0.5  # from which the search starts, and with which an object is tested for relaxation


def surface_recovers(data: ChannelData) -> bool:
    """Return whether the surface of a damped object is taken to recover before the tip touches it again.

    It is if a cubic spring with a damper then predicts held-out runs better, from one run to the next or
    within each run.

    Args:
        data: a channel; the result is False for joints.
    """
    if data.kind is not ChannelKind.CONTACT or reject_reason(data):
        return False
    model = MODELS["kelvin_voigt"]().build(ModelContext(surface_found=data.surface is not None))
    hardening, good = model.with_effect(CubicStiffness()), usable(data)
    free = (replace(data, surface_recovers=True, recovers=recovers) for recovers in (False, True))
    with single_threaded():
        at_once, *errors = (fit_model(each, hardening, {}, good).rmse for each in (data, *free))
    return min(errors) < _RECOVERED_RATIO * at_once


def recovery(data: ChannelData) -> tuple[bool, float, float]:
    """Return whether an object has recovered when each run begins, and how fast it recovers if it relaxes.

    It has recovered if each run presses another spot or specimen, or if the object rests for long enough.
    Without the memory of earlier runs, a cubic spring with a damper then predicts held-out runs better. If
    the object relaxes, the flexible laws of its kinds do, and a cubic spring with one relaxation must not
    predict them worse, since few runs allow a chance result. Otherwise, the surface of an object that relaxes
    is taken to be free between contacts if this lowers the held-out error of the cubic spring with one
    relaxation, or of one with two branches, and of the flexible laws. If one relaxation leaves only noise, no
    missing effect can imitate a free surface, and the smaller held-out error decides.

    Args:
        data: a contact channel; the results are False, 1 and 0 for other channels, and for runs without a
            common clock.

    Returns:
        Values of `recovers`, `recovery_ratio` and `retardation_s` of `ChannelData`.
    """
    has_memory = (
        data.kind is ChannelKind.CONTACT
        and has_one_clock(data.time_s, data.run)
        and len(np.unique(number_stretches(data.engaged, data.run)[data.engaged])) > 1
    )
    if not has_memory or reject_reason(data):
        return False, 1.0, 0.0
    context = ModelContext(surface_found=data.surface is not None)
    spring, good = MODELS["kelvin_voigt"]().build(context), usable(data)
    hardening = spring.with_effect(CubicStiffness())
    relaxing = hardening.with_effect(StressRelaxation())
    continued, recovered = (replace(data, recovers=each) for each in (False, True))
    free = replace(continued, recovery_ratio=_FIRST_RATIO)
    with single_threaded():
        fits = [fit_model(each, relaxing, {}, good) for each in (continued, recovered, free)]
        errors = [fit.rmse for fit in fits]
        remembering, fresh = (fit_model(each, hardening, {}, good).rmse for each in (continued, recovered))
        if min(errors) > _RELAXING_RATIO * min(remembering, fresh):
            return fresh < _RECOVERED_RATIO * remembering, 1.0, 0.0

        def improves(other: ChannelData, ratio: float) -> bool:
            """Return whether the flexible laws of the object predict held-out runs better by a ratio."""
            laws = (error_of_kinds(fit_model(each, spring, {}, good)) for each in (continued, other))
            before, after = (law.mean_square(OBJECT_KINDS) for law in laws)
            return bool(after < ratio**2 * before)

        may_recover = len(data.runs) > 1 and errors[1] < _WORSE_RATIO * errors[0]
        if may_recover and improves(recovered, _RECOVERED_RATIO):
            return True, 1.0, 0.0
        is_noise = fits[0].rmse < NOISE_RATIO * fits[0].floor()
        limit = errors[0] if is_noise else _RECOVERED_RATIO * errors[0]
        surface = _free_surface(continued, hardening, fits[2], limit)
        # A free surface is the physical case and adds no parameter, so any clear improvement is enough here.
        is_free = surface is not continued and (is_noise or improves(surface, 1.0 / _WORSE_RATIO))
        return (False, surface.recovery_ratio, surface.retardation_s) if is_free else (False, 1.0, 0.0)


def _free_surface(data: ChannelData, base: Model, free: FitResult, limit: float) -> ChannelData:
    """Return the channel with a free surface, or unchanged if that predicts held-out runs no better.

    A free surface adds no parameter, since the shares of the relaxing branches and the damping determine it.

    Args:
        data: a contact channel with one clock for all runs.
        base: a model without relaxation.
        free: fit of the base model and `stress_relaxation`, with the ratio `_FIRST_RATIO`.
        limit: largest held-out error with which the surface is taken to be free [effort].
    """
    good, ratio, surface = usable(data), _FIRST_RATIO, data
    for repeat in range(_REPEATS):
        stiffness = free.values["stiffness.k"]
        sudden = max(stiffness + free.values["stress_relaxation.k1"], 1e-300)
        # The mean also converges where the object hardly recovers and the fits would alternate.
        before, ratio = ratio, max(0.5 * (ratio + stiffness / sudden), _SMALLEST_RATIO)
        if repeat and abs(ratio - before) < _CONVERGED * ratio:
            break
        retardation_s = free.values["damping.c"] / sudden
        surface = replace(data, recovery_ratio=ratio, retardation_s=retardation_s)
        free = fit_model(surface, free.model, free.values, good)
    if free.rmse < limit:
        return surface
    # A second branch may cause more error than a held surface, so both are compared with two branches too.
    share, tau_s = 0.5 * (1.0 - ratio), free.values["stress_relaxation.tau"]
    start = {"fast": share, "slow": share, "fast_time": 0.2 * tau_s, "slow_time": 2.0 * tau_s}
    named = {f"relaxation_spectrum.{name}": value for name, value in start.items()}
    spectrum = base.with_effect(RelaxationSpectrum())
    held, free = (fit_model(each, spectrum, named, good) for each in (data, surface))
    if free.rmse > min(limit, _RECOVERED_RATIO * held.rmse):
        return data
    values = free.values
    shares = values["relaxation_spectrum.fast"] + values["relaxation_spectrum.slow"]
    # Of a purely cubic object, the linear stiffness is zero.
    secant = values["stiffness.k"] + values["cubic_stiffness.k3"] * data.deepest**2
    retardation_s = values["damping.c"] / max(secant, 1e-300)
    ratio = max(1.0 - float(shares), _SMALLEST_RATIO)
    return replace(data, recovery_ratio=ratio, retardation_s=retardation_s)


def preview_extended(parent: FitResult, effect: Effect) -> FitResult:
    """Approximate `fit_extended` within a few hundredths of a second, on block averages and with few starts.

    Args:
        parent: the model without the effect.
        effect: the effect to add, in the form that suits the channel.
    """
    with single_threaded():
        known, starts = parent.solution.parameters, effect.starts(parent.training)
        starts = starts[:: max(len(starts) // _PREVIEW_STARTS, 1)]
        searches = (
            search_inner(parent.coarse_problem, model, effect.name, known, starts)
            for model in extended_models(parent.model, effect)
        )
        best = min((search.best for search in searches), key=lambda solution: solution.sse)
        coarse = optimize_inner(parent.coarse_problem, best, _PREVIEW_TOLERANCE)
        solution = solve_gains(parent.problem, best.model, coarse.parameters)
        return FitResult(parent.training, parent.problem, solution, parent.validation)


def fit_held(data: ChannelData, fit: FitResult, held: Mapping[str, float]) -> FitResult:
    """Refit a model from its present parameters, with some of them held.

    Args:
        data: the channel with the runs used for fitting.
        fit: the fitted model.
        held: values of held parameters by "effect.parameter"; those that the base model holds stay held.
    """
    with single_threaded():
        refitted = fit_model(
            data, replace(fit.model, held={**fit.model.held, **held}), fit.values, usable(data)
        )
        return replace(refitted, validation=fit.validation)


def diagnose(
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    effects: Sequence[Effect],
    progress: Progress,
    file: str,
) -> Diagnosis:
    """Diagnose channels of one robot, in several processes if possible.

    Args:
        channels: the channels.
        models: the base model of each channel.
        effects: the library of candidate effects.
        progress: see `Progress`.
        file: name of the data, for the result.
    """
    # Workers of a sweep must not start processes, and user-defined effects are unknown in other processes.
    are_built_in = all(type(effect).__module__.startswith("palpate.estimation.") for effect in effects)
    processes = os.cpu_count() or 1 if are_built_in and not current_process().daemon else 1
    with single_threaded():
        return diagnosis.diagnose(
            channels,
            models,
            effects,
            rng=np.random.default_rng(SEED),
            progress=progress,
            file=file,
            processes=processes,
        )
