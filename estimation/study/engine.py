"""The one way from the study to fit and diagnosis: nothing else in `estimation.study` knows the engine."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from estimation import diagnosis
from estimation.channel import ChannelData
from estimation.diagnosis import Diagnosis
from estimation.diagnosis.candidates import try_all
from estimation.effect import Effect
from estimation.estimate import ParameterEstimate
from estimation.fit.held_out import held_out_residual
from estimation.fit.intervals import final, values
from estimation.fit.standing import Standing, stand
from estimation.gate import refuse, usable
from estimation.model import Model
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

SIGMAS_95 = 1.96
SEED = 1  # of all random draws of a diagnosis
Progress = Callable[[str, float], None]  # what is being done, and the share of it that is done


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to a channel, and judged on runs that the fit has not seen.

    Attributes:
        data: the channel, with the signals that were derived for the model.
        model: what was fitted.
        parameters: by "effect.parameter", with 95 % intervals.
        predicted: effort that the model expects, shape (n,).
        residual: effort less prediction from gains fitted to the other runs, (n,); NaN where not judged.
        judged: samples that count in the error, shape (n,).
        rmse: root mean square of that residual.
    """

    data: ChannelData
    model: Model
    parameters: Mapping[str, ParameterEstimate]
    predicted: FloatArray
    residual: FloatArray
    judged: BoolArray
    rmse: float
    standing: Standing = field(repr=False)

    @property
    def noise_floor(self) -> float:
        """Error that a complete model would leave, as a flexible regression beside this model has it."""
        with threadpool_limits(1):
            return self.standing.floor()


def fit(data: ChannelData, model: Model, parent: Fitted | None = None) -> Fitted:
    """Fit a model, from the parameters of the one that it was made of.

    Args:
        data: the channel.
        model: what to fit: that of the parent and one effect more, if there is a parent.
        parent: the model without its last effect.

    Raises:
        InputError: the channel cannot be judged; the message says why.
    """
    good = usable(data)
    with threadpool_limits(1):  # small matrices: more threads take longer
        if parent is not None:
            return _fitted(_extended(data, parent.standing, model.effects[-1], good))
        if reason := refuse(data.select(good), model):
            raise InputError(f"channel '{data.name}': {reason}")
        return _fitted(stand(data, model, {}, good))


def _extended(data: ChannelData, standing: Standing, effect: Effect, good: BoolArray) -> Standing:
    """The model of `standing` with one more effect, fitted from where that did best, possible or not.

    At inner parameters of zero, a speed or a time that effort is divided by, nothing could be fitted.
    """
    best = try_all(standing, [effect])[0].search.best
    return stand(data, best.model, best.parameters, good)


def diagnose(
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    effects: Sequence[Effect],
    progress: Progress,
    file: str,
) -> Diagnosis:
    """What is missing in the models of these channels of one robot."""
    with threadpool_limits(1):
        return diagnosis.diagnose(
            channels,
            models,
            effects,
            rng=np.random.default_rng(SEED),
            progress=progress,
            file=file,
            processes=os.cpu_count() or 1 if _importable(effects) else 1,
        )


def _importable(effects: Sequence[Effect]) -> bool:
    """Whether another process knows these effects; it does not know those of a user's file."""
    return all(type(effect).__module__.startswith("estimation.") for effect in effects)


def _fitted(standing: Standing) -> Fitted:
    bench, trial = final(standing)
    found = {name: (one.value, one.std_err, one.unit) for name, one in values(bench, trial).items()}
    residual = held_out_residual(standing.plain.frame, standing.trial)
    return Fitted(
        data=standing.data,
        model=trial.model,
        parameters={name: _estimate(name, *one) for name, one in found.items()},
        predicted=trial.model.predict(standing.data, trial.parameters),
        residual=residual,
        judged=np.isfinite(residual),
        rmse=standing.rmse,
        standing=standing,
    )


def _estimate(name: str, value: float, std_err: float, unit: str) -> ParameterEstimate:
    half = SIGMAS_95 * std_err
    return ParameterEstimate(name, unit, value, std_err, (value - half, value + half))
