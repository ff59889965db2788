"""A nonlinear elastic force that fades on two scales of time."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.signals.runwise import sample_time
from estimation.signals.viscoelastic import relaxed_power
from robot_io.types import FloatArray

_EXPONENTS = (1.0, 1.5, 3.0)


class RelaxationSpectrum(AdditiveEffect):
    """F = sum_i k_i z_i, z_i' = (x^n)' - z_i / tau_i, i = fast, slow: two Maxwell branches of one spring.

    In a quasi-linear viscoelastic body it is the elastic force that relaxes, whatever its law: beside
    `power_law_stiffness` of the same n the sum is Fung's. A press soon after another meets an object that has
    not recovered yet, see `relax`.
    """

    name = "relaxation_spectrum"
    physics = "Parts of the elastic force flow away, some at once and some slowly, as in tissue and rubber."
    equation = "F = sum_i k_i z_i, z_i' = (x^n)' - z_i/tau_i, i = fast, slow; x only while pressed"
    source = "Y. C. Fung, Biomechanics (1993), ch. 7.6: quasi-linear viscoelasticity; Prony series"
    signature = "force falls during a hold, fast at first and then ever more slowly; more after a deep press"
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (
        Parameter("fast", "{effort}/{position}^n", 0.0, 1e40, (10.0, 1e12)),
        Parameter("slow", "{effort}/{position}^n", 0.0, 1e40, (10.0, 1e12)),
    )
    inner = (
        Parameter("fast_time", "s", 1e-5, 300.0, (0.03, 3.0), log=True),
        Parameter("slow_time", "s", 1e-3, 1e5, (1.0, 100.0), log=True),
        Parameter("n", "1", 0.5, 6.0, (1.0, 4.0)),
    )
    confused_with: ClassVar[dict[str, str]] = {
        "stress_relaxation": "hold for longer: one branch ends where a second goes on falling",
        "power_law_relaxation": "hold a hundred times as long: a power law goes on, branches end",
        "plastic_set": "wait and press again: relaxation recovers, a set stays",
        "drift": "free air: drift goes on there, relaxation does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 2)."""
        pressed = np.where(data.engaged, data.position, 0.0)
        times = (inner["fast_time"], inner["slow_time"])
        branches = [relaxed_power(pressed, data.time_s, data.run, inner["n"], tau) for tau in times]
        return np.column_stack(branches)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a few samples to the length of the runs."""
        step_s = sample_time(data.time_s, data.run)
        longest_s = max(float(np.ptp(data.time_s[data.run == run])) for run in data.runs)
        times = np.geomspace(4.0 * step_s, max(longest_s, 40.0 * step_s), 4)
        return tuple(
            {"fast_time": float(fast), "slow_time": float(slow), "n": n}
            for i, fast in enumerate(times[:-1])
            for slow in times[i + 1 :]
            for n in _EXPONENTS
        )
