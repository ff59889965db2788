"""Memory over time: elastic force that relaxes on one, two or all time scales."""

from collections.abc import Callable
from copy import copy
from functools import partial
from itertools import combinations
from typing import Self

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import (
    AdditiveEffect,
    Effect,
    Inner,
    MemoryEffect,
    Parameter,
    start_grid,
    variant,
)
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.signals.cache_by_array import IdentityKey
from palpate.estimation.signals.contact_memory import (
    free_surface_memory,
    pressed_samples,
    remaining_strain,
)
from palpate.estimation.signals.exponential_memory import fading_memory, springpot
from palpate.estimation.signals.runwise import finest_step, longest_run
from palpate.robot_io.types import BoolArray, FloatArray

_TOUCH = 0.01  # depth relative to the deepest at which a run begins hardly pressed


class _Relaxation(Effect):
    """Memory that begins a run after a sudden press to its first depth or, in form 1, relaxed at this depth.

    In air, both forms are equal. The data decide between them if runs begin pressed.
    """

    begins_pressed = False

    def suited_to(self, data: ChannelData) -> Self:
        """See `Effect.suited_to`: there are two forms if runs begin pressed."""
        if not np.any(_begins_pressed(data)):
            return self
        suited: Self = variant(IdentityKey(self), begins_pressed=True)
        return suited

    def forms(self) -> tuple[Self, ...]:
        """See `Effect.forms`: the start after a sudden press, then the relaxed one."""
        if not self.begins_pressed:
            return (self,)
        forms = copy(self), copy(self)
        for number, each in enumerate(forms):
            each.form = number
        return forms

    def relaxed(
        self,
        memory: Callable[..., FloatArray],
        signal: FloatArray,
        data: ChannelData,
        remaining: FloatArray | None = None,
    ) -> FloatArray:
        """Return a strain or elastic force, (n,) or (n, k), after relaxation with this memory.

        Args:
            memory: function of a signal, the times (n,) [s], the run numbers (n,) and `independent_runs`; it
                returns what remains of the signal, in its shape.
            signal: strain or elastic force, shape (n,) or (n, k).
            data: the channel, n samples. In form 1, runs that begin in contact begin relaxed.
            remaining: the result without such runs; None to compute it.
        """
        if remaining is None:
            remaining = remaining_strain(memory, signal, data.time_s, data.run, data, pressed_samples(data))
        if self.form:
            first, piece = block_index(data.run)
            change = memory(signal - signal[first][piece], data.time_s, data.run, independent_runs=True)
            rested = _begins_pressed(data)[piece]
            remaining[rested] = change[rested]
        return remaining


def _begins_pressed(data: ChannelData) -> BoolArray:
    """Return whether each run begins clearly in contact."""
    first, _ = block_index(data.run)
    return data.engaged[first] & (data.position[first] > _TOUCH * data.deepest)


class StressRelaxation(_Relaxation, AdditiveEffect):
    """Maxwell branch parallel to the spring: F = k1 z with z' = x' - z / tau, z = 0 before the first run.

    The state z persists between runs unless the object has recovered, see `ChannelData.recovers`.
    """

    name = "stress_relaxation"
    kind = Kind.TIME_MEMORY
    physics = "Part of the elastic force relaxes with time, as in flesh, rubber and foam."
    equation = "F = k1 z, z' = x' - z/tau, x only while pressed"
    source = "C. Zener, Elasticity and Anelasticity of Metals (1948); Y. C. Fung, Biomechanics (1993), ch. 7"
    signature = "force falls during a hold at constant depth, and is lower on the way out than on the way in"
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k1", "{effort}/{position}", 0.0, 1e12, (10.0, 10000.0)),)
    inner = (Parameter("tau", "s", 1e-9, 1e7, (0.03, 30.0), log=True),)
    confused_with = {
        "power_law_relaxation": (
            "hold 100 times longer: a power law keeps relaxing, but one branch levels off"
        ),
        "relaxation_spectrum": (
            "hold longer at two depths: one branch levels off, but a second keeps relaxing"
        ),
        "damping": "hold: damping stops with the motion, but relaxation continues",
        "plastic_set": "wait and press again: relaxation recovers, but a permanent set remains",
        "hysteresis": "hold: a hysteresis of the sensor does not change with time",
        "drift": "record free air: drift continues there, but relaxation does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        pressed, rates = np.where(data.engaged, data.position, 0.0)[:, None], np.array([1.0 / inner["tau"]])
        free, share = None, 1.0 - data.recovery_ratio
        if share:
            free = free_surface_memory(pressed, data, rates, np.array([share])) / share
        memory = partial(fading_memory, rates=rates, weights=np.ones(1))
        return self.relaxed(memory, pressed, data, free)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return start_grid(tau=_time_constants(data, 9, 3.0))


class PowerLawRelaxation(_Relaxation, MemoryEffect):
    """F = integral ((1 - share) + share ((t - s) / 1 s)^-alpha) dE(s), where E is the elastic force.

    This is quasi-linear viscoelasticity with a springpot, between a spring (alpha 0) and a dashpot (alpha 1),
    and a permanent part. Stiffness refers to one second after a sudden press.
    """

    name = "power_law_relaxation"
    kind = Kind.TIME_MEMORY
    physics = "Elastic force relaxes on all time scales equally, as in muscle, cells and gels."
    equation = "F = integral (1 - share + share ((t - s)/1 s)^-alpha) dE(s), E elastic"
    source = (
        "R. L. Bagley, P. J. Torvik, J. Rheology 27 (1983); B. Fabry et al., Phys. Rev. Lett. 87 (2001): "
        "scale-free relaxation of cells"
    )
    signature = (
        "force in a hold falls by the same amount in each decade of time; the peak force grows as a small "
        "power of the speed"
    )
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("share", "1", 0.0, 1.0, (0.1, 0.9)), Parameter("alpha", "1", 0.01, 0.99, (0.1, 0.6)))
    confused_with = {
        "stress_relaxation": "hold for longer: one branch levels off, but a power law keeps relaxing",
        "relaxation_spectrum": "hold 100 times longer: a power law keeps relaxing, but branches level off",
        "damping": "hold: damping stops with the motion, but relaxation continues",
        "drift": "record free air: drift continues there, but relaxation does not",
    }

    def fade(self, elastic: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        share = inner["share"]
        fading = self.relaxed(partial(springpot, alpha=inner["alpha"]), elastic, data)
        return (1.0 - share) * elastic + share * fading

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a spring with little relaxation to nearly a dashpot.

        After a tenth of the longest run, the springpot bears 20, 50 or 90 % of the force.
        """
        late_s = 0.1 * longest_run(data.time_s, data.run)
        return tuple(
            {"share": part / (part + (1.0 - part) * late_s**-alpha), "alpha": alpha}
            for part in (0.2, 0.5, 0.9)
            for alpha in (0.08, 0.2, 0.4, 0.7)
        )


_BRANCH_SHARES = (0.15, 0.4)


def _time_constants(data: ChannelData, count: int, longest: float) -> FloatArray:
    """Return time constants from four samples to a multiple of the longest run's duration, shape (count,)."""
    step_s = finest_step(data.time_s, data.run)
    last_s = max(longest * longest_run(data.time_s, data.run), 40.0 * step_s)
    return np.geomspace(4.0 * step_s, last_s, count)


class RelaxationSpectrum(_Relaxation, MemoryEffect):
    """F = (1 - f - s) E + f Z_f + s Z_s, Z' = E' - Z / tau, where E is the instantaneous elastic force.

    This is quasi-linear viscoelasticity with two branches, which applies to any elastic law.
    Stiffness refers to a sudden press. `stress_relaxation` is one branch with a linear spring.
    """

    name = "relaxation_spectrum"
    kind = Kind.TIME_MEMORY
    physics = "Parts of the elastic force relax, some fast and some slowly, as in tissue and rubber."
    equation = "F = (1 - fast - slow) E + fast Z_fast + slow Z_slow, Z_i' = E' - Z_i/tau_i, E elastic"
    source = "Y. C. Fung, Biomechanics (1993), ch. 7.6: quasi-linear viscoelasticity; Prony series"
    signature = "force falls during a hold, fast at first and then slowly, by the same share at any depth"
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    inner = (
        Parameter("fast", "1", 0.0, 1.0, (0.1, 0.5)),
        Parameter("slow", "1", 0.0, 1.0, (0.1, 0.5)),
        Parameter("fast_time", "s", 1e-9, 1e7, (0.03, 3.0), log=True),
        Parameter("slow_time", "s", 1e-9, 1e7, (1.0, 100.0), log=True),
    )
    confused_with = {
        "stress_relaxation": "hold longer at two depths: one branch levels off, but a second keeps relaxing",
        "power_law_relaxation": "hold 100 times longer: a power law keeps relaxing, but branches level off",
        "plastic_set": "wait and press again: relaxation recovers, but a permanent set remains",
        "drift": "record free air: drift continues there, but relaxation does not",
    }

    def fade(self, elastic: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        shares = np.array([inner["fast"], inner["slow"]])
        rates = 1.0 / np.array([inner["fast_time"], inner["slow_time"]])
        free = free_surface_memory(elastic, data, rates, shares) if data.recovery_ratio != 1.0 else None
        memory = partial(fading_memory, rates=rates, weights=shares)
        fading = self.relaxed(memory, elastic, data, free)
        return np.asarray((1.0 - shares.sum()) * elastic + fading)

    def in_order(self, inner: Inner) -> Inner:
        """See `Effect.in_order`: the fast branch has the shorter time constant."""
        if inner["fast_time"] <= inner["slow_time"]:
            return inner
        return {
            "fast": inner["slow"],
            "slow": inner["fast"],
            "fast_time": inner["slow_time"],
            "slow_time": inner["fast_time"],
        }

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        times = _time_constants(data, 4, 1.0)
        return tuple(
            {"fast": fast, "slow": slow, "fast_time": float(sooner), "slow_time": float(later)}
            for sooner, later in combinations(times, 2)
            for fast in _BRANCH_SHARES
            for slow in _BRANCH_SHARES
        )
