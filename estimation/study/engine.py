"""The one way from the study to fit and diagnosis: nothing else in `estimation.study` knows the engine."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.channel import ChannelData
from estimation.diagnosis import Diagnosis
from estimation.diagnosis.apart import Job, diagnose_apart
from estimation.diagnosis.bench.held_out import held_out_residual, rmse
from estimation.diagnosis.bench.standing import Standing, stand
from estimation.diagnosis.judgement.gate import refuse, usable
from estimation.diagnosis.judgement.intervals import final, values
from estimation.diagnosis.judgement.noise_floor import noise_floor
from estimation.diagnosis.judgement.objection import floor_unseen
from estimation.diagnosis.search.extend import extend
from estimation.effect import Effect
from estimation.estimate import ParameterEstimate
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
        noise_floor: error that a complete model would leave, as estimated beside this model.
    """

    data: ChannelData
    model: Model
    parameters: Mapping[str, ParameterEstimate]
    predicted: FloatArray
    residual: FloatArray
    judged: BoolArray
    rmse: float
    noise_floor: float
    standing: Standing = field(repr=False)


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
    if parent is None:
        if reason := refuse(data.select(good), model):
            raise InputError(f"channel '{data.name}': {reason}")
        return _fitted(stand(data, model, {}, good))
    return _fitted(extend(data, parent.standing, model.effects[-1], good))


def diagnose(
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    effects: Sequence[Effect],
    progress: Progress,
    file: str,
) -> Diagnosis:
    """What is missing in the models of these channels of one robot."""
    jobs = [Job(data, model, tuple(effects), SEED) for data, model in zip(channels, models, strict=True)]
    judged = diagnose_apart(jobs, os.cpu_count() or 1, progress)
    names = "+".join(dict.fromkeys(model.name for model in models))
    return Diagnosis(file=file, model=names, channels=[one.found for one in judged])


def _fitted(standing: Standing) -> Fitted:
    bench, trial = final(standing)
    found = {name: (one.value, one.std_err, one.unit) for name, one in values(bench, trial).items()}
    residual = held_out_residual(standing.plain.frame, standing.trial)
    floor = noise_floor(standing)
    lowest = min(floor.value, floor.repeats or np.inf, floor_unseen(standing, floor.value))
    return Fitted(
        data=standing.data,
        model=trial.model,
        parameters={name: _estimate(name, *one) for name, one in found.items()},
        predicted=trial.model.predict(standing.data, trial.parameters),
        residual=residual,
        judged=np.isfinite(residual),
        rmse=rmse(residual),
        noise_floor=lowest,
        standing=standing,
    )


def _estimate(name: str, value: float, std_err: float, unit: str) -> ParameterEstimate:
    half = SIGMAS_95 * std_err
    return ParameterEstimate(name, unit, value, std_err, (value - half, value + half))
