"""What a diagnosis says, in documented and stable keys (see docs/diagnosis.md)."""

from enum import StrEnum
from math import isfinite
from typing import Self

from pydantic import BaseModel, ConfigDict, Field

from estimation.estimate import ParameterEstimate


class Verdict(StrEnum):
    """The answer for one channel."""

    ADEQUATE = "adequate"  # nothing is missing that this data can show
    MISSING = "missing"  # these effects are, whatever else is
    UNEXPLAINED = "unexplained"  # structure is left, and no effect is established
    INSUFFICIENT = "insufficient"  # this data cannot say


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ParameterValue(_Entry):
    """One parameter; `std_err` is None where undetermined, `at_bound` where an inner search ended at one."""

    value: float
    std_err: float | None
    unit: str
    at_bound: bool = False

    @classmethod
    def of(cls, found: ParameterEstimate) -> Self:
        """An estimate as it is written down."""
        std_err = found.std_err if isfinite(found.std_err) else None
        return cls(value=found.value, std_err=std_err, unit=found.unit, at_bound=found.at_bound)


Parameters = dict[str, ParameterValue]


class Fitted(_Entry):
    """A model's error in held-out runs, in the effort's unit, and its parameters by "effect.parameter"."""

    rmse: float
    parameters: Parameters


class Accepted(_Entry):
    """An effect found missing.

    Attributes:
        effect: its name.
        parameters: its own, by name.
        rmse_before: error in held-out runs without it.
        rmse_after: error with it.
        p_value: how often the best candidate takes as much from noise alone; 0 where that is out of question.
        confused_with: effects that this data cannot tell from it.
        physics: one line of what happens.
        equation: its term.
        signature: what one sees in the data.
    """

    effect: str
    parameters: Parameters
    rmse_before: float
    rmse_after: float
    p_value: float
    confused_with: list[str]
    physics: str
    equation: str
    signature: str


class Ranked(_Entry):
    """A candidate beside the base model.

    Attributes:
        effect: its name.
        rmse_held_out: error in held-out runs with it, inner parameters chosen on the other runs.
        score: share by which the error falls.
    """

    effect: str
    rmse_held_out: float
    score: float


class Remaining(_Entry):
    """What is left of the error with all that was accepted.

    Attributes:
        rmse: error in held-out runs.
        times_floor: over the noise floor.
        depends_on: signals that it depends on; empty where it is noise.
    """

    rmse: float
    times_floor: float
    depends_on: list[str]


class NextExperiment(_Entry):
    """What to record next.

    Attributes:
        purpose: what it would tell.
        separates: the effects that it would tell apart.
        instruction: in words.
        probe: settings for `palpate probe --experiment`, by name.
    """

    purpose: str
    separates: list[str]
    instruction: str
    probe: dict[str, float | int | str | list[float] | dict[str, float | str]]


class Floor(_Entry):
    """The noise floor and what it rests on; in the unit of the effort.

    Attributes:
        value: the error that a complete model would leave in held-out runs.
        free_air: noise before the first touch of each run; None if there is no free air.
        share_left: share of the error, on means over a few samples, that a smooth law still explains.
    """

    value: float
    free_air: float | None
    share_left: float


class ChannelDiagnosis(_Entry):
    """The answer for one channel; without a verdict on its effects where it is insufficient.

    Attributes:
        channel: its name.
        verdict: see `Verdict`.
        reason: one sentence.
        effort_unit: unit of all errors.
        noise_floor: error that a complete model would leave.
        floor: what that rests on.
        baseline: the base model.
        accepted: effects found missing, in order.
        ranking: the most promising candidates alone beside the base model.
        final: the model with all that was accepted.
        complete: whether no more is left than noise, as far as this data shows; None if insufficient.
        remaining: what is left.
        depends_on: the same as in `remaining`.
        next_experiment: what would tell more; None if nothing would.
        averaged: how a recording of very many samples was averaged, and why nothing is lost; else empty.
    """

    channel: str
    verdict: Verdict
    reason: str
    effort_unit: str
    noise_floor: float | None = None
    floor: Floor | None = None
    baseline: Fitted | None = None
    accepted: list[Accepted] = Field(default_factory=list)
    ranking: list[Ranked] = Field(default_factory=list)
    final: Fitted | None = None
    complete: bool | None = None
    remaining: Remaining | None = None
    depends_on: list[str] = Field(default_factory=list)
    next_experiment: NextExperiment | None = None
    averaged: str = ""


class Diagnosis(_Entry):
    """The answer for all channels of a file."""

    file: str
    model: str
    channels: list[ChannelDiagnosis]
