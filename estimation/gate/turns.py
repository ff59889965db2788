"""Whether the angle of a joint may be in radians: a weight repeats itself with every turn."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.load import HEAVY
from estimation.model import Model
from robot_io.types import FloatArray

_SEVERAL = 2.0  # turns: with fewer, a spring and a weight may be told from each other by their shape alone
_SLOWLY = 0.1  # of the effort's variance, a third of its amplitude, that goes slowly with the angle
# Of what the motion leaves, that the sine in degrees leaves: what is hidden at ten times the noise stays,
# which was up to 0.1 of a pendulum in degrees; the rest has to be slow.
_NEARLY_ALL = 0.2
# Times the energy left, by which a law is as good as a wider one. Chance and likeness made 1.01 in pendulums
# in degrees; a weight in radians of half the noise, by its amplitude, makes 1.1, and a plain one hundreds.
_AS_WELL = 1.1
# Times the energy left, by which a law is worse. Springs, spiral or hardening, that a quadratic does not draw
# are not drawn by a sine either, which came to 1.03; a pendulum's swings of 50 degrees came to 1.3 to 6.
_CLEARLY = 1.5


def strange_turns(data: ChannelData, model: Model | None) -> str | None:
    """Why the angle of a joint with weight is hardly in radians; None if nothing says so.

    Over several turns an arm's weight comes back with each. An effort in which nothing does, and that goes
    slowly with the angle from one end to the other, is that of an angle in degrees, or of a motor ahead of
    its gear. Where the weight is there as well, what goes slowly is a spring that is wound up, or a friction
    that warms up. Beside a model that knows no weight, nothing has to come back: only what bends as the sine
    in degrees does, and as no spiral spring, is refused.

    Args:
        data: the channel.
        model: what is to explain it.
    """
    if data.kind is not ChannelKind.REVOLUTE or model is None:
        return None
    turns = float(np.ptp(data.position)) / (2.0 * np.pi)
    if turns < _SEVERAL:
        return None
    if not _in_degrees(data):
        return None
    if not any(effect.name in HEAVY for effect in model.effects) and not _bends_in_degrees(data):
        return None
    return (
        f"the joint turns {turns:.0f} times, and its effort does not come back with each turn as weight "
        "does; is the angle in degrees, or that of a motor ahead of its gear?"
    )


def _in_degrees(data: ChannelData) -> bool:
    """Whether the angle's sine in degrees draws nearly all of the effort, and in radians next to nothing."""
    radians, degrees = _sines(data.position), _sines(np.radians(data.position))
    moved, slow, both = (_left(data, law) for law in ([], degrees, [*degrees, *radians]))
    if moved - slow < _SLOWLY * float(np.var(data.effort)):
        return False
    return slow <= _NEARLY_ALL * moved and slow <= _AS_WELL * both


def _bends_in_degrees(data: ChannelData) -> bool:
    """Whether the angle's sine in degrees draws the effort as well as three powers, and two do not."""
    sine, two, three = (
        _left(data, law) for law in (_sines(np.radians(data.position)), _powers(data)[:2], _powers(data))
    )
    return sine <= _AS_WELL * three and two >= _CLEARLY * sine


def _sines(angle_rad: FloatArray) -> list[FloatArray]:
    return [np.sin(angle_rad), np.cos(angle_rad)]


def _powers(data: ChannelData) -> list[FloatArray]:
    x = (data.position - data.position.mean()) / float(np.std(data.position))
    return [x, x**2, x**3]


def _left(data: ChannelData, law: list[FloatArray]) -> float:
    """Mean square that a law, columns (n,), leaves of the effort beside frictions, a drift and an inertia."""
    v = data.velocity
    columns = [np.ones(len(data)), data.time_s - data.time_s[0], v, np.sign(v), v * np.abs(v), *law]
    left, inertia = _fitted(data.effort, [*columns, data.acceleration])
    # a swing's acceleration goes with its angle, but no mass is below nothing
    return left if inertia >= 0.0 else _fitted(data.effort, columns)[0]


def _fitted(effort: FloatArray, columns: list[FloatArray]) -> tuple[float, float]:
    """Mean square that columns (n,) leave of an effort (n,), and the gain of the last one."""
    size = [float(np.sqrt(np.mean(column**2))) or 1.0 for column in columns]
    matrix = np.column_stack(columns) / size
    gains = np.linalg.lstsq(matrix, effort, rcond=1e-9)[0]
    return float(np.mean((effort - matrix @ gains) ** 2)), float(gains[-1])
