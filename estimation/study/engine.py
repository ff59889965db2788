"""The one way from the study to fit and diagnosis: nothing else in `estimation.study` knows the engine."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache, cached_property
from multiprocessing import current_process
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from estimation import diagnosis
from estimation.channel import ChannelData
from estimation.data_quality import reject_reason, usable
from estimation.diagnosis import Diagnosis
from estimation.diagnosis.bootstrap import SMALL
from estimation.diagnosis.candidates import applicable_effects, parameter_count, screen_effects
from estimation.effect import Effect
from estimation.effects import EFFECTS
from estimation.estimate import ParameterEstimate
from estimation.fit.fit_cache import FitCache
from estimation.fit.fit_problem import FitProblem, Solution, held_out_residual, rmse
from estimation.fit.fit_result import FitResult, fit_model, fit_problem
from estimation.fit.inner_search import GridSearch
from estimation.fit.intervals import estimate_parameters, final_solution
from estimation.fit.joint_load import LOAD, LUMPED, with_load
from estimation.model import Model
from estimation.physical import unphysical
from estimation.study import glance as first_look
from estimation.study.shown import Shown, Table, interval_text
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

SEED = 1  # of all random draws of a diagnosis
_MOST_STARTS = 3  # of a fit again, from where its gains made physical sense
Progress = Callable[[str, float], None]  # what is being done, and the share of it that is done
Judge = Callable[[Sequence[ChannelData], Sequence[Model], Sequence[Effect], Progress, str], Diagnosis]

_libraries = cache(ThreadpoolController)  # looking for them takes longer than some fits


def _one_thread() -> AbstractContextManager[Any]:
    """Small matrices: more threads take longer."""
    limits: AbstractContextManager[Any] = _libraries().limit(limits=1)
    return limits


@dataclass(frozen=True, eq=False, repr=False)
class Fitted(Shown):
    """A model fitted to a channel, and judged on runs that the fit has not seen."""

    result: FitResult  # the fit; what is derived from it is computed when it is first asked for
    # The channel with runs that were held out by choice, on which alone the model is judged then.
    whole: ChannelData | None = None

    @cached_property
    def data(self) -> ChannelData:
        """The channel, with the signals that were derived for the model."""
        if self.whole is None:
            return self.result.data
        return with_load(self.whole, self.model, self.result.solution.parameters)

    @property
    def model(self) -> Model:
        """What was fitted."""
        return self.result.solution.model

    @property
    def values(self) -> Mapping[str, float]:
        """Parameters by "effect.parameter" at once; `parameters` takes longer, for the noise's colour."""
        return self._last[1].parameters if "_last" in vars(self) else self.result.solution.parameters

    @cached_property
    def parameters(self) -> Mapping[str, ParameterEstimate]:
        """By "effect.parameter", with 95 % intervals."""
        with _one_thread():
            return estimate_parameters(*self._last)

    @cached_property
    def unphysical(self) -> tuple[str, ...]:
        """Gains that lie outside what is physical with their whole intervals, each in words."""
        solution = self._last[1]
        gains = self.model.gains
        return tuple(unphysical(gains, self.parameters.values(), solution.columns, solution.target).values())

    @cached_property
    def predicted(self) -> FloatArray:
        """Effort that the model expects, shape (n,)."""
        return self.at(self._last[1].parameters)

    def at(self, parameters: Mapping[str, float]) -> FloatArray:
        """Effort that the model would expect with other parameters, all by "effect.parameter", shape (n,)."""
        return self.model.predict(self.data, parameters)

    @cached_property
    def residual(self) -> FloatArray:
        """Effort less prediction from gains fitted to the other runs, (n,); NaN where not judged."""
        solution = self.result.solution
        if self.whole is None:
            return held_out_residual(self.result.problem.blocked, solution)
        blocked = fit_problem(
            self.whole, self.model, solution.parameters, usable(self.whole), FitCache()
        ).blocked
        rows = blocked.rows[blocked.trusted].ravel()
        rows = rows[~np.isin(self.whole.run[rows], self.result.data.runs)]
        residual = np.full(len(self.whole), np.nan)
        residual[rows] = (self.data.effort - self.at(solution.parameters))[rows]
        return residual

    @property
    def residual_on_blocks(self) -> FloatArray:
        """What the fit leaves on short blocks of samples, (m,), zero where not judged; known at once."""
        return np.where(self.result.problem.blocked.trusted, self.result.solution.residual, 0.0)

    @property
    def judged(self) -> BoolArray:
        """Samples that count in the error, shape (n,)."""
        return np.isfinite(self.residual)

    @property
    def rmse(self) -> float:
        """Root mean square of that residual."""
        return self.result.rmse if self.whole is None else rmse(self.residual)

    @cached_property
    def _last(self) -> tuple[FitProblem, Solution]:
        with _one_thread():
            return final_solution(self.result)

    @cached_property
    def rough(self) -> FitProblem:
        """Where effects beside this model are tried quickly."""
        return first_look.rough_bench(self.result)

    @cached_property
    def noise_floor(self) -> float:
        """Error that a complete model would leave where this is judged; see `FitResult.floor`."""
        with _one_thread():
            if self.whole is None:
                return self.result.floor()
            every = fit_model(self.whole, self.model, self.result.solution.parameters, usable(self.whole))
            return every.floor_in_runs(np.setdiff1d(self.whole.runs, self.result.data.runs))

    def _table(self) -> Table:
        rows = [(name, f"{p.value:.5g} {p.unit}", interval_text(p)) for name, p in self.parameters.items()]
        names = " + ".join(effect.name for effect in self.model.effects)
        caption = (
            f"{names} of {self.data.name}: {self.rmse:.4g} {self.data.kind.effort_unit} in held-out runs"
        )
        return Table(caption, ("parameter", "value", "95 % interval"), rows)


def fit(
    data: ChannelData, model: Model, parent: Fitted | None = None, whole: ChannelData | None = None
) -> Fitted:
    """Fit a model, from the parameters of the one that it was made of.

    Args:
        data: the channel.
        model: what to fit: that of the parent and one effect more, if there is a parent.
        parent: the model without its last effect.
        whole: the channel with runs that are held out by choice, if there are any.

    Raises:
        InputError: the channel cannot be judged; the message says why.
    """
    good = usable(data)
    with _one_thread():
        if parent is not None:
            return Fitted(_extended(data, parent.result, model.effects[-1], good), whole)
        if reason := reject_reason(data, model):
            raise InputError(f"channel '{data.name}': {reason}")
        return Fitted(fit_model(data, model, {}, good), whole)


def glance(parent: Fitted, effect: Effect) -> Fitted:
    """What `fit` of one effect more is going to give, roughly: within a few hundredths of a second."""
    with _one_thread():
        return Fitted(first_look.glance(parent.result, effect, parent.rough), parent.whole)


def likeliest(fitted: Fitted, names: Sequence[str]) -> tuple[str, ...]:
    """These effects by what each alone leaves in held-out runs; behind them what cannot be tried.

    Of those that leave about as little as the best, the simplest comes first.
    """
    there = applicable_effects(fitted.result.data, fitted.model, [EFFECTS[name]() for name in names])
    with _one_thread():
        tried = screen_effects(fitted.result, there) if len(there) > 1 else []
    least = tried[0].held_out * (1.0 + SMALL) ** 2 if tried else 0.0
    tried.sort(
        key=lambda one: (0.0, parameter_count(one.effect)) if one.held_out <= least else (one.held_out, 0)
    )
    order = [one.effect.name for one in tried]
    return (*order, *(name for name in names if name not in order))


@dataclass(frozen=True, eq=False)
class Packed:
    """A fit without what all fits of a channel share, to be sent from another process."""

    solution: Solution  # the model fitted
    trusted: BoolArray  # blocks that count, shape (m,)
    derived: dict[str, FloatArray]  # signals that were derived for this model, by name, each (n,)

    def unpacked(self, data: ChannelData, other: Fitted) -> Fitted:
        """The fit to `data`, beside another fit to it."""
        data = replace(data, context={**data.context, **self.derived})
        blocked = replace(
            other.result.problem.blocked, data=data, trusted=self.trusted, load_cache=FitCache()
        )
        return Fitted(
            FitResult(data, FitProblem(blocked, other.result.problem.noise_model), self.solution), other.whole
        )


def pack(fitted: Fitted) -> Packed:
    """A fit, as small as it can be sent."""
    result = fitted.result
    derived = {name: result.data.context[name] for name in (LOAD, LUMPED) if name in result.data.context}
    return Packed(result.solution, result.problem.blocked.trusted, derived)


def fit_held(data: ChannelData, fitted: Fitted, held: Mapping[str, float]) -> Fitted:
    """Fit a model again from where it is, with some parameters held at these values."""
    with _one_thread():
        result = fit_model(data, replace(fitted.model, held=held), fitted.values, usable(data))
        return Fitted(result, fitted.whole)


def _extended(data: ChannelData, result: FitResult, effect: Effect, good: BoolArray) -> FitResult:
    """The model of `standing` with one more effect, fitted from where that did best, possible or not.

    At inner parameters of zero, a speed or a time that effort is divided by, nothing could be fitted. Some
    pairs (where a surface lies, and how its spring bends) have several minima: a fit begins from each place
    that may lead to another, and one that makes no physical sense must leave far less than one that does.
    """
    search, cache = screen_effects(result, [effect])[0].search, result.problem.blocked.cache
    found = [fit_model(data, search.best.model, start, good, cache) for start in _starts(result, search)]
    return min(found, key=lambda one: one.mean_square * (1.0 + SMALL * (not one.solution.is_physical)) ** 2)


def _starts(result: FitResult, search: GridSearch) -> list[Mapping[str, float]]:
    """Where the effect did best, also as the model stood before; and some that made sense if that did not."""
    best, before = search.best, result.solution
    starts = [best.parameters, {**best.parameters, **{n: before.parameters[n] for n in before.model.inner}}]
    if not best.is_physical:
        sensible = [solution for solution in search.starts if solution.is_physical]
        starts += [
            solution.parameters for solution in sorted(sensible, key=lambda one: one.sse)[:_MOST_STARTS]
        ]
    return [one for number, one in enumerate(starts) if one not in starts[:number]]


def diagnose(
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    effects: Sequence[Effect],
    progress: Progress,
    file: str,
) -> Diagnosis:
    """What is missing in the models of these channels of one robot."""
    # A worker of a sweep is one of many, and may start no others; these do not know effects of a user's file.
    own = all(type(effect).__module__.startswith("estimation.") for effect in effects)
    processes = os.cpu_count() or 1 if own and not current_process().daemon else 1
    with _one_thread():
        return diagnosis.diagnose(
            channels,
            models,
            effects,
            rng=np.random.default_rng(SEED),
            progress=progress,
            file=file,
            processes=processes,
        )
