"""What a diagnosis says, in documented and stable keys (see docs/diagnosis.md)."""

from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field


class Verdict(StrEnum):
    """The answer for one channel."""

    ADEQUATE = "adequate"  # nothing is missing that this data can show
    MISSING = "missing"  # these effects are
    UNEXPLAINED = "unexplained"  # structure is left that no known effect explains
    INSUFFICIENT = "insufficient"  # this data cannot say


SMALL_REST = 1.05  # times the noise floor, up to which an error is hardly more than noise, sample by sample


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ParameterValue(_Entry):
    """One parameter; `std_err` is None where the data do not determine it."""

    value: float
    std_err: float | None
    unit: str


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
        p_value: how often the best candidate does as well on noise alone, the largest so far in the chain.
        confused_with: effects that this data cannot tell from it.
        physics: one line of what happens.
        equation: its term.
        signature: what one sees in the data.
        told_by: other channels that showed it; empty where this one did.
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
    told_by: list[str] = Field(default_factory=list)


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


class Suspect(_Entry):
    """An effect that explains part of what is left, not well enough to be named.

    Attributes:
        effect: its name.
        rmse_after: error in held-out runs with it and those before it.
        confused_with: effects that would do as well in its place.
    """

    effect: str
    rmse_after: float
    confused_with: list[str] = Field(default_factory=list)


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
    """The noise floor and what it rests on; see `estimation.diagnosis.judgement.noise_floor.NoiseFloor`."""

    value: float
    free_air: float | None
    repeats: float | None
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
        suspects: effects that help but do not complete the model; only where it is unexplained.
        ranking: all candidates beside the base model, best first.
        final: the model with all that was accepted.
        depends_on: signals that the remaining error depends on.
        next_experiment: what would tell more; None if nothing would.
        force_ahead_of: faults of the force sensor, ahead of which the contact's model says with what force
            this joint was judged; empty for the force as it was measured.
        not_judged: joints of the same arm about which nothing is said, of a contact that was judged alone.
    """

    channel: str
    verdict: Verdict
    reason: str
    effort_unit: str
    noise_floor: float | None = None
    floor: Floor | None = None
    baseline: Fitted | None = None
    accepted: list[Accepted] = Field(default_factory=list)
    suspects: list[Suspect] = Field(default_factory=list)
    ranking: list[Ranked] = Field(default_factory=list)
    final: Fitted | None = None
    depends_on: list[str] = Field(default_factory=list)
    next_experiment: NextExperiment | None = None
    force_ahead_of: list[str] = Field(default_factory=list)
    not_judged: list[str] = Field(default_factory=list)

    @property
    def leaves_little(self) -> bool:
        """Whether the final error is hardly above the noise floor, whatever shape the rest has."""
        if self.final is None or self.noise_floor is None:
            return False
        return self.final.rmse < SMALL_REST * self.noise_floor


class Diagnosis(_Entry):
    """The answer for all channels of a file."""

    file: str
    model: str
    channels: list[ChannelDiagnosis]
