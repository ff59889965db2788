"""Which way a displacement and its force count, and from where, and whether the element pulls too."""

from dataclasses import dataclass

import numpy as np

from estimation.data.press_runs import force_levels
from estimation.statistics.correlation import correlation_coefficient
from robot_io.types import FloatArray

_TAILS = (0.005, 0.995)  # quantiles, between which a signal has its range
_FAR = 3.0  # times as far to the one side as to the other
_SPRINGY = 0.5  # correlation of displacement and force, above which the force follows the displacement
_GOES_WITH = 0.3  # the same for a press, of which most may be free air
_DRAGGED = -0.3  # correlation of velocity and force, below which the force is counted the other way
_OTHER_SIDE = 0.2  # of the larger range, that both signals have on the other side too
_MOVES = 0.3  # of the force's deviation on the one side, that it has far out on the other
_FARTHER = 0.5  # of the range to the other side
_FARTHEST = 0.9  # of the same
_RESTS = 0.2  # of the force's deviation on that side, below which it rests
_FEWEST = 20  # samples far out, or about a level of the force
_SHALLOW = 0.02  # of the pressed samples: deeper than these no force begins
_OF_AIR = 0.1  # of the displacement's range, that free air must span


@dataclass(frozen=True)
class PressSides:
    """How a displacement and its force count."""

    displacement: float = 1.0  # what turns it positive into the object: 1 or -1
    force: float = 1.0  # what turns it positive in compression: 1 or -1
    zero_m: float = 0.0  # where the force begins, if the displacement counts from far away, after turning [m]
    two_sided: bool = False  # whether the element pulls as well: a spring or damper held at both ends
    springy: bool = True  # whether the force follows the displacement


def press_sides(displacement: FloatArray, force: FloatArray) -> PressSides:
    """Find how displacement and force of a press, spring or damper count.

    Both may count compression negative, or one of them; of an object that can only push the force has one
    sign. An element that pulls as well moves to both sides with a force on both sides.

    Args:
        displacement: shape (n,), in the order of time.
        force: shape (n,).
    """
    alike = correlation_coefficient(displacement, force)
    if _is_two_sided(displacement, force):
        if abs(alike) > _SPRINGY:
            return PressSides(force=float(np.sign(alike)), two_sided=True)
        against = correlation_coefficient(np.gradient(displacement), force) < _DRAGGED
        return PressSides(force=-1.0 if against else 1.0, two_sided=True, springy=False)
    way, push = 1.0, 1.0
    if alike > _GOES_WITH and _is_negative(displacement) and _is_negative(force):
        way = push = -1.0
    elif alike < -_GOES_WITH:
        way, push = (1.0, -1.0) if _is_negative(force) else (-1.0, 1.0)
    return PressSides(way, push, _zero(way * displacement, push * force))


def _is_negative(signal: FloatArray) -> bool:
    """Whether a signal (n,) lies mostly below zero."""
    low, high = np.quantile(signal, _TAILS)
    return bool(-low > _FAR * max(high, 0.0) and low < high)


def _zero(displacement: FloatArray, force: FloatArray) -> float:
    """Where the force of a press begins [m], if the displacement counts from elsewhere; else 0.

    It does where it is never positive, or so far from zero that no press is as deep, and there is free air.
    The force begins where a spring and damper through what is pressed would.
    """
    if correlation_coefficient(displacement, force) < _GOES_WITH:
        return 0.0  # nothing says that it presses
    low, high = np.quantile(displacement, _TAILS)
    levels = force_levels(force, displacement if low < 0.0 < high else np.ones_like(displacement))
    free = displacement[force <= levels.released]
    in_air = len(free) >= _FEWEST and np.ptp(free) > _OF_AIR * (high - low)
    if high > 0.0 and not (low > high - low and in_air):
        return 0.0
    pressed = force > levels.pressed
    if not in_air or np.sum(pressed) < _FEWEST:
        return float(low)
    columns = np.column_stack([displacement, np.gradient(displacement), np.ones(len(force))])
    stiffness, _, offset = np.linalg.lstsq(columns[pressed], force[pressed] - levels.free, rcond=None)[0]
    begins = -offset / stiffness if stiffness > 0.0 else high
    return float(np.clip(begins, np.min(free), np.quantile(displacement[pressed], _SHALLOW)))


def _is_two_sided(displacement: FloatArray, force: FloatArray) -> bool:
    """Whether both signals (n,) go to both sides, the force also where the displacement is far out there.

    In free air the force rests, but where an object sticks for a little while. An object that sticks longer
    pulls until it tears off: then the force rests farthest out, which that of an element held at both ends
    does not.
    """
    ends = [np.quantile(signal, _TAILS) for signal in (displacement, force)]
    if any(min(-low, high) <= _OTHER_SIDE * max(-low, high) for low, high in ends):
        return False
    far, pushing = displacement < _FARTHER * ends[0][0], displacement > _FARTHER * ends[0][1]
    enough = min(np.sum(far), np.sum(pushing)) >= _FEWEST
    if not enough or np.std(force[far]) <= _MOVES * np.std(force[pushing]):
        return False
    farthest = force[displacement < _FARTHEST * ends[0][0]]
    rests = np.sqrt(np.mean(farthest**2)) < _RESTS * np.std(force[far])
    return not (len(farthest) >= _FEWEST and rests)
