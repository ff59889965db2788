"""Result of a diagnosis, with stable keys that docs/reference/json.md documents."""

from collections.abc import Mapping
from enum import StrEnum
from math import isfinite, nan
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

from palpate.estimation.design.next_experiment import NextExperiment
from palpate.estimation.diagnosis.extension import PackedFit
from palpate.estimation.diagnosis.forms import Form
from palpate.estimation.estimate import DisplayTable, ParameterEstimate, TableDisplay
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.fit.measurement_noise import MeasurementNoise, NoiseSource
from palpate.estimation.kinds import Kind


class Verdict(StrEnum):
    """The verdict on one channel."""

    ADEQUATE = "adequate"  # the data show no missing effect
    MISSING = "missing"  # effects are missing and named; more may be missing
    UNEXPLAINED = "unexplained"  # the residual has structure, and no effect is accepted
    INSUFFICIENT = "insufficient"  # the data do not allow a verdict


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ParameterValue(_Entry):
    """One parameter; `std_err` is None if undetermined, `at_bound` states whether it is at a search bound."""

    value: float
    std_err: float | None
    unit: str
    at_bound: bool = False

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval; not a number if undetermined."""
        half = nan if self.std_err is None else SIGMAS_95 * self.std_err
        return self.value - half, self.value + half

    @property
    def interval_text(self) -> str:
        """The 95 % interval, or why there is none."""
        if self.at_bound or self.std_err is None:
            return "at its bound" if self.at_bound else "not determined"
        return "{:.5g} to {:.5g}".format(*self.interval)

    @classmethod
    def of(cls, estimate: ParameterEstimate) -> Self:
        """Convert an estimate; an infinite standard error becomes None.

        Args:
            estimate: value with its standard error.
        """
        std_err = estimate.std_err if isfinite(estimate.std_err) else None
        return cls(value=estimate.value, std_err=std_err, unit=estimate.unit, at_bound=estimate.at_bound)


Parameters = dict[str, ParameterValue]


class FitSummary(_Entry):
    """A model's held-out error in the effort's unit, and its parameters by "effect.parameter"."""

    rmse: float
    parameters: Parameters
    # The same for means over blocks, on which derived velocities are resolved; None in older files.
    rmse_of_means: float | None = None
    samples_per_mean: int = 1

    @classmethod
    def of(cls, fit: FitResult) -> Self:
        """Extract the numbers of a fit.

        Args:
            fit: the fitted model.
        """
        return cls(
            rmse=fit.rmse,
            parameters=_parameters(fit),
            rmse_of_means=float(np.sqrt(fit.held_out_mean_square)),
            samples_per_mean=fit.problem.blocked.rows.shape[1],
        )


class AcceptedEffect(_Entry):
    """An effect that is missing from the base model."""

    effect: str  # name of the effect
    form: Form = Form.EXACT  # how well its form is known
    parameters: Parameters  # its parameters, by name
    rmse_before: float  # held-out error without the effect
    rmse_after: float  # held-out error with the effect
    # Probability that the best candidate improves noise as much; 0 if the improvement is clear without a
    # test.
    p_value: float
    confused_with: list[str]  # effects that the data cannot distinguish from it
    physics: str  # one-line description of the physics
    equation: str  # equation of its term
    signature: str  # how it appears in the data


class BudgetShare(_Entry):
    """Shares of the base model's squared held-out error that one kind of effect accounts for."""

    kind: Kind  # see `palpate.estimation.kinds`
    share: float  # Shapley value among the listed kinds, with differences between runs last
    interval: tuple[float, float]  # 95 % interval over runs
    necessary: float  # share lost without the kind, if all other kinds remain
    sufficient: float  # share explained by the kind alone
    form: Form  # how well the form of its effects is known
    effects: list[str]  # accepted effects; if the form is unknown, the closest ones
    replaceable_by: list[Kind]  # kinds that explain about as much in its place
    experiment: str  # experiment that separates it from the first of these; empty if there is none


class BudgetRest(_Entry):
    """Shares of the base model's squared held-out error that no kind accounts for."""

    noise: float  # share of the noise; an upper bound if the noise level is an upper bound
    unexplained: float  # remaining share


class RankedEffect(_Entry):
    """A single effect that was added to the base model."""

    effect: str  # name of the effect
    rmse_held_out: float  # held-out error with the effect, inner parameters chosen on the other runs
    score: float  # relative decrease of the error


class RemainingError(_Entry):
    """Error that remains with all accepted effects."""

    rmse: float  # held-out error
    times_floor: float  # ratio to the noise level
    depends_on: list[str]  # signals on which it depends; empty if it is noise


class NoiseFloor(_Entry):
    """Noise level with its source, in the unit of the effort."""

    value: float  # held-out error of a complete model
    source: NoiseSource = NoiseSource.FLEXIBLE  # method of estimation
    at_most: bool = True  # whether it is only an upper bound
    motion: bool = False  # whether reading errors of the motion are a relevant part of it
    free_air: float | None  # noise before the first touch of each run; None if there is no free air
    share_left: float  # share of the final error on blocks that a flexible regression still explains


class ChannelDiagnosis(TableDisplay, _Entry):
    """The diagnosis of one channel; most fields are empty if the data are insufficient."""

    channel: str  # name of the channel
    verdict: Verdict  # see `Verdict`
    reason: str  # one sentence
    effort_unit: str  # unit of all errors
    noise_floor: float | None = None  # held-out error of a complete model
    floor: NoiseFloor | None = None  # the same with its source
    budget: list[BudgetShare] = Field(default_factory=list)  # shares of the base model's error, largest first
    rest: BudgetRest | None = None  # remaining shares of this error
    baseline: FitSummary | None = None  # the base model
    accepted: list[AcceptedEffect] = Field(default_factory=list)  # missing effects, the most important first
    # The most promising candidates, each added alone to the base model.
    ranking: list[RankedEffect] = Field(default_factory=list)
    final: FitSummary | None = None  # the model with all accepted effects
    # Whether the data show only noise in the residual of the final model; None if insufficient.
    complete: bool | None = None
    remaining: RemainingError | None = None  # error of the final model
    depends_on: list[str] = Field(default_factory=list)  # the same as in `remaining`
    differs_between_runs: str = ""  # the parameter that alone differs, with its range
    next_experiment: NextExperiment | None = None  # the most informative one; None if none would help
    no_experiment: str = ""  # states that none is expected to separate the explanations; empty otherwise
    # What other channels of the arm contradict or make doubtful, one sentence each, without a period.
    cautions: list[str] = Field(default_factory=list)
    # How a very long recording was averaged, and why no information is lost; empty otherwise.
    averaged: str = ""
    recovers: bool = False  # whether relaxation in earlier runs is taken to have no effect
    # Rate at which the object recovers in free air, relative to its relaxation in contact; 1 if equal.
    recovery_ratio: float = 1.0
    warnings: list[str] = Field(default_factory=list)  # implausible properties of the data, with their values
    _fits: Mapping[tuple[str, ...], PackedFit] = PrivateAttr(default_factory=dict)
    _noise: MeasurementNoise | None = PrivateAttr(None)

    def _table(self) -> DisplayTable:
        rows = [
            (name, f"{value.value:.5g} {value.unit}", value.interval_text)
            for name, value in (self.final.parameters if self.final else {}).items()
        ]
        caption = f"{self.channel}: {self.verdict}; {self.reason}"
        return DisplayTable(caption, ("parameter", "value", "95 % interval"), rows)

    def with_fits(self, fits: Mapping[tuple[str, ...], FitResult], noise: MeasurementNoise) -> Self:
        """Return a copy with the fits and the noise from which the numbers were computed.

        Args:
            fits: fits by the names of the added effects, in order.
            noise: noise of the channel.
        """
        copy = self.model_copy()
        copy._noise = noise
        copy._fits = {effects: PackedFit.of(fit) for effects, fit in fits.items()}
        return copy

    def take_fits(self) -> Mapping[tuple[str, ...], PackedFit]:
        """Return the attached fits by the names of the added effects, and release them."""
        fits, self._fits = self._fits, {}
        return fits

    def take_noise(self) -> MeasurementNoise | None:
        """Return the attached noise of the channel, None if there is none, and release it."""
        noise, self._noise = self._noise, None
        return noise


class Diagnosis(_Entry):
    """The diagnoses of all channels of a file."""

    file: str
    model: str
    channels: list[ChannelDiagnosis]


def stage_numbers(
    effect: str, before: FitResult, after: FitResult, final: FitResult, spread: ParameterValue | None = None
) -> dict[str, Any]:
    """Compute the fields of `AcceptedEffect`, by name, that describe one effect and its contribution.

    Args:
        effect: name of the effect.
        before: the model without the effect.
        after: the model with the effect, all parameters refitted.
        final: the model with all effects, whose parameters are reported (those of `after` are biased).
        spread: standard deviation between runs of a random effect; None for other effects.
    """
    prefix = f"{effect}."
    own = {
        name.removeprefix(prefix): value
        for name, value in _parameters(final).items()
        if name.startswith(prefix)
    }
    own |= {} if spread is None else {"spread": spread}
    (described,) = (part for part in final.solution.model.effects if part.name == effect)
    return {
        "rmse_before": before.rmse,
        "rmse_after": after.rmse,
        "parameters": own,
        "physics": described.describe_physics({name: number.value for name, number in own.items()}),
        "equation": described.equation,
        "signature": described.signature,
    }


def _parameters(fit: FitResult) -> Parameters:
    return {name: ParameterValue.of(estimate) for name, estimate in fit.parameters.items()}
