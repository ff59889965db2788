"""What can be said of an error that no known effect explains, in words."""

from collections.abc import Sequence

from estimation.diagnosis.bench.standing import Standing
from estimation.diagnosis.judgement.noise_floor import noise_floor

_MOST = 0.7  # of the error: half of its energy
_MORE_THAN_NOISE = 1.5  # times what a smooth law of time and motion would leave


def left_over(standing: Standing, energy: float, signals: Sequence[str]) -> str:
    """How much could still be explained and by what, or that it is rather the runs that differ.

    What does not come back when a motion is repeated is no matter of the motion. If it is also more than
    noise (a law that knows the clock would take it away), runs differ: the specimen, its warmth, the machine,
    or the little by which the motion does.

    Args:
        standing: the best model.
        energy: on blocks of held-out runs, that a flexible regression left beside any model.
        signals: what the error depends on.
    """
    floor, told = noise_floor(standing, energy), ", ".join(signals) or "a mix of signals"
    unit = standing.data.kind.effort_unit
    if floor.repeats is None or floor.repeats < max(_MOST * standing.rmse, _MORE_THAN_NOISE * floor.value):
        share = 100.0 * max(standing.left_of_blocks(energy), 0.0)
        return f"{share:.0f} % of what is left could still be explained, by {told}"
    return (
        f"of what is left, {floor.repeats:.3g} {unit} does not come back when nearly the same motion is "
        f"repeated, and is no noise: see what differs from run to run; the rest depends on {told}"
    )
