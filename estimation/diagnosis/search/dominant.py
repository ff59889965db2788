"""Names the one effect that dominates, though something smaller is left that nobody has named.

A wrong effect can imitate most of a missing one. What gives it away is that its shape is not quite right:
what is left then still depends on the signals that the effect itself is a function of. So an effect is named
beside an unexplained rest if it takes away most of what can be explained at all, if nothing else comes near,
and if what is left hardly depends on its own signals.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from estimation.channel import ChannelKind
from estimation.fit.flexible import signals_of
from estimation.fit.plain_laws import left_by_another_surface, left_by_one_term
from estimation.fit.standing import Standing
from estimation.diagnosis.search.candidate import Candidate, close_to_best
from estimation.diagnosis.search.confusion import contains
from estimation.diagnosis.search.nameless import other_reader
from robot_io.types import FloatArray

SHARE = 0.9  # of the explainable energy, that an effect has to take away
MARGIN = 3.0  # times as much as the effect has to be left by any other
MOST = (
    0.5  # of what a reader leaves; if one that rounds otherwise leaves less, that is most of what was missing
)
MISSHAPEN = 0.015  # of the energy that an effect takes away, that its own signals may still explain
_OWN = (
    0.9  # of the energy of an effect's contribution, that a signal of its own can draw, relative to the best
)


def is_dominant(
    before: Standing, after: Standing, chosen: Candidate, found: Sequence[Candidate], floor: float
) -> bool:
    """Whether an effect can be named without a complete model.

    Args:
        before: without it.
        after: with it.
        chosen: the effect.
        found: all candidates that were tried beside the model without it, the impossible as well: a law with
            parameters that make no sense, and no more of them, may still have the better shape.
        floor: energy on blocks of held-out runs that no smooth law can explain.
    """
    start, left = before.trial.held_out, after.trial.held_out
    if start - left < SHARE * (start - floor):
        return False
    others = [c for c in found if c.possible or c.size <= chosen.size]
    others = [c for c in others if c.effect.name != chosen.effect.name]
    # the name will be that of its plainest part: what has that part and one term more is no other law
    plainest = simplest(chosen, [c for c in found if c.possible], before)
    others = [c for c in others if not contains(c, plainest)]
    others = [c for c in others if not contains(c, chosen) and not contains(chosen, c)]
    if any(c.held_out - floor < MARGIN * (left - floor) for c in others):
        return False
    # an effect that is not in the library may be as plain as a constant or a power, or it is the surface
    plain = min(left_by_one_term(before), left_by_another_surface(before))
    if plain - floor < (left - floor) / MARGIN:
        return False
    if other_reader(after, chosen.effect) - floor < MOST * (left - floor):
        return False
    return misshapen(before, after) <= MISSHAPEN


def simplest(chosen: Candidate, found: Sequence[Candidate], before: Standing) -> Candidate:
    """The simplest effect that is part of the chosen one and takes away nearly as much."""
    nested = [c for c in close_to_best(before, found) if contains(chosen, c)]
    return min([chosen, *nested], key=lambda c: (c.size, c.held_out))


def misshapen(before: Standing, after: Standing) -> float:
    """Energy that the effect's own signals still explain, as a share of what the effect takes away."""
    own = own_signals(before, after)
    left = max((after.flexible.by_signal[name] for name in own), default=0.0) * after.trial.held_out
    return left / max(before.trial.held_out - after.trial.held_out, 1e-300)


def own_signals(before: Standing, after: Standing) -> list[str]:
    """Signals that an effect is a function of: those that can draw what it changes.

    What depends on the direction of motion depends on the velocity. Everything in a joint is a function of
    the effort and of the noise that its acceleration brings into it, so there the effort is none of them.
    """
    kept = after.plain.kept
    change = (before.trial.residual - after.trial.residual)[kept]
    base = np.column_stack([np.ones(len(change)), before.trial.columns[kept]])
    blocks = signals_of(after.plain, after.trial)
    if after.data.kind is not ChannelKind.CONTACT:
        del blocks["effort"]
    drawn = _drawn(change, base, {name: columns[kept] for name, columns in blocks.items()})
    most = max(drawn.values())
    own = [name for name, share in drawn.items() if share >= _OWN * most]
    return sorted({*own, "velocity"}) if "direction" in own else own


def _drawn(change: FloatArray, base: FloatArray, blocks: Mapping[str, FloatArray]) -> dict[str, float]:
    """Share of the energy of `change` (w,) in the span of `base` and each block (w, k)."""
    energy = float(change @ change) or 1.0
    drawn = {}
    for name, block in blocks.items():
        columns = np.column_stack([base, block])
        width = np.sqrt(np.sum(columns**2, axis=0))
        u, size, _ = np.linalg.svd(columns / np.where(width > 0.0, width, 1.0), full_matrices=False)
        part = u[:, size > 1e-6 * size[0]].T @ change
        drawn[name] = float(part @ part) / energy
    return drawn
