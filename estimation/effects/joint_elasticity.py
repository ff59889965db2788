"""The gear winds up under load."""

from functools import partial

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.data.derivatives import Motion, differentiate
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.kinds import Kind
from estimation.signals.cache_by_array import cache_by_channel_arrays
from estimation.signals.shifted_motion import shifted_motion


class JointElasticity(MotionEffect):
    """q_true = q - load / k: the link stands behind the motor that the encoder reads."""

    name = "joint_elasticity"
    kind = Kind.ELASTIC_SHAPE
    physics = "Gears, shafts and belts twist under the load, so that the link lags the motor."
    equation = "q_true = q - c load, with its derivatives"
    source = "M. W. Spong, J. Dyn. Sys. Meas. Control 109 (1987)"
    signature = "errors grow with the second derivative of the load: at fast changes, not at slow ones"
    signals = ("load",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (Parameter("compliance", "{position}/{effort}", 0.0, 1e9, (1e-05, 0.1), log=True),)
    needs = ("load",)
    confused_with = {
        "lag": "move slowly under a large load: a spring yields at rest too",
        "inertia": "move at two frequencies: elasticity grows with the fourth power",
    }

    def __init__(self, form: int = 0) -> None:
        """`form`: by how many of `HALF_WINDOWS` the windows of the load's derivatives are wider."""
        self.form = form

    def forms(self) -> tuple["JointElasticity", ...]:
        """See `Effect.forms`: how far errors of the load's acceleration reach is not known."""
        return tuple(JointElasticity(wider) for wider in _CHANGES)

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        c, load = inner["compliance"], data.context["load"]
        changes = _CHANGES[self.form](data)
        return shifted_motion(
            data, position=-c * load, velocity=-c * changes.velocity, acceleration=-c * changes.acceleration
        )

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: winding up by from a thousandth to a third of the range of motion."""
        load = float(np.std(data.context["load"])) or 1.0
        span = float(np.std(data.position)) or 1.0
        return tuple({"compliance": float(part * span / load)} for part in np.geomspace(3e-4, 0.3, 10))


def _changes(data: ChannelData, wider: int) -> Motion:
    """First and second derivative of the load."""
    return differentiate(data.time_s, data.context["load"], data.run, rounding=0.0, wider=wider)


_CHANGES = {
    wider: cache_by_channel_arrays("time_s", "run", "load")(partial(_changes, wider=wider))
    for wider in (0, 2, 4, 6)
}
