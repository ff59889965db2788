"""What speaks against a model that no smooth law of the known signals improves."""

from dataclasses import dataclass

from estimation.fit.exact import is_exact
from estimation.fit.standing import Standing
from estimation.diagnosis.judgement.agreement import Disagreement, disagreement
from estimation.diagnosis.judgement.unlike_noise import Excess, quiet_floor, unlike_noise

_CLEARLY = 0.5  # times the error that is left


@dataclass(frozen=True)
class Objection:
    """Why nothing may be named, and nothing called adequate.

    Attributes:
        reason: in words.
        depends_on: what the error depends on.
        floor: the error that a complete model would leave, as far as this shows, in the unit of the effort.
    """

    reason: str
    depends_on: tuple[str, ...]
    floor: float


def objection_to(end: Standing, energy: float, *, is_complete: bool) -> Objection | None:
    """Look for runs that follow different laws, and for a rest in contact that is no noise.

    Where a smooth law still explains something, runs must differ by clearly more than that.

    Args:
        end: the model with all that was accepted.
        energy: on blocks of held-out runs, that a flexible regression left beside any model.
        is_complete: whether no more than noise is left, as far as that tells.
    """
    if is_exact(end):
        return None
    unit = end.data.kind.effort_unit
    apart = disagreement(end)
    if apart and (is_complete or apart.alone < _CLEARLY * end.floor(energy)):
        return Objection(_runs(apart, unit), ("run",), apart.alone)
    excess = unlike_noise(end) if is_complete else None
    return Objection(_rest(excess, unit), ("time",), quiet_floor(end)) if excess else None


def floor_unseen(standing: Standing, floor: float) -> float:
    """The error that a complete model would leave by what no signal of the data shows; infinite if nothing.

    Args:
        standing: a model, complete or not.
        floor: what a smooth law of the signals would leave.
    """
    if is_exact(standing):
        return float("inf")
    apart = disagreement(standing)
    alone = apart.alone if apart and apart.alone < _CLEARLY * floor else float("inf")
    return min(alone, quiet_floor(standing))


def _runs(apart: Disagreement, unit: str) -> str:
    return (
        f"the runs do not follow one law: run {apart.run} is off by {apart.run_predicted:.3g} {unit} when "
        f"predicted from the others, by {apart.run_alone:.3g} {unit} when fitted by itself; was something "
        "else probed, or a sensor changed?"
    )


def _rest(excess: Excess, unit: str) -> str:
    swings = f" and swings at {excess.frequency_hz:.3g} Hz" if excess.frequency_hz else ""
    return (
        f"what is left in contact, {excess.contact:.3g} {unit}, is {excess.contact / excess.expected:.0f} "
        f"times the noise in free air, does not look like noise{swings}; no signal of the data explains it"
    )
