"""Differences between runs: random effects, and dependence on recorded quantities."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData
from palpate.estimation.effect import Inner, Parameter, SensorEffect, start_grid
from palpate.estimation.effects.sensor_statics import GAIN_DEVIATIONS
from palpate.estimation.effects.torque_ripple import TorqueRipple
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.estimation.signals.motion import is_constant_in_runs
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_TELLING = 0.25  # share of a run's samples, from its start, that determine the run's own value
_FEWEST_RUNS = 3
_COMMON = 2.0  # ratio of mean to standard deviation over runs that chance does not reach
_JUMPS = 0.5  # least ratio of the jumps between consecutive runs to the changes from run to run
_SINGULAR = 1e-10
_SHARE = (
    "The value is estimated in the first quarter of a run; share is the fraction of it that the rest of the "
    "run keeps."
)


class RunVariation(SensorEffect):
    """Random effect: each run has its own values, drawn from a Gaussian with mean zero.

        reading = effort + B(q) b_r,  b_r ~ N(0, spread^2) in run r

    Other runs do not determine the b_r of a held-out run. Each run's value is therefore estimated by least
    squares from its first part (`first_part`) and shrunk by `share`:

        reading = effort + share B(q) b_first,  share = spread^2 / (spread^2 + variance of b_first)

    This is the best linear unbiased prediction of the rest (Henderson 1975). Share 1 means that runs differ
    and keep their initial values; share 0 means that the first part shows only noise. Training and held-out
    runs are treated alike, and no gain is fitted to a held-out run.

    Comparisons with other models exclude the samples of `first_part`, since their effort is used in the
    prediction. `spread` is only reported.
    """

    signals: ClassVar[tuple[str, ...]] = ("recorded",)
    linear = False
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 1.0, (0.2, 1.0)),)

    @abstractmethod
    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the columns by which a run's values are multiplied, shape (n, k).

        Args:
            data: the channel, n samples.
            inner: inner parameters by name.
        """

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: at least three runs, in which the effort changes.

        Fewer runs do not determine the variation, and an offset of each run fits any constant effort.
        """
        has_runs = len(data.runs) >= _FEWEST_RUNS and not is_constant_in_runs(data)
        return super().applies_to(data) and has_runs

    def first_part(self, data: ChannelData) -> BoolArray:
        """Return the mask of samples that determine their run's values, shape (n,).

        Args:
            data: channel with the readings.
        """
        starts, piece = block_index(data.run)
        count = np.diff(np.append(starts, len(data)))[piece]
        return np.arange(len(data)) - starts[piece] < np.ceil(_TELLING * count)

    def values(
        self, effort: FloatArray, data: ChannelData, inner: Inner, rows: BoolArray | None = None
    ) -> FloatArray:
        """Estimate each run's values b by least squares over its first part, shape (runs, k).

        Args:
            effort: predicted effort without variation between runs, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
            rows: mask of samples to use instead of the first part, shape (n,).
        """
        chosen = self.first_part(data) if rows is None else rows
        residual = (data.effort - effort)[:, None]
        return _least_squares(self.basis(data, inner), chosen, residual, block_index(data.run)[0])[:, :, 0]

    def spread(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Estimate the standard deviation of the values between runs, shape (k,), without noise.

        Deviations are taken from the mean over runs, since the mean is missing from the model.

        Args:
            effort: predicted effort without variation between runs, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
        """
        values = self.values(effort, data, inner)
        return np.asarray(np.sqrt(inner["share"] * np.var(values, axis=0, ddof=1)))

    def run_deviations(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return self.basis(data, inner) * self.spread(effort, data, inner)

    def is_common(self, effort: FloatArray, data: ChannelData, inner: Inner) -> bool:
        """Return whether the mean over runs far exceeds their spread, so that the model lacks a constant.

        Args:
            effort: predicted effort without variation between runs, shape (n,).
            data: channel with the readings.
            inner: inner parameters.
        """
        values = self.values(effort, data, inner)
        spread = np.linalg.norm(np.std(values, axis=0, ddof=1))
        return bool(np.linalg.norm(np.mean(values, axis=0)) > _COMMON * spread)

    def is_gradual(self, effort: FloatArray, data: ChannelData, inner: Inner) -> bool:
        """Return whether values change within runs rather than between them, as they do for a drift.

        This is so if the mean change within a run exceeds the spread between runs, or if runs begin with the
        values at which the previous runs ended.

        Args:
            effort: predicted effort without variation between runs, shape (n,).
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
        return (columns + self._predict(data.effort[:, None] - columns, data, inner)).reshape(effort.shape)

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """See `SensorEffect.follow`; each run's values are fitted to the residual of the model."""
        own = self._predict(np.column_stack([columns, data.effort - effort]), data, inner)
        return columns - own[:, :-1], effort + own[:, -1]

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return self.follow(effort, columns, data, inner)[0]

    def _predict(self, residual: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Predict the residuals (n, m) of all samples from the values fitted to each run's first part."""
        basis = self.basis(data, inner)
        starts, piece = block_index(data.run)
        own = _least_squares(basis, self.first_part(data), residual, starts)
        return np.asarray(inner["share"] * np.einsum("nk,nkm->nm", basis, own[piece]))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return start_grid(share=(0.3, 0.7, 0.95))


def _least_squares(basis: FloatArray, rows: BoolArray, target: FloatArray, starts: IntArray) -> FloatArray:
    """Return solutions (runs, k, m) for targets (n, m); zero in directions that a run does not determine."""
    chosen = rows[:, None] * basis
    squares = np.add.reduceat(chosen[:, :, None] * basis[:, None, :], starts)
    sums = np.add.reduceat(chosen[:, :, None] * target[:, None, :], starts)
    return np.asarray(np.linalg.pinv(squares, rcond=_SINGULAR, hermitian=True) @ sums)


class RunOffset(RunVariation):
    name = "run_offset"
    kind = Kind.RUN_DIFFERENCES
    physics = "The sensor was tared, mounted or reset before each run, each time with another zero. " + _SHARE
    equation = "reading = effort + b_r, b_r ~ N(0, spread^2)"
    source = "C. R. Henderson, Biometrics 31 (1975): best linear unbiased prediction in mixed models"
    signature = "each run has its own constant offset"
    signals = ("offset", "recorded")
    confused_with = {
        "bias": "record more runs: a bias is the same in all runs",
        "drift": "record longer runs: a drift continues within each run",
        "contact_offset": "record free air: an offset of the sensor also appears there",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.ones((len(data), 1))


_TELLING_EFFORT = 0.25  # share of a run's squared effort that its first part contains
_SPANNED = 1e-6  # share of the squared effort outside the columns' span up to which they can scale it
_LEAST_SQUARE = 1e-300


class RunGain(RunVariation):
    name = "run_gain"
    kind = Kind.RUN_DIFFERENCES
    physics = "Specimens, spots or battery voltages differ: the whole effort of a run is scaled. " + _SHARE
    equation = "reading = (1 + b_r) effort, b_r ~ N(0, spread^2)"
    source = "N. M. Laird, J. H. Ware, Biometrics 38 (1982): random-effects models for longitudinal data"
    signature = "each run has the same shape as the others, scaled by its own factor"
    signals = ("effort", "recorded")
    confused_with = {
        "torque_gain": "record more runs: a wrong constant is the same in all runs",
        "run_offset": (
            "compare small and large efforts: an offset changes both equally, but a gain changes large ones "
            "more"
        ),
        "recorded_dependence": "also record the suspected cause, such as a temperature",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `RunVariation.basis`; it is zero, since the basis is the model's effort, see `values`."""
        return np.zeros((len(data), 1))

    def values(
        self, effort: FloatArray, data: ChannelData, inner: Inner, rows: BoolArray | None = None
    ) -> FloatArray:
        """See `RunVariation.values`: relative change of each run's effort; zero for a run without effort."""
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
        """See `SensorEffect.follow`; the gains of the runs are held fixed.

        If the columns can scale the effort, the gains are centered on their mean, weighted by the squared
        effort. Otherwise the scale would be arbitrary at share 1, where each run determines its whole gain.
        """
        own = self.values(effort, data, inner)
        left = effort - columns @ np.linalg.lstsq(columns, effort, rcond=None)[0] if columns.size else effort
        if left @ left <= _SPANNED * (effort @ effort):
            first = effort * self.first_part(data)
            own = own - first @ (data.effort - effort) / max(float(first @ first), _LEAST_SQUARE)
        times = 1.0 + inner["share"] * own[block_index(data.run)[1]]
        return columns * times, effort * times[:, 0]

    def run_deviations(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return effort[:, None] * self.spread(effort, data, inner)

    def first_part(self, data: ChannelData) -> BoolArray:
        return _first_effort(data)  # by effort instead of samples, since free air does not show a gain


@cache_by_channel_arrays("effort", "run")
def _first_effort(data: ChannelData) -> BoolArray:
    """Return the mask (n,) of the samples in which a run's first squared effort accumulates."""
    starts, piece = block_index(data.run)
    total = np.cumsum(data.effort**2)
    before = np.concatenate([[0.0], total])[starts]
    whole = np.append(before[1:], total[-1:]) - before
    return np.asarray(total - before[piece] <= _TELLING_EFFORT * whole[piece])


class RunRipple(RunVariation):
    name = "run_ripple"
    kind = Kind.RUN_DIFFERENCES
    physics = (
        "Magnets and teeth cause ripple. Its phase differs between runs, because the encoder's zero is the "
        "position at power-on. "
    ) + _SHARE
    equation = "reading = effort + s_r sin(n q) + c_r cos(n q), with own s_r and c_r in each run"
    source = "J. Holtz, L. Springob, IEEE Trans. Industrial Electronics 43 (1996)"
    signature = "a wave over position with the same wavelength in all runs and a different phase in each"
    signals = ("position", "recorded")
    channels = JOINTS
    inner = (*RunVariation.inner, *TorqueRipple.inner)
    confused_with = {
        "torque_ripple": "go to the same stop before each run: then the wave always begins at the same place",
        "run_offset": "move over a wide range within a run",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        angle = inner["cycles"] * data.position
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({**start, "share": 0.9} for start in TorqueRipple().starts(data))


class RecordedDependence(SensorEffect):
    """Scaling by recorded columns.

    `suited_to` creates one parameter for each recorded column, named after it.

    Args:
        columns: name, mean and standard deviation of each recorded column.
    """

    name = "recorded_dependence"
    kind = Kind.RECORDED_CONTEXT
    physics = "Stiffness, friction or the sensor change with temperature, place or another recorded quantity."
    equation = "reading = (1 + sum_j c_j (r_j - mean r_j)/sd r_j) effort"
    source = "D. C. Montgomery, Design and Analysis of Experiments (2012), ch. 15: covariates"
    signature = "the effort is scaled by a factor that grows with the recorded column"
    signals = ("recorded",)
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
        varies = any(float(np.ptp(data.context[name])) > 0.0 for name in data.recorded)
        return super().applies_to(data) and varies

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        gain = np.ones(len(data))
        for name, mean, deviation in self._columns:
            gain += inner[f"change_{name}"] * (data.context[name] - mean) / deviation
        return gain.reshape(-1, *([1] * (effort.ndim - 1))) * effort

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        names = [parameter.name for parameter in self.inner]
        return tuple(
            {name: change if name == changed else 0.0 for name in names}
            for changed in names
            for change in (*(-GAIN_DEVIATIONS).tolist(), *GAIN_DEVIATIONS.tolist())
        )
