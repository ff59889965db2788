"""The sensor's zero wanders."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Errors, Inner, Parameter
from estimation.kinds import Kind
from estimation.signals.free_air import is_one_way, zero_in_free_air
from robot_io.types import FloatArray

_OFF = 0.5  # of the rate, by which readings in free air may differ from it
_SIGMAS = 3.0  # the same in standard errors


class Drift(AdditiveEffect):
    """reading = effort + d (t - t0), t over the whole session."""

    name = "drift"
    kind = Kind.DRIFT
    physics = "Warming up or creep of the sensor moves its zero steadily."
    equation = "reading = effort + d (t - t0)"
    source = "JCGM 200:2012 (VIM), 4.21: instrumental drift"
    signature = "free air and every run shift steadily with the time of day, not with the time since contact"
    signals = ("time",)
    channels = frozenset(ChannelKind)
    one_sided = False
    gains = (
        Parameter("rate", "{effort}/s", -1e12, 1e12, (-0.01, 0.01)),
        Parameter("offset", "{effort}", -1e12, 1e12, (-1.0, 1.0)),
    )
    essential = ("rate",)
    confused_with = {
        "stress_relaxation": "free air: drift goes on there, relaxation does not",
        "bias": "wait: a bias stays",
    }

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: the motion returns, else time cannot be told from position."""
        return super().applies_to(data) and not is_one_way(data.position, data.run)

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: readings before and after the contact do not drift at that rate."""
        zero = zero_in_free_air(data)
        if zero is None or zero.rate is None:
            return False
        rate = parameters[f"{self.name}.rate"]
        return abs(zero.rate - rate) > max(_OFF * abs(rate), _SIGMAS * zero.rate_std_err)

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([data.time_s - data.time_s[0], np.ones(len(data))])
