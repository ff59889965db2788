"""The sensor reads differently on the way up and down."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from estimation.signals.blocks import block_index
from estimation.signals.runwise import play
from robot_io.types import FloatArray

_STILL = 0.1  # of the width, within which an effort has not moved


class Hysteresis(SensorEffect):
    """reading = play(effort, width): it follows after a gap of twice the width is crossed.

    Where in the gap a run begins depends on what came before it (a reading stays up after a press), so that
    is taken from the reading in free air; a joint has no such rest, and starts in the middle of the gap.
    """

    name = "hysteresis"
    kind = Kind.SENSOR_STATICS
    physics = "Inner friction of the sensor holds its reading back at each reversal of the effort."
    equation = "reading = play(effort, width)"
    source = "M. A. Krasnoselskii, A. V. Pokrovskii, Systems with Hysteresis (1989): play operator"
    signature = "readings are low while the effort rises and high while it falls, at any speed"
    signals = ("past effort",)
    channels = frozenset(ChannelKind)
    inner = (Parameter("width", "{effort}", 1e-09, 10000.0, (0.001, 1.0), log=True),)
    confused_with = {
        "bouc_wen_hysteresis": "reverse slowly at several loads: the sensor's loops have one width",
        "backlash": "reverse slowly at several loads: a gap is crossed in position, a hysteresis in effort",
        "dry_friction": "reverse slowly at several depths",
        "coulomb_friction": "reverse slowly at several loads",
        "damping": "probe at two speeds",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        width = inner["width"]
        at_first = _first_readings(effort, data, width) if data.kind is ChannelKind.CONTACT else None
        return play(effort, data.run, width, at_first)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: while the reading is held, that of the moment when it last followed.

        None before it first did.
        """
        return self.follow(effort, columns, data, inner)[0]

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        reading = self.sense(effort, data, inner)
        held = np.abs(effort - reading) < inner["width"] * (1.0 - 1e-9)
        first = np.append(True, np.diff(data.run) != 0)
        last = np.maximum.accumulate(np.where(held & ~first, 0, np.arange(len(effort))))
        unmoved = held & first & (data.kind is ChannelKind.CONTACT)
        return np.where(unmoved[last][:, None], 0.0, columns[last]), reading

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: shares of the largest reading."""
        peak = float(np.max(np.abs(data.effort))) or 1.0
        return tuple({"width": float(part * peak)} for part in np.geomspace(0.01, 0.3, 7))


def _first_readings(effort: FloatArray, data: ChannelData, width: float) -> FloatArray:
    """Mean reading of each run until the effort first moves, shape (runs,) or (runs, p) with p columns.

    Of a run that is held out these readings are used too: where its sensor stood before it was pressed, which
    no other run tells.
    """
    starts, piece = block_index(data.run)
    moved = np.abs(effort - effort[starts][piece]) > _STILL * width
    reading, number = data.effort, np.arange(len(data))
    if effort.ndim == 2:
        reading, number = reading[:, None], number[:, None]
    until = np.minimum.reduceat(np.where(moved, number, len(data)), starts)
    still = number < until[piece]
    found: FloatArray = np.add.reduceat(np.where(still, reading, 0.0), starts)
    return found / np.add.reduceat(still.astype(np.float64), starts)
