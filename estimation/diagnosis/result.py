"""The result of a diagnosis, in documented and stable keys (see docs/reference/json.md)."""

from collections.abc import Mapping
from enum import StrEnum
from math import isfinite
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

from palpate.estimation.design.next_experiment import NextExperiment
from palpate.estimation.diagnosis.extension import PackedFit
from palpate.estimation.diagnosis.forms import Form
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import NoiseSource
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
    """One parameter; `std_err` is None where undetermined, `at_bound` where an inner search ended at one."""

    value: float
    std_err: float | None
    unit: str
    at_bound: bool = False

    @classmethod
    def of(cls, estimate: ParameterEstimate) -> Self:
        """Convert an estimate; an infinite standard error becomes None.

        Args:
            estimate: value with its standard error.
        """
        std_err = estimate.std_err if isfinite(estimate.std_err) else None
        return cls(value=estimate.value, std_err=std_err, unit=estimate.unit, at_bound=estimate.at_bound)


Parameters = dict[str, ParameterValue]


class Fitted(_Entry):
    """A model's error in held-out runs, in the effort's unit, and its parameters by "effect.parameter"."""

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


class Accepted(_Entry):
    """An effect that is missing from the base model."""

    effect: str  # its name
    form: Form = Form.EXACT  # how well its form is known
    parameters: Parameters  # its own, by name
    rmse_before: float  # error in held-out runs without it
    rmse_after: float  # error with it
    # How often the best candidate improves noise by as much; 0 if the improvement is clear without a test.
    p_value: float
    confused_with: list[str]  # effects that the data cannot distinguish from it
    physics: str  # one line of what happens
    equation: str  # its term
    signature: str  # how it shows in the data


class BudgetShare(_Entry):
    """What one kind of effect accounts for, as shares of the base model's squared error in held-out runs."""

    kind: Kind  # see `palpate.estimation.kinds`
    share: float  # Shapley value among the kinds that are listed, differences between runs last
    interval: tuple[float, float]  # 95 %, over runs
    necessary: float  # lost when the kind is left out of all
    sufficient: float  # explained by the kind alone
    form: Form  # how well the form of its effects is known
    effects: list[str]  # accepted effects; if the form is unknown, the closest ones
    replaceable_by: list[Kind]  # kinds that explain about as much in its place
    experiment: str  # what separates it from the first of these; empty if there is none


class Rest(_Entry):
    """Shares of the base model's squared held-out error that no kind accounts for."""

    noise: float  # the noise level's share; at most that, where the level is an upper bound
    unexplained: float  # the remainder


class Ranked(_Entry):
    """An effect that was fitted alone beside the base model."""

    effect: str  # its name
    rmse_held_out: float  # error in held-out runs with it, inner parameters chosen on the other runs
    score: float  # share by which the error falls


class Remaining(_Entry):
    """Error that remains with all accepted effects."""

    rmse: float  # error in held-out runs
    times_floor: float  # ratio to the noise level
    depends_on: list[str]  # signals that it depends on; empty if it is noise


class Floor(_Entry):
    """The noise level and its source; in the unit of the effort."""

    value: float  # the error that a complete model would leave in held-out runs
    source: NoiseSource = NoiseSource.FLEXIBLE  # how it was estimated
    at_most: bool = True  # whether the noise may be less
    free_air: float | None  # noise before the first touch of each run; None if there is no free air
    share_left: float  # share of the final error on blocks that a flexible regression still explains


class ChannelDiagnosis(_Entry):
    """The diagnosis of one channel; most fields are empty if the data are insufficient."""

    channel: str  # its name
    verdict: Verdict  # see `Verdict`
    reason: str  # one sentence
    effort_unit: str  # unit of all errors
    noise_floor: float | None = None  # error that a complete model would leave
    floor: Floor | None = None  # the same with its source
    budget: list[BudgetShare] = Field(default_factory=list)  # of the base model's error, largest share first
    rest: Rest | None = None  # of the same error
    baseline: Fitted | None = None  # the base model
    accepted: list[Accepted] = Field(default_factory=list)  # missing effects, the most important first
    # The most promising candidates alone beside the base model.
    ranking: list[Ranked] = Field(default_factory=list)
    final: Fitted | None = None  # the model with all that was accepted
    # Whether only noise is left, as far as the data show; None if insufficient.
    complete: bool | None = None
    remaining: Remaining | None = None  # error of the final model
    depends_on: list[str] = Field(default_factory=list)  # the same as in `remaining`
    next_experiment: NextExperiment | None = (
        None  # the most informative next experiment; None if none would help
    )
    # How a very long recording was averaged, and why no information is lost; empty otherwise.
    averaged: str = ""
    warnings: list[str] = Field(default_factory=list)  # implausible properties of the data, with their values
    _fits: Mapping[tuple[str, ...], PackedFit] = PrivateAttr(default_factory=dict)

    def with_fits(self, fits: Mapping[tuple[str, ...], FitResult]) -> Self:
        """Attach the fits that the numbers come from.

        Args:
            fits: by the names of the added effects, in order.
        """
        copy = self.model_copy()
        copy._fits = {effects: PackedFit.of(fit) for effects, fit in fits.items()}
        return copy

    def take_fits(self) -> Mapping[tuple[str, ...], PackedFit]:
        """Return the attached fits by the names of the added effects, and release them."""
        fits, self._fits = self._fits, {}
        return fits


class Diagnosis(_Entry):
    """The diagnoses of all channels of a file."""

    file: str
    model: str
    channels: list[ChannelDiagnosis]


def stage_numbers(
    effect: str,
    before: FitResult,
    after: FitResult,
    final: FitResult,
    spread: ParameterValue | None = None,
) -> dict[str, Any]:
    """Compute the fields of `Accepted` that state what one effect adds.

    Args:
        effect: name of the effect.
        before: the model without it.
        after: the model with it, all parameters fitted again.
        final: the model with all effects, whose parameters are reported: in nested models they are biased.
        spread: standard deviation between runs, of an effect that varies from run to run.
    """
    prefix = f"{effect}."
    own = {
        name.removeprefix(prefix): value
        for name, value in _parameters(final).items()
        if name.startswith(prefix)
    }
    own |= {} if spread is None else {"spread": spread}
    return {"rmse_before": before.rmse, "rmse_after": after.rmse, "parameters": own}


def _parameters(fit: FitResult) -> Parameters:
    return {name: ParameterValue.of(estimate) for name, estimate in fit.parameters.items()}
