"""Differences between runs: random effects, and what was recorded beside."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData, ChannelKind
from palpate.estimation.effect import Inner, Parameter, SensorEffect, start_grid
from palpate.estimation.effects.torque_ripple import TorqueRipple
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import block_index
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_TELLING = 0.25  # share of a run's samples, from its start, that determine the run's own value
_FEWEST_RUNS = 3
_COMMON = 2.0  # ratio of mean to standard deviation of runs that chance does not reach
_JUMPS = 0.5  # least share of the change between runs that occurs at their borders
_SINGULAR = 1e-10


class RunVariation(SensorEffect):
    """A random effect: each run has values of its own, drawn from a Gaussian about zero.

        reading = effort + B(q) b_r,  b_r ~ N(0, spread^2) in run r

    A run that is held out cannot know its b_r from other runs. So every run tells it by itself: least squares
    over its first part (`first_part`), shrunken by `share`,

        reading = effort + share B(q) b_first,  share = spread^2 / (spread^2 + variance of b_first)

    the best linear prediction of the rest (Henderson 1975). Share 1 means that runs do differ and stay as
    they begin, 0 that what the first part shows is noise. As the first part of a run is used like that
    whether it is held out or not, no gain is fitted to a held-out run, and one formula does for all.

    Judging: the samples of `first_part` are left out of the error wherever a model with such an effect is
    compared with one without, since their own effort has been used; `spread` is for the report.
    """

    signals: ClassVar[tuple[str, ...]] = ("recorded",)
    channels = frozenset(ChannelKind)
    linear = False
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 1.0, (0.2, 1.0)),)

    @abstractmethod
    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the columns that a run's values multiply, shape (n, k).

        Args:
            data: the channel, n samples.
            inner: inner parameters by name.
        """

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`; fewer runs than three say nothing of how runs vary."""
        return super().applies_to(data) and len(data.runs) >= _FEWEST_RUNS

    def first_part(self, data: ChannelData) -> BoolArray:
        """Samples that tell their run's own values, shape (n,).

        Args:
            data: channel with the readings.
        """
        starts, piece = block_index(data.run)
        count = np.diff(np.append(starts, len(data)))[piece]
        return np.arange(len(data)) - starts[piece] < np.ceil(_TELLING * count)

    def values(
        self, effort: FloatArray, data: ChannelData, inner: Inner, rows: BoolArray | None = None
    ) -> FloatArray:
        """Each run's own values b, by least squares over its first part, shape (runs, k).

        Args:
            effort: effort that the model expects without variation, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
            rows: samples to use instead, shape (n,), such as all of them.
        """
        chosen = self.first_part(data) if rows is None else rows
        residual = (data.effort - effort)[:, None]
        return _least_squares(self.basis(data, inner), chosen, residual, block_index(data.run)[0])[:, :, 0]

    def spread(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Standard deviation of the values between runs, shape (k,), without the noise of the first parts.

        About their mean: what all runs have in common, the model lacks.

        Args:
            effort: effort that the model expects without variation, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
        """
        values = self.values(effort, data, inner)
        return np.asarray(np.sqrt(inner["share"] * np.var(values, axis=0, ddof=1)))

    def is_common(self, effort: FloatArray, data: ChannelData, inner: Inner) -> bool:
        """Whether the runs have more in common than they differ by: then the model lacks a constant.

        Args:
            effort: effort that the model expects without variation, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
        """
        values = self.values(effort, data, inner)
        spread = np.linalg.norm(np.std(values, axis=0, ddof=1))
        return bool(np.linalg.norm(np.mean(values, axis=0)) > _COMMON * spread)

    def is_gradual(self, effort: FloatArray, data: ChannelData, inner: Inner) -> bool:
        """Whether values change within runs rather than between them, so that no run has values of its own.

        They do where all runs change by more than they differ, or where a run begins as the last one ended.

        Args:
            effort: effort that the model expects without variation, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
        """
        last = self.first_part(data.select(np.arange(len(data))[::-1]))[::-1]
        first, at_end = self.values(effort, data, inner), self.values(effort, data, inner, last)
        differences = np.linalg.norm(np.diff(first, axis=0), axis=1)
        jumps = np.linalg.norm(first[1:] - at_end[:-1], axis=1)
        within = np.linalg.norm(np.mean(at_end - first, axis=0))
        spread = np.linalg.norm(np.std(first, axis=0, ddof=1))
        return bool(within > spread or np.sum(jumps) < _JUMPS * np.sum(differences))

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        columns = effort.reshape(len(data), -1)
        return (columns + self._of_runs(data.effort[:, None] - columns, data, inner)).reshape(effort.shape)

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """See `SensorEffect.follow`: what the model explains of a run's first part is not the run's own."""
        own = self._of_runs(np.column_stack([columns, data.effort - effort]), data, inner)
        return columns - own[:, :-1], effort + own[:, -1]

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`."""
        return self.follow(effort, columns, data, inner)[0]

    def _of_runs(self, residual: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Predict the residuals (n, m) of all samples from the values fitted to each run's first part."""
        basis = self.basis(data, inner)
        starts, piece = block_index(data.run)
        own = _least_squares(basis, self.first_part(data), residual, starts)
        return np.asarray(inner["share"] * np.einsum("nk,nkm->nm", basis, own[piece]))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return start_grid(share=(0.3, 0.7, 0.95))


def _least_squares(basis: FloatArray, rows: BoolArray, target: FloatArray, starts: IntArray) -> FloatArray:
    """Solutions (runs, k, m) for targets (n, m); zero in directions that a run's rows do not show."""
    chosen = rows[:, None] * basis
    squares = np.add.reduceat(chosen[:, :, None] * basis[:, None, :], starts)
    sums = np.add.reduceat(chosen[:, :, None] * target[:, None, :], starts)
    return np.asarray(np.linalg.pinv(squares, rcond=_SINGULAR, hermitian=True) @ sums)


class RunOffset(RunVariation):
    """reading = effort + b_r in run r, b_r Gaussian about zero; estimated from the run's first part."""

    name = "run_offset"
    kind = Kind.RUN_DIFFERENCES
    physics = "The sensor was tared, mounted or charged anew before each run, with small differences."
    equation = "reading = effort + b_r, b_r ~ N(0, spread^2)"
    source = "C. R. Henderson, Biometrics 31 (1975): best linear unbiased prediction in mixed models"
    signature = "each run has its own constant offset"
    signals = ("offset", "recorded")
    confused_with = {
        "bias": "record more runs: a bias is the same in all",
        "drift": "record longer runs: a drift goes on within each",
        "contact_offset": "record free air: an offset of the sensor is there too",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.ones((len(data), 1))


_TELLING_EFFORT = 0.25  # share of a run's squared effort that its first part contains


class RunGain(RunVariation):
    """reading = (1 + b_r) effort in run r, b_r Gaussian about zero; estimated from the run's first part.

    That part lasts until a quarter of the squared effort has occurred, since free air does not show a gain.
    """

    name = "run_gain"
    kind = Kind.RUN_DIFFERENCES
    physics = "Specimens, spots or battery voltages differ: the whole effort of a run is scaled."
    equation = "reading = (1 + b_r) effort, b_r ~ N(0, spread^2)"
    source = "N. M. Laird, J. H. Ware, Biometrics 38 (1982): random-effects models for longitudinal data"
    signature = "each run has the same shape as the others, scaled by its own factor"
    signals = ("effort", "recorded")
    confused_with = {
        "torque_gain": "record more runs: a wrong constant is the same in all",
        "run_offset": "look where the effort is small: an offset is there too, a gain is not",
        "recorded_dependence": "record the suspected cause, such as a temperature, beside",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `RunVariation.basis`: here it is the effort itself, which only the model knows."""
        return np.zeros((len(data), 1))

    def values(
        self, effort: FloatArray, data: ChannelData, inner: Inner, rows: BoolArray | None = None
    ) -> FloatArray:
        """See `RunVariation.values`: by how much each run's effort is larger; nothing where there is none."""
        chosen = self.first_part(data) if rows is None else rows
        starts, _ = block_index(data.run)
        squares = np.add.reduceat(chosen * effort**2, starts)
        products = np.add.reduceat(chosen * effort * (data.effort - effort), starts)
        return np.asarray(products / np.where(squares > 0.0, squares, np.inf))[:, None]

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        if effort.ndim == 2:
            return np.stack([self.sense(column, data, inner) for column in effort.T], axis=1)
        own = self.values(effort, data, inner)[block_index(data.run)[1], 0]
        return np.asarray(effort * (1.0 + inner["share"] * own))

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """See `SensorEffect.follow`; the runs' gains as they are."""
        times = 1.0 + inner["share"] * self.values(effort, data, inner)[block_index(data.run)[1]]
        return columns * times, effort * times[:, 0]

    def first_part(self, data: ChannelData) -> BoolArray:
        starts, piece = block_index(data.run)
        total = np.cumsum(data.effort**2)
        before = np.concatenate([[0.0], total])[starts]
        whole = np.append(before[1:], total[-1:]) - before
        return np.asarray(total - before[piece] <= _TELLING_EFFORT * whole[piece])


class RunRipple(RunVariation):
    """reading = effort + s_r sin(n q) + c_r cos(n q) in run r, estimated from the run's first part."""

    name = "run_ripple"
    kind = Kind.RUN_DIFFERENCES
    physics = (
        "Magnets and teeth cause ripple, and the encoder's zero is the position at which it was switched on."
    )
    equation = "reading = effort + s_r sin(n q) + c_r cos(n q), s_r and c_r of each run"
    source = "J. Holtz, L. Springob, IEEE Trans. Industrial Electronics 43 (1996)"
    signature = "a wave over position with the same wavelength in all runs and a different phase in each"
    signals = ("position", "recorded")
    channels = JOINTS
    inner = (*RunVariation.inner, *TorqueRipple.inner)
    confused_with = {
        "torque_ripple": "go to one stop before each run: then the wave begins at one place",
        "run_offset": "move over a wide range within a run",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        angle = inner["cycles"] * data.position
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({**start, "share": 0.9} for start in TorqueRipple().starts(data))


class RecordedDependence(SensorEffect):
    """reading = (1 + c u) effort, u the recorded column less its mean, in standard deviations.

    `suited_to` makes one such parameter for each column that was recorded, by its name.

    Args:
        columns: name, mean and standard deviation of each.
    """

    name = "recorded_dependence"
    kind = Kind.RECORDED_CONTEXT
    physics = "Stiffness, friction or the sensor change with temperature, place or another recorded quantity."
    equation = "reading = (1 + sum_j c_j (r_j - mean r_j)/sd r_j) effort"
    source = "D. C. Montgomery, Design and Analysis of Experiments (2012), ch. 15: covariates"
    signature = "the effort is scaled by a factor that grows with the recorded column"
    signals = ("recorded",)
    channels = frozenset(ChannelKind)
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("change", "1", -3.0, 3.0, (-0.3, 0.3)),)
    linear = True
    confused_with = {
        "run_gain": "vary the recorded quantity within a run",
        "drift": "vary the recorded quantity up and down, not steadily with time",
        "torque_gain": "vary the recorded quantity: a wrong constant is always the same",
    }

    def __init__(self, columns: tuple[tuple[str, float, float], ...] = ()) -> None:
        self._columns = columns
        if columns:
            change = RecordedDependence.inner[0]
            names = [f"change_{name}" for name, _, _ in columns]
            self.inner = tuple(  # type: ignore[misc]  # how many there are depends on the data
                Parameter(name, change.unit, change.lower, change.upper, change.typical) for name in names
            )

    def suited_to(self, data: ChannelData) -> "RecordedDependence":
        recorded = {name: data.context[name] for name in sorted(data.recorded)}
        statistics = ((name, float(np.mean(r)), float(np.std(r))) for name, r in recorded.items())
        return RecordedDependence(tuple(column for column in statistics if column[2] > 0.0))

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: something was recorded, and it varies."""
        varies = any(float(np.ptp(data.context[name])) > 0.0 for name in data.recorded)
        return super().applies_to(data) and varies

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        gain = np.ones(len(data))
        for name, mean, deviation in self._columns:
            gain += inner[f"change_{name}"] * (data.context[name] - mean) / deviation
        return gain.reshape(-1, *([1] * (effort.ndim - 1))) * effort

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: one column after the other, to either side."""
        names = [parameter.name for parameter in self.inner]
        return tuple(
            {name: change if name == changed else 0.0 for name in names}
            for changed in names
            for change in (-0.2, -0.03, 0.03, 0.2)
        )
