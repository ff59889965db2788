"""Whether the angle of a joint may be in radians: a weight repeats itself with every turn."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.bench.load import CARRYING
from estimation.model import Model
from robot_io.types import FloatArray

_SEVERAL = 2.0  # turns: with fewer, a spring and a weight may be told from each other by their shape alone
# Share of the effort's variance that goes with the angle itself beyond its sine: a tenth is three times the
# amplitude of a drift or cogging that is worth a word, and a weight that is to be found takes more.
_SLOWLY = 0.1
_HEAVY = frozenset(CARRYING - {"inertia", "armature"})  # effects in which weight goes round with the angle


def strange_turns(data: ChannelData, model: Model | None) -> str | None:
    """Why the angle of a joint with weight is hardly in radians; None if nothing says so.

    Over several turns an arm's weight comes back with each. An effort that instead goes slowly with the angle
    from one end to the other is that of an angle in degrees, or of a motor ahead of its gear; a spring and a
    cubic would draw it. With a model that knows no weight, a spring wound up by several turns is taken as it
    is.

    Args:
        data: the channel.
        model: what is to explain it.
    """
    if data.kind is not ChannelKind.REVOLUTE or model is None:
        return None
    turns = float(np.ptp(data.position)) / (2.0 * np.pi)
    if turns < _SEVERAL or not any(effect.name in _HEAVY for effect in model.effects):
        return None
    x = (data.position - data.position.mean()) / float(np.std(data.position))
    since_s = data.time_s - data.time_s[0]
    turning = [np.ones(len(x)), since_s, data.velocity, np.sign(data.velocity)]
    turning += [np.sin(data.position), np.cos(data.position)]
    left, gain = _left(data.effort, [*turning, data.acceleration])
    if gain < 0.0:  # a swing's acceleration goes with its angle, but no mass is below nothing
        left, _ = _left(data.effort, turning)
    else:
        turning.append(data.acceleration)
    slowly = left - _left(data.effort, [*turning, x, x**2, x**3])[0]
    if slowly < _SLOWLY * float(np.var(data.effort)):
        return None
    return (
        f"the joint turns {turns:.0f} times, and its effort does not come back with each turn as weight "
        "does; is the angle in degrees, or that of a motor ahead of its gear?"
    )


def _left(effort: FloatArray, columns: list[FloatArray]) -> tuple[float, float]:
    """Mean square that columns (n,) leave of an effort (n,), and the gain of the last one."""
    size = [float(np.sqrt(np.mean(column**2))) or 1.0 for column in columns]
    matrix = np.column_stack(columns) / size
    gains = np.linalg.lstsq(matrix, effort, rcond=1e-9)[0]
    return float(np.mean((effort - matrix @ gains) ** 2)), float(gains[-1])
