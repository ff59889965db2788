"""Compare two measurements, or two models of one measurement: mutual predictions and differences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.effects.contact_geometry import ContactOffset
from palpate.estimation.estimate import DisplayTable, ParameterEstimate, TableDisplay
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.fit.measurement_noise import NoiseSource, rows_before_contact
from palpate.estimation.fit.samples import slopes_of
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.runwise import sample_time
from palpate.estimation.statistics.correlation import (
    Correlation,
    autocorrelation,
    cross_correlation,
    fit_percent,
)
from palpate.estimation.statistics.noise import sum_covariance
from palpate.estimation.statistics.uncertainty import sandwich
from palpate.estimation.study.channels import StudyChannel
from palpate.estimation.study.comparison import Comparison
from palpate.estimation.study.study import ModelStudy
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

# Channels with the effects added to their base models.
Extended = Sequence[tuple[StudyChannel, Sequence[str]]]
# Largest lag as a share of the median run, with its lower and upper limit in samples.
_LAG_SHARE, _MIN_LAGS, _MAX_LAGS = 0.1, 25, 400
_MIN_OVERLAP = 0.9  # least ratio of the shorter to the longer run for a comparison over time
_SAME_MOTION = 0.1  # largest relative difference of two motions that count as equal
_MAX_REPEATED = 1.2  # ratio to the noise above which few samples do not excuse a difference
# Least change of the effort by a parameter's difference that is reported, in noise levels.
_MIN_NOISE_LEVELS = 0.05
_OFFSET = f"{ContactOffset.name}.offset"  # from the surface that was detected in the same measurement
_SURFACE = "surface.position"  # the same along the press direction, which measurements share


@dataclass(frozen=True, eq=False)
class ComparedModel:
    """One of two compared measurements or models."""

    name: str  # label of this side
    channel: StudyChannel  # the channel with its base model
    effects: Sequence[str]  # names of the added effects
    compared: Comparison | None  # comparison of model and measurement; None if the channel cannot be fitted
    reason: str = ""  # reason why it cannot be fitted

    @property
    def data(self) -> ChannelData:
        """The measurement, with the signals derived for the model."""
        return self.channel.measured if self.compared is None else self.compared.fitted.data

    @property
    def model(self) -> str:
        """Name of the model, with the added effects."""
        return " + ".join([self.channel.model.name, *self.effects])

    @property
    def parameters(self) -> Mapping[str, ParameterEstimate]:
        """Parameters by "effect.parameter"; empty if nothing was fitted.

        An offset from a detected surface becomes the position of the surface along the press direction. Its
        standard error is that of the offset, because an error of the detected surface cancels in the sum.
        """
        known = {} if self.compared is None else self.compared.parameters
        if (surface := self.data.surface) is None or _OFFSET not in known:
            return known
        offset = known[_OFFSET]
        low, high = (surface.position_m + end for end in offset.interval)
        placed = replace(offset, name=_SURFACE, value=surface.position_m + offset.value, interval=(low, high))
        return {_SURFACE if name == _OFFSET else name: known[name] for name in known} | {_SURFACE: placed}

    @property
    def residual(self) -> FloatArray:
        """Effort minus prediction from the other runs, shape (n,); NaN if not scored."""
        return np.full(len(self.data), np.nan) if self.compared is None else self.compared.fitted.residual

    @cached_property
    def lags(self) -> int:
        """Largest lag of the correlations [samples]."""
        length = float(np.median([len(rows) for rows in rows_of_runs(self.data.run)]))
        return int(np.clip(_LAG_SHARE * length, _MIN_LAGS, _MAX_LAGS))

    @property
    def step_s(self) -> float:
        """Time between samples, the unit of the lags [s]."""
        return sample_time(self.data.time_s, self.data.run)

    @cached_property
    def autocorrelation(self) -> Correlation:
        """Autocorrelation of the residual."""
        return autocorrelation(self.residual, self.data.run, self.lags)

    @cached_property
    def cross_correlation(self) -> Correlation:
        """Cross-correlation of the residual with the velocity."""
        return cross_correlation(self.residual, self.data.velocity, self.data.run, self.lags)

    def noise_ratio_of(self, other: "ComparedModel") -> float:
        """Return the error of this model on the other measurement, relative to its noise; NaN if unknown.

        Args:
            other: the side whose measurement is predicted.
        """
        scored = self._scored(other)
        if scored is None or other.compared is None:
            return float("nan")
        error, noise = float(np.sqrt(np.mean((scored[0] - scored[1]) ** 2))), other.compared.noise.value
        return error / noise if noise > 0.0 else float("inf")

    def _scored(self, other: "ComparedModel") -> tuple[FloatArray, FloatArray] | None:
        """Return the other side's scored efforts (n,) and their prediction by this model; None if impossible.

        The prediction of its own measurement is cross-validated.
        """
        if self.compared is None or other.compared is None:
            return None
        scored, effort = other.compared.fitted.scored, other.data.effort
        if other is self:
            return effort[scored], (effort - self.residual)[scored]
        try:
            predicted = self.compared.fitted.model.predict(other.data, self.compared.fitted.values)
        except (InputError, KeyError):  # the other measurement lacks a signal that this model needs
            return None
        return effort[scored], predicted[scored]

    def fit_of(self, other: "ComparedModel") -> float:
        """Return how well this model fits the other measurement [%]; its own measurement is cross-validated.

        Args:
            other: the side whose measurement is predicted.
        """
        scored = self._scored(other)
        return float("nan") if scored is None else fit_percent(*scored)


@dataclass(frozen=True)
class ParameterDifference:
    """One parameter on both sides."""

    name: str  # "effect.parameter"
    unit: str  # SI unit
    first: ParameterEstimate | None  # estimate of the first side; None if its model lacks the parameter
    second: ParameterEstimate | None  # estimate of the second side; None if its model lacks the parameter
    # Whether both come from one measurement, so that their errors are not independent.
    is_same_data: bool = False
    # Standard error of the difference if one measurement repeats the other; None if errors are independent.
    paired_std_err: float | None = None
    noise_levels: float = float("inf")  # change of the effort by the difference, in noise levels

    @property
    def value(self) -> float:
        """Second minus first value; NaN if one is missing."""
        if self.first is None or self.second is None:
            return float("nan")
        return self.second.value - self.first.value

    @property
    def half(self) -> float:
        """Half width of the difference's 95 % interval; NaN if unknown."""
        if self.first is None or self.second is None or self.is_same_data:
            return float("nan")
        if self.paired_std_err is not None:
            return SIGMAS_95 * self.paired_std_err
        return SIGMAS_95 * float(np.hypot(self.first.std_err, self.second.std_err))

    @property
    def is_coordinate(self) -> bool:
        """Whether the value counts from an arbitrary zero, so that its ratio to another one means nothing."""
        return self.name in {_OFFSET, _SURFACE}

    @property
    def differs(self) -> bool | None:
        """Whether the difference is significant and changes the effort; None if there is no interval."""
        if not np.isfinite(self.half):
            return None
        return bool(abs(self.value) > self.half) and self.noise_levels > _MIN_NOISE_LEVELS


@dataclass(frozen=True, eq=False, repr=False)
class PairedComparison(TableDisplay):
    """One channel on both sides."""

    first: ComparedModel
    second: ComparedModel

    @property
    def channel(self) -> str:
        """Name of the channel."""
        return self.first.channel.name

    @property
    def is_same_data(self) -> bool:
        """Whether both sides have the same measurement and differ only in the model."""
        return self.first.channel.sha256 == self.second.channel.sha256

    @cached_property
    def differences(self) -> tuple[ParameterDifference, ...]:
        """Differences of all parameters of both models."""
        first, second = self.first.parameters, self.second.parameters
        return tuple(
            ParameterDifference(
                name,
                (first.get(name) or second[name]).unit,
                first.get(name),
                second.get(name),
                self.is_same_data,
                self._paired_errors.get(_OFFSET if name == _SURFACE else name),
                self._noise_levels_of(name),
            )
            for name in dict.fromkeys([*first, *second])
        )

    @cached_property
    def _paired_errors(self) -> Mapping[str, float]:
        """Standard errors of the differences if one measurement repeats the other; empty otherwise.

        If both sides have the same motion with derivatives X, the difference of the least-squares estimates
        is (X'X)^-1 X'(eB - eA). The common part of both residuals cancels, such as that of a missing effect.
        """
        a, b = self.first.compared, self.second.compared
        if a is None or b is None or list(a.parameters) != list(b.parameters):
            return {}
        residual_b = np.where(b.fitted.scored, b.fitted.data.effort - b.fitted.predicted, np.nan)
        position, aligned_b = map(self._at_times_of_first, (self.second.data.position, residual_b))
        if position is None or aligned_b is None:
            return {}
        residual = aligned_b - (a.fitted.data.effort - a.fitted.predicted)
        rows = a.fitted.scored & np.isfinite(residual)
        distance = np.nanstd(position - self.first.data.position)
        if not rows.any() or distance > _SAME_MOTION * np.std(self.first.data.position):
            return {}
        slopes, run = self._slopes[rows], a.fitted.data.run[rows]
        free = slopes.any(axis=0)
        covariance = sandwich(slopes[:, free], residual[rows], np.ones(len(run)), run)
        names = np.array([*a.fitted.model.gains, *a.fitted.model.inner])[free].tolist()
        errors = dict(zip(names, covariance.std_err.tolist(), strict=True))
        return {name: error for name, error in errors.items() if np.isfinite(error)}

    @cached_property
    def _slopes(self) -> FloatArray:
        """Derivatives of the first model's effort by its parameters, shape (n, p)."""
        assert self.first.compared is not None  # noqa: S101, the callers check it
        fitted = self.first.compared.fitted
        return slopes_of(fitted.model, fitted.data, fitted.values)

    def _noise_levels_of(self, name: str) -> float:
        """Return the change of the effort by a parameter's difference, in noise levels; inf if unknown."""
        a, b = self.first.compared, self.second.compared
        values, others = self.first.parameters, self.second.parameters
        if a is None or b is None or name not in values or name not in others:
            return float("inf")
        model, own = a.fitted.model, _OFFSET if name == _SURFACE else name
        slope = self._slopes[a.fitted.scored, [*model.gains, *model.inner].index(own)]
        change = abs(others[name].value - values[name].value) * float(np.sqrt(np.mean(slope**2)))
        floor = max(a.noise.value, b.noise.value)
        return change / floor if floor > 0.0 else float("inf")

    @cached_property
    def overlay(self) -> FloatArray | None:
        """Second effort at the times of the first, shape (n,); None if the motion was not repeated."""
        return self._at_times_of_first(self.second.data.effort)

    def _at_times_of_first(self, values: FloatArray) -> FloatArray | None:
        """Interpolate values of the second side (m,) to the times of the first, (n,), since each run's start.

        Values after the end of the second run are NaN. The result is None if runs differ in number or
        duration, so that the motion was not repeated.
        """
        a, b = self.first.data, self.second.data
        if self.is_same_data or len(a.runs) != len(b.runs):
            return None
        matched = np.full(len(a), np.nan)
        for run, run_of_b in zip(a.runs, b.runs, strict=True):
            rows, rows_of_b = a.run == run, b.run == run_of_b
            t, u = a.time_s[rows] - a.time_s[rows][0], b.time_s[rows_of_b] - b.time_s[rows_of_b][0]
            if min(t[-1], u[-1]) < _MIN_OVERLAP * max(t[-1], u[-1]):
                return None
            matched[rows] = np.interp(t, u, values[rows_of_b], right=np.nan)
        return matched

    @property
    def agreement_percent(self) -> float:
        """Agreement of the two efforts over time [%]; NaN if the motion was not repeated."""
        return float("nan") if self.overlay is None else fit_percent(self.first.data.effort, self.overlay)

    @property
    def difference_in_noise(self) -> float:
        """Difference between the two efforts over time, relative to the noise of both; NaN if unknown."""
        a, b = self.first.compared, self.second.compared
        if self.overlay is None or a is None or b is None:
            return float("nan")
        rms = np.sqrt(np.nanmean((self.overlay - self.first.data.effort) ** 2))
        return float(rms / max(np.hypot(a.noise.value, b.noise.value), np.finfo(float).tiny))

    @cached_property
    def repeats(self) -> bool:
        """Whether no parameter differs, and the efforts differ by no more than the noise of both.

        The mean square of the difference must not exceed the sum of both squared noise levels significantly
        (95 %). Its standard error allows for autocorrelation, and those of the noise levels for the samples
        from which they come.
        """
        a, b = self.first.compared, self.second.compared
        if self.overlay is None or a is None or b is None or any(each.differs for each in self.differences):
            return False
        squares = (self.overlay - self.first.data.effort) ** 2
        known = np.isfinite(squares)
        mean, levels = float(squares[known].mean()), np.array([a.noise.value, b.noise.value]) ** 2
        samples = [
            sum(map(len, rows_before_contact(side.data)))
            if compared.noise.source is NoiseSource.FREE_AIR
            else len(side.data)
            for side, compared in ((self.first, a), (self.second, b))
        ]
        total = sum_covariance(squares[known, None] - mean, self.first.data.run[known]).matrix[0, 0]
        variance = total / np.count_nonzero(known) ** 2 + float(np.sum(2.0 * levels**2 / samples))
        is_significant = mean - levels.sum() > SIGMAS_95 * np.sqrt(variance)
        return self.difference_in_noise < _MAX_REPEATED and not is_significant

    @cached_property
    def fit_matrix(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Fit [%] of each model (row) to each measurement (column)."""
        pair = (self.first, self.second)
        first, second = ((side.fit_of(pair[0]), side.fit_of(pair[1])) for side in pair)
        return first, second

    def _table(self) -> DisplayTable:
        rows = [
            (
                d.name,
                *(f"{estimate.value:.5g}" if estimate else "" for estimate in (d.first, d.second)),
                f"{d.value:.3g}",
                f"{d.half:.2g}",
            )
            for d in self.differences
        ]
        names = (self.first.name, self.second.name)
        return DisplayTable(
            f"{self.channel}: {names[1]} compared with {names[0]}",
            ("parameter", *names, "difference", "+-"),
            rows,
        )


def compare_pairs(
    first: ModelStudy,
    second: ModelStudy,
    names: tuple[str, str],
    extended: tuple[Extended, Extended] | None = None,
) -> tuple[PairedComparison, ...]:
    """Pair the channels that two studies share, with their base models or with added effects.

    Args:
        first: study to compare with.
        second: study to compare.
        names: labels of the two studies.
        extended: channels of each study with their added effects; None for all base models.

    Raises:
        InputError: the studies share no channel.
    """
    chosen = extended or [[(channel, ()) for channel in study.channels] for study in (first, second)]
    comparisons = tuple(
        PairedComparison(
            _side(names[0], first, channel, effects), _side(names[1], second, other, other_effects)
        )
        for channel, effects in chosen[0]
        for other, other_effects in chosen[1]
        if other.name == channel.name and other.kind is channel.kind
    )
    if not comparisons:
        listed = [", ".join(channel.name for channel, _ in side) for side in chosen]
        raise InputError(f"{names[0]} and {names[1]} share no channel: {listed[0]}; {listed[1]}")
    return comparisons


def _side(name: str, study: ModelStudy, channel: StudyChannel, effects: Sequence[str]) -> ComparedModel:
    try:
        return ComparedModel(name, channel, effects, study.comparison(channel, effects))
    except InputError as error:
        return ComparedModel(name, channel, effects, None, str(error))
