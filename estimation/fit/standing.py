"""Where a diagnosis stands: a model, its fit, the noise's colour, and what could still be explained."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.colour import WHITE, colour_of
from estimation.fit.flexible import Flexible, Windows, flexible
from estimation.fit.frame import frame_of, off_borders
from estimation.fit.load import with_load
from estimation.fit.memory import Memory
from estimation.fit.polish import polish
from estimation.fit.readings import readings_of
from estimation.fit.trial import Bench, Trial, attempt, held_out_residual, rmse
from estimation.model import Model
from robot_io.types import BoolArray, IntArray

_DIGITS = 1e-7  # of the effort: single precision keeps 6e-8, and the fit's own shrinkage leaves some 1e-9
_SHARE = 0.4  # of the most telling signal's share; signals with less are not named
_LEAST = 0.01
_OF_VELOCITY = frozenset({"velocity", "direction"})


@dataclass(frozen=True, eq=False)
class Fit:
    """A model fitted to a channel."""

    data: ChannelData  # the channel with its load
    plain: Bench  # blocks, and no colour
    trial: Trial  # the model fitted there

    @property
    def mean_square(self) -> float:
        """What is left of blocks that count, in the fit itself."""
        return self.trial.sse / max(int(self.plain.frame.trusted.sum()), 1)

    @property
    def held_out_mean_square(self) -> float:
        """What is left of blocks that count, in held-out runs."""
        return self.trial.held_out / max(int(self.plain.kept.sum()), 1)


@dataclass(frozen=True, eq=False)
class Standing(Fit):
    """A model on its bench, and what it leaves.

    Parameters come from plain least squares: before the model is complete, what it misses would pass for
    coloured noise and be weighed away. The colour is for judging.
    """

    @property
    def windows(self) -> Windows:
        """That velocity and acceleration went through, as far as the model depends on these."""
        readings = readings_of(self.data)
        first, second = (() if one is None else (one,) for one in readings.windows)
        felt = {signal for effect in self.trial.model.effects for signal in effect.signals}
        both = (*first, *second) if readings.is_of_velocity else second
        return first if felt & _OF_VELOCITY else (), both if "acceleration" in felt else ()

    @cached_property
    def flexible(self) -> Flexible:
        """What any smooth law could explain beyond the model."""
        return flexible(self.plain, self.trial, self.windows)

    @cached_property
    def judge(self) -> Bench:
        """The same blocks with the colour of what the flexible regression leaves."""
        frame = self.plain.frame
        return Bench(frame, colour_of(self.flexible.residual, frame.run, frame.trusted))

    @cached_property
    def rmse(self) -> float:
        """Error in held-out runs, sample by sample."""
        return rmse(held_out_residual(self.plain.frame, self.trial))

    @property
    def is_exact(self) -> bool:
        """Whether no more than the last digits of the numbers is left: the data were made without noise.

        That is smaller than any reader's noise, and has a shape all the same: rounding and the fit's own
        shrinkage depend on the signals. It is no law of the object.
        """
        return self.rmse <= _DIGITS * float(np.sqrt(np.mean(self.data.effort**2)))

    @property
    def depends_on(self) -> list[str]:
        """Signals that the remaining error depends on in held-out runs, the most telling first."""
        shares = self.flexible.by_signal
        most = max(shares.values(), default=0.0)
        if most < _LEAST:
            return []
        told = [name for name, share in shares.items() if share >= max(_SHARE * most, _LEAST)]
        return sorted(told, key=lambda name: -shares[name])

    def floor(self) -> float:
        """The error that would be left, sample by sample, if all that can be explained were known."""
        count = max(int(self.plain.frame.trusted.sum()), 1)
        return float(np.sqrt(max(self.rmse**2 - max(self.flexible.explained, 0.0) / count, 0.0)))

    def floor_in(self, runs: IntArray) -> float:
        """The same in some of the runs alone, each still judged by the others."""
        frame = self.plain.frame
        chosen = frame.trusted & np.isin(frame.run, runs)
        left = held_out_residual(frame, self.trial)[frame.rows[chosen]]
        without, beside = self.flexible.residual_before, self.flexible.residual
        explainable = float(np.mean(without[chosen] ** 2 - beside[chosen] ** 2))
        return float(np.sqrt(max(float(np.mean(left**2)) - max(explainable, 0.0), 0.0)))

    def left_of_blocks(self) -> float:
        """Share of the error in held-out runs, on blocks, that can be explained; see `floor`."""
        return self.flexible.share_of(self.trial)


def fit(
    data: ChannelData,
    model: Model,
    parameters: Mapping[str, float],
    good: BoolArray | None = None,
    memory: Memory | None = None,
) -> Fit:
    """Fit a model from these parameters on.

    Args:
        data: the channel, without a `load` that was derived.
        model: what to fit.
        parameters: inner parameters, and gains where they are known.
        good: samples that are fit for use, shape (n,); None for all.
        memory: of other fits to this channel.
    """
    memory = memory or Memory()
    known = dict.fromkeys(model.gains, 0.0) | {n: inner.beginning for n, inner in model.inner.items()}
    known |= {name: parameters[name] for name in known.keys() & parameters.keys()} | dict(model.held)
    first = attempt(bench_of(data, model, known, good, memory), model, known, rounds=3)
    plain = bench_of(data, model, first.parameters, good, memory)
    trial = polish(plain, first)
    again = bench_of(data, model, trial.parameters, good, memory)
    if not np.array_equal(again.frame.trusted, plain.frame.trusted):  # the contact begins elsewhere
        plain, trial = again, polish(again, trial)
    return Fit(plain.frame.data, plain, trial)


def stand(
    data: ChannelData,
    model: Model,
    parameters: Mapping[str, float],
    good: BoolArray | None = None,
    memory: Memory | None = None,
) -> Standing:
    """Fit a model, see `fit`, and measure what it leaves."""
    fitted = fit(data, model, parameters, good, memory)
    return Standing(fitted.data, fitted.plain, fitted.trial)


def bench_of(
    data: ChannelData,
    model: Model,
    parameters: Mapping[str, float],
    good: BoolArray | None,
    memory: Memory,
) -> Bench:
    """The blocks of a channel on which a model with these parameters is judged; see `fit`."""
    frame = frame_of(with_load(data, model, parameters), good, memory)
    if data.kind is not ChannelKind.CONTACT:
        return Bench(frame, WHITE)
    return Bench(off_borders(frame, model.moved(frame.data, parameters)), WHITE)
