"""Whether the angle of a joint may be in radians: a weight repeats itself with every turn."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.bench.load import HEAVY
from estimation.model import Model
from robot_io.types import FloatArray

_SEVERAL = 2.0  # turns: with fewer, a spring and a weight may be told from each other by their shape alone
_SLOWLY = 0.1  # of the effort's variance, a third of its amplitude, that goes with the angle beyond its sine
_AS_WELL, _CLEARLY = 1.1, 1.5  # times the energy left: of a law of as many parameters, and of another law


def strange_turns(data: ChannelData, model: Model | None) -> str | None:
    """Why the angle of a joint with weight is hardly in radians; None if nothing says so.

    Over several turns an arm's weight comes back with each. An effort that instead goes slowly with the angle
    from one end to the other is that of an angle in degrees, or of a motor ahead of its gear; a spring and a
    cubic would draw it. Beside a model that knows no weight, a spring may be wound up by several turns: only
    what bends as the sine in degrees does is refused.

    Args:
        data: the channel.
        model: what is to explain it.
    """
    if data.kind is not ChannelKind.REVOLUTE or model is None:
        return None
    turns = float(np.ptp(data.position)) / (2.0 * np.pi)
    if turns < _SEVERAL:
        return None
    since_s = data.time_s - data.time_s[0]
    motion = [np.ones(len(data)), since_s, data.velocity, np.sign(data.velocity)]
    if not _goes_slowly(data, motion):
        return None
    if not any(effect.name in HEAVY for effect in model.effects) and not _bends_in_degrees(data, motion):
        return None
    return (
        f"the joint turns {turns:.0f} times, and its effort does not come back with each turn as weight "
        "does; is the angle in degrees, or that of a motor ahead of its gear?"
    )


def _goes_slowly(data: ChannelData, motion: list[FloatArray]) -> bool:
    """Whether the effort goes with the angle itself, beyond what comes back with each turn."""
    turning = [*motion, np.sin(data.position), np.cos(data.position)]
    left, gain = _left(data.effort, [*turning, data.acceleration])
    if gain < 0.0:  # a swing's acceleration goes with its angle, but no mass is below nothing
        left, _ = _left(data.effort, turning)
    else:
        turning.append(data.acceleration)
    curved, _ = _left(data.effort, [*turning, *_powers(data)])
    return left - curved >= _SLOWLY * float(np.var(data.effort))


def _bends_in_degrees(data: ChannelData, motion: list[FloatArray]) -> bool:
    """Whether the angle's sine in degrees draws the effort as well as three powers, and no straight does."""
    degrees, moving = np.radians(data.position), [*motion, data.acceleration]
    laws = (_powers(data)[:1], _powers(data), [np.sin(degrees), np.cos(degrees)])
    straight, curved, sine = (_left(data.effort, [*moving, *law])[0] for law in laws)
    return sine <= _AS_WELL * curved and straight >= _CLEARLY * sine


def _powers(data: ChannelData) -> list[FloatArray]:
    x = (data.position - data.position.mean()) / float(np.std(data.position))
    return [x, x**2, x**3]


def _left(effort: FloatArray, columns: list[FloatArray]) -> tuple[float, float]:
    """Mean square that columns (n,) leave of an effort (n,), and the gain of the last one."""
    size = [float(np.sqrt(np.mean(column**2))) or 1.0 for column in columns]
    matrix = np.column_stack(columns) / size
    gains = np.linalg.lstsq(matrix, effort, rcond=1e-9)[0]
    return float(np.mean((effort - matrix @ gains) ** 2)), float(gains[-1])
