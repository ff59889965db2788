"""One stage of a model as it is kept in a file."""

from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict


class KeptParameter(BaseModel):
    """One parameter; `std_err` is None where the data do not determine it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    value: float
    std_err: float | None
    unit: str


class KeptRevision(BaseModel):
    """One stage of one channel's model.

    Attributes:
        number: of the revision, unique within a session.
        parent: the revision that it was added to; None for a base model.
        channel: its name.
        model: name of the base model.
        added: effect that this stage added; empty for a base model.
        effects: all that were added to the base model, in order.
        user_effects: effects of the user's own among them, as FILE.py:Class.
        effort_unit: unit of the errors.
        rmse: error in held-out runs.
        noise_floor: error that a complete model would leave.
        parameters: by "effect.parameter".
        created_utc: when.
        software_version: by which palpate.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    number: int
    parent: int | None
    channel: str
    model: str
    added: str
    effects: list[str]
    user_effects: list[str]
    effort_unit: str
    rmse: float
    noise_floor: float
    parameters: dict[str, KeptParameter]
    created_utc: str
    software_version: str


def own_effects(revisions: Iterable[KeptRevision]) -> list[str]:
    """All effects of the user's own in these, as FILE.py:Class, each once."""
    return list(dict.fromkeys(text for revision in revisions for text in revision.user_effects))
