"""Estimate the parameters of a channel with several estimators."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.estimation.base_model import NO_ARM, Arm
from palpate.estimation.channel import ChannelData, Surface
from palpate.estimation.data_quality.readings import copied_runs
from palpate.estimation.estimate import DisplayTable, Estimate, Identifiability, TableDisplay, interval_text
from palpate.estimation.estimate_channel import estimate_channel, fitting_rows, lifted_rows
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.fit.fit_problem import Solution
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.statistics.correlation import residual_scale
from palpate.estimation.study.channels import base_model
from palpate.estimation.study.source import DataSource
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray

PREFERRED = ("robust", "weighted", "lsq")  # estimators in order of preference, if only one can be shown
MIN_INLIER_SHARE = 0.8  # least share of samples that the best estimate must use
ALL = "all"
DEFAULT_ESTIMATORS = ("lsq", "robust", "ransac")  # default estimators
SEED = 1  # seed of RANSAC's random subsets
OFFSET_NAME = "contact_offset.offset"


@dataclass(frozen=True, repr=False)
class ChannelEstimates(TableDisplay):
    """The estimates of one channel by several estimators."""

    channel: ChannelData  # all samples
    rows: BoolArray  # mask of the fitted samples, shape (n,)
    model: Model  # the fitted model
    estimates: tuple[Estimate, ...]  # one estimate for each successful estimator, at least one
    failures: Mapping[str, str] = field(default_factory=dict)  # reasons of failed estimators, by name
    noise: MeasurementNoise | None = None  # noise of the channel; None if it cannot be estimated

    @property
    def best(self) -> Estimate:
        """The first of the `PREFERRED` estimates that used most samples and determines the parameters.

        If a robust method rejects many samples, the model is probably wrong, not the samples. Without such an
        estimate, the first one in the order of `PREFERRED`, or the first of all, is returned.
        """
        by_name = {estimate.estimator: estimate for estimate in self.estimates}
        ranked = [by_name[name] for name in PREFERRED if name in by_name]
        determined = (e for e in ranked if e.identifiability is not Identifiability.NONE)
        trusted = [estimate for estimate in determined if np.mean(estimate.inliers) >= MIN_INLIER_SHARE]
        return (trusted or ranked or list(self.estimates))[0]

    @property
    def misfit(self) -> float:
        """Ratio of the best estimate's residual to the noise; NaN if the noise is unknown."""
        if self.noise is None or not self.noise.value > 0.0:
            return float("nan")
        return residual_scale(self.best.residuals) / self.noise.value

    def surface_of(self, estimate: Estimate) -> Surface | None:
        """Return the surface by this estimate, not deeper than the contact; None if the depth was recorded.

        Args:
            estimate: estimate of one estimator.
        """
        surface = self.channel.surface
        if surface is None:
            return None
        offset = next((parameter for parameter in estimate.parameters if parameter.name == OFFSET_NAME), None)
        if offset is None:
            return surface
        std_err_m = offset.std_err if np.isfinite(offset.std_err) else surface.std_err_m
        position_m = min(surface.position_m + offset.value, surface.deepest_m)
        return replace(surface, position_m=position_m, std_err_m=std_err_m)

    def prediction(self) -> FloatArray:
        """Return the effort predicted by the best estimate for the whole channel, shape (n,)."""
        return self.model.predict(self.channel, {p.name: p.value for p in self.best.parameters})

    def _table(self) -> DisplayTable:
        rows = [
            (estimate.estimator, p.name, f"{p.value:.5g} {p.unit}", interval_text(p))
            for estimate in self.estimates
            for p in estimate.parameters
        ]
        columns = ("estimator", "parameter", "value", "95 % interval")
        return DisplayTable(f"{self.model.name} of {self.channel.name}", columns, rows)


def choose_estimators(names: str | Sequence[str]) -> list[str]:
    """Return the registered names of estimators.

    Args:
        names: "all", names separated by commas, or a list of names.

    Raises:
        InputError: a name is unknown or appears twice.
    """
    if names == ALL:
        return list(ESTIMATORS)
    parts = names.split(",") if isinstance(names, str) else names
    if not (isinstance(parts, list | tuple) and all(isinstance(part, str) for part in parts)):
        raise InputError(f"estimator {names!r}: give names, or '{ALL}'")
    chosen = [part.strip() for part in parts if part.strip()]
    if not chosen:
        raise InputError(f"estimator '{names}': give names separated by commas, or {ALL}")
    if duplicates := {name for name in chosen if chosen.count(name) > 1}:
        raise InputError(f"estimator '{names}': {min(duplicates)} appears twice")
    return [ESTIMATORS[name].name for name in chosen]


def only_runs(channel: ChannelData, runs: Sequence[int], source: DataSource) -> ChannelData:
    """Return the channel with only some runs, by their recorded numbers.

    Args:
        channel: the channel with all runs.
        runs: numbers of the recorded runs to keep.
        source: the measurement.

    Raises:
        InputError: the channel has no such run, or a run appears twice.
    """
    if not (isinstance(runs, list | tuple) and all(isinstance(run, int) for run in runs)):
        raise InputError(f"runs {runs!r}: give a list of run numbers, such as [0, 2]")
    if len(set(runs)) < len(runs):
        raise InputError(f"runs {runs!r}: a run appears twice")
    recorded = sorted(set(source.recorded(channel)))
    if missing := sorted(set(runs).difference(recorded)):
        listed = ", ".join(map(str, recorded[:20]))
        raise InputError(
            f"runs {runs!r}: channel '{channel.name}' has no run {missing[0]}. Available: {listed}"
        )
    return channel.of_runs(np.array(source.runs_of(channel, runs)))


def estimate_with(
    channel: ChannelData, model_name: str, estimators: Sequence[str], arm: Arm = NO_ARM
) -> ChannelEstimates:
    """Fit one model to one channel with several estimators; copies of a run are excluded.

    Args:
        channel: channel of a kind that the model describes.
        model_name: name of the base model.
        estimators: names of the estimators.
        arm: arm to which the channel belongs, for models that need it.

    Raises:
        InputError: the model lacks required information, has no parameters, or all estimators fail.
    """
    base, context = MODELS[model_name](), arm.context_of(channel)
    model = base_model(channel, model_name, context)
    held = {name.partition(".")[0] for name in model.held}
    model = model.without(*(name for name in held if len(model.effect(name).gains) == 1))  # zero adds nothing
    if not model.gains:
        raise InputError(f"model '{model_name}' has no free parameter, so there is nothing to estimate")
    channel = base.prepare(channel, context)
    rows = fitting_rows(channel) & ~np.isin(channel.run, list(copied_runs(channel)))
    rows[lifted_rows(channel, model, rows)] = False
    estimates, failures, searched = [], {}, dict[bool, Solution]()
    for name in estimators:
        try:
            estimator, rng = ESTIMATORS[name](), np.random.default_rng(SEED)
            estimates.append(
                estimate_channel(channel, model, estimator, rng=rng, rows=rows, searched=searched)
            )
        except InputError as error:
            failures[name] = str(error).removeprefix(f"{name}: ")
    if not estimates:
        name, problem = next(iter(failures.items()))
        raise InputError(f"estimator '{name}': {problem}")
    return ChannelEstimates(channel, rows, model, tuple(estimates), failures)
