"""Laws that nobody has named, and that a name must not be worse than.

What is missing need not be in the library, however plain it is. An effect that draws most of it is then a
good fit and a wrong name; what gives it away is that a law without a name, as plain as it is, fits better.
"""

from collections.abc import Sequence

import numpy as np

from estimation.channel import ChannelKind
from estimation.fit.plain_laws import left_with, motion
from estimation.fit.standing import Standing
from estimation.diagnosis.search.candidate import Candidate
from estimation.effect import Effect, SensorEffect
from estimation.signals.runwise import low_pass
from robot_io.types import FloatArray

_LAGS = (0.4, 1.2)  # times that of a reader, over which another may round
_AVERAGED_S = 0.1  # over which noise of an acceleration averages away: its integral is that of a velocity
_SLOW = 0.1  # of the error of such means; a delay in a lag's place leaves 0.24 or more, the right one 0.02
_DRAWN = 1e-6  # of the energy of what a law adds, that is left of it where it is drawn
_POWERS = (1, 2, 3, 5)


def other_reader(after: Standing, effect: Effect) -> float:
    """Energy in held-out runs that a reader leaves which is late as `effect` says, but rounds in another way.

    A delay and a lag are the same to the first order of their time, so either draws most of the other. What
    the effect makes of an effort may therefore be followed by any mixture of lags about as long as itself.
    In a joint only: a contact's effort ends in a corner.

    Args:
        after: the model with the effect.
        effect: part of it; infinite energy unless it is of a linear sensor with a time.
    """
    times = [after.trial.parameters[f"{effect.name}.{p.name}"] for p in effect.inner if p.unit == "s"]
    if after.data.kind is ChannelKind.CONTACT or not _is_reader(effect) or not times:
        return float("inf")
    frame, columns = after.plain.frame, after.trial.columns
    time_s = frame.reduce(frame.data.time_s)
    lags = (share * abs(time) for time in times for share in _LAGS)
    return left_with(after, np.hstack([low_pass(columns, time_s, frame.run, lag) for lag in lags]))


def is_late_otherwise(after: Standing, effect: Effect) -> bool:
    """Whether a complete model's delay or lag may stand for its twin: what that leaves is slow.

    Of what is left in a joint, some is noise of the derived acceleration, which averages away in a tenth of a
    second. In a model without a reader nothing hangs on that: with nothing hidden a minute of the simulated
    arm leaves a fifth there.

    Args:
        after: the model with the effect.
        effect: part of it.
    """
    in_time = _is_reader(effect) and any(parameter.unit == "s" for parameter in effect.inner)
    return after.data.kind is not ChannelKind.CONTACT and in_time and after.left_of_means(_AVERAGED_S) > _SLOW


def _is_reader(effect: Effect) -> bool:
    return isinstance(effect, SensorEffect) and effect.linear


def is_outdone(before: Standing, after: Standing, library: Sequence[Candidate]) -> bool:
    """Whether a power of position or speed, that no effect of the library draws, explains more than one does.

    In a joint only: an object's law ends at its surface, and what it can be is told by its shape.

    Args:
        before: the model without the effect in question.
        after: the model with it.
        library: all candidates that were tried beside the model without it.
    """
    if before.data.kind is ChannelKind.CONTACT:
        return False
    x, v = motion(before)
    terms = (*(x**power for power in _POWERS), v * np.abs(v), v**3)
    better = [term for term in terms if left_with(before, term) < after.trial.held_out]
    drawn = [after.trial.columns, *(c.search.best.columns for c in library)]
    return any(not any(_draws(before, columns, term) for columns in drawn) for term in better)


def _draws(before: Standing, columns: FloatArray, term: FloatArray) -> bool:
    """Whether columns (m, k) leave nothing of what a term (m,) adds to the model."""
    added, left = (float(before.plain.fit(c, term).sse.sum()) for c in (before.trial.columns, columns))
    return left <= _DRAWN * added
