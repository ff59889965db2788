"""What can be said of an error that no known effect explains, in words."""

from collections.abc import Sequence

import numpy as np

from estimation.fit.held_out import held_out_residual, rmse
from estimation.fit.standing import Standing
from estimation.diagnosis.judgement.noise_floor import noise_floor
from estimation.signals.runwise import sample_time

_MOST = 0.7  # of the error: half of its energy
# Times what a smooth law of time and motion would leave. Noise alone came to 1.06 at most, in 24 made-up
# sessions of six equal runs, white and with a correlation of 0.97 from sample to sample.
_MORE_THAN_NOISE = 1.5


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
        f"repeated, and is no noise: {_differing(standing)}; the rest depends on {told}"
    )


def small_rest(standing: Standing, energy: float, signals: Sequence[str]) -> str:
    """How much could still be explained where the error, sample by sample, is hardly above the noise floor.

    Means over a block have less noise than samples, so a law shows in them that is next to nothing beside the
    noise of a single sample.

    Args:
        standing: the best model.
        energy: on blocks of held-out runs, that a flexible regression left beside any model.
        signals: what the error depends on.
    """
    frame, unit, told = standing.plain.frame, standing.data.kind.effort_unit, ", ".join(signals)
    count = max(int(frame.trusted.sum()), 1)
    whole = float(np.sqrt(standing.trial.held_out / count))
    rest = whole * float(np.sqrt(1.0 - (1.0 - max(standing.left_of_blocks(energy), 0.0)) ** 2))
    block = frame.rows.shape[1]
    over_ms = 1e3 * block * sample_time(standing.data.time_s, standing.data.run)
    where = f"averaged over blocks of {over_ms:.3g} ms" if block > 1 else "sample by sample"
    return (
        f"a small rest has a shape that no known effect explains, {rest:.2g} {unit} in the error {where}, "
        f"which is {whole:.2g} {unit}; it depends on {told or 'no single signal'}"
    )


def _differing(standing: Standing) -> str:
    """What differs from run to run: a factor that each run has, or nobody knows what."""
    data = standing.data
    residual = held_out_residual(standing.plain.frame, standing.trial)
    expected = data.effort - residual
    factors, left = {}, residual.copy()
    for run in data.runs:
        rows = (data.run == run) & np.isfinite(residual)
        energy = float(expected[rows] @ expected[rows])
        if energy > 0.0:
            factors[int(run)] = float(data.effort[rows] @ expected[rows]) / energy
            left[rows] = (data.effort - factors[int(run)] * expected)[rows]
    if not factors or rmse(left) > _MOST * rmse(residual):
        return "see what differs from run to run"
    least, most = min(factors, key=factors.__getitem__), max(factors, key=factors.__getitem__)
    unit = data.kind.effort_unit
    return (
        f"the runs differ by a factor, from {factors[least]:.3g} (run {least}) to {factors[most]:.3g} (run "
        f"{most}) of what the others let expect; without it {rmse(left):.3g} {unit} would be left (another "
        "specimen or spot, or did it change?)"
    )
