"""Elastic force that fades on two scales of time."""

from itertools import combinations

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import Inner, MemoryEffect, Parameter
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.exponential_memory import fading_memory
from palpate.estimation.signals.runwise import finest_step
from palpate.robot_io.types import FloatArray

_SHARES = (0.15, 0.4)


class RelaxationSpectrum(MemoryEffect):
    """F = (1 - f - s) E + f Z_f + s Z_s, Z' = E' - Z / tau; E is what all springs give at once.

    Quasi-linear viscoelasticity with two branches: what relaxes is the elastic force, whatever its law, so
    that stiffness means that of a sudden press. One branch of a straight spring is `stress_relaxation`.
    """

    name = "relaxation_spectrum"
    kind = Kind.TIME_MEMORY
    physics = "Parts of the elastic force flow away, some at once and some slowly, as in tissue and rubber."
    equation = "F = (1 - fast - slow) E + fast Z_fast + slow Z_slow, Z_i' = E' - Z_i/tau_i, E elastic"
    source = "Y. C. Fung, Biomechanics (1993), ch. 7.6: quasi-linear viscoelasticity; Prony series"
    signature = "force falls during a hold, fast at first and then slowly, by one share at any depth"
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    inner = (
        Parameter("fast", "1", 0.0, 1.0, (0.1, 0.5)),
        Parameter("slow", "1", 0.0, 1.0, (0.1, 0.5)),
        Parameter("fast_time", "s", 1e-5, 1e3, (0.03, 3.0), log=True),
        Parameter("slow_time", "s", 1e-4, 1e5, (1.0, 100.0), log=True),
    )
    confused_with = {
        "stress_relaxation": "hold for longer, at two depths: one branch ends, a second goes on falling",
        "power_law_relaxation": "hold a hundred times as long: a power law goes on, branches end",
        "plastic_set": "wait and press again: relaxation recovers, a set stays",
        "drift": "free air: drift goes on there, relaxation does not",
    }

    def fade(self, elastic: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        shares = np.array([inner["fast"], inner["slow"]])
        rates = 1.0 / np.array([inner["fast_time"], inner["slow_time"]])
        fading = fading_memory(elastic, data.time_s, data.run, rates, shares)
        return np.asarray((1.0 - shares.sum()) * elastic + fading)

    def in_order(self, inner: Inner) -> Inner:
        """See `Effect.in_order`: the fast branch is the one of the shorter time."""
        if inner["fast_time"] <= inner["slow_time"]:
            return inner
        return {
            "fast": inner["slow"],
            "slow": inner["fast"],
            "fast_time": inner["slow_time"],
            "slow_time": inner["fast_time"],
        }

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a few samples to the length of the runs."""
        step_s = finest_step(data.time_s, data.run)
        longest_s = max(float(np.ptp(data.time_s[data.run == run])) for run in data.runs)
        times = np.geomspace(4.0 * step_s, max(longest_s, 40.0 * step_s), 4)
        return tuple(
            {"fast": fast, "slow": slow, "fast_time": float(sooner), "slow_time": float(later)}
            for sooner, later in combinations(times, 2)
            for fast in _SHARES
            for slow in _SHARES
        )
