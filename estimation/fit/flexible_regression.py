"""Flexible regression: ridge regression on all signals and their past, as a nonparametric alternative.

It estimates how much of a model's error any function of the signals can explain, and which signals matter.
The smoothing bias of derived motion counts as noise, see `smoothing_bias`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from palpate.estimation.channel import ChannelKind
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import FitProblem, Solution
from palpate.estimation.fit.normal_equations import NormalEquations, held_out_gains, held_out_sse
from palpate.estimation.fit.smoothing_bias import DifferentiationFilter, fit_smoothing_bias
from palpate.estimation.signals.blocks import since_start
from palpate.estimation.signals.contact_memory import pressed_samples, remaining_strain
from palpate.estimation.signals.exponential_memory import low_pass, relax
from palpate.estimation.signals.runwise import derivative, play, running_max, sample_time, shift
from palpate.robot_io.types import FloatArray, IntArray

_RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1)
_MAX_SIGNALS = 4  # signals that are selected one by one
_MIN_GAIN = 0.005  # least share of the energy that an additional signal must explain


@dataclass(frozen=True)
class FlexibleRegression:
    """A flexible regression on the residual of a model."""

    # Squared whitened held-out residuals of the model by fold, corrected for smoothing bias, shape (folds,).
    before: FloatArray
    held_out: FloatArray  # the same with the flexible regression
    residual: FloatArray  # held-out residuals with the regression on blocks, not whitened, shape (m,)
    residual_before: FloatArray  # the same without the regression
    # Share of the squared error that each signal alone can explain in held-out runs.
    by_signal: dict[str, float]

    @property
    def explained(self) -> float:
        """Decrease of the squared whitened held-out residuals by the flexible regression."""
        return float(np.sum(self.before - self.held_out))

    def share_of(self, solution: Solution, least: float = 0.0) -> float:
        """Return the share of a model's error, or of `least` if larger, that the regression explains.

        Args:
            solution: the model.
            least: lower limit of the squared error to which the share refers.
        """
        error = max(solution.held_out, least)
        unexplained = max(1.0 - self.explained / error, 0.0) if error > 0.0 else 1.0
        return float(1.0 - np.sqrt(unexplained))


def _model_features(problem: FitProblem, solution: Solution) -> dict[str, FloatArray]:
    """Return features (m, k) by signal, for the motion and effort of a fitted model."""
    # Saturated or delayed readings lose information that the regression needs.
    blocked, model = problem.blocked, solution.model
    efforts = [blocked.effort - solution.residual]
    sensors = [sensor for sensor in model.sensors if not sensor.pointwise]
    if sensors:
        unsensed = model.without(*(sensor.name for sensor in sensors))
        efforts.append(blocked.reduce(unsensed.predict(blocked.data, solution.parameters)))
    return _smooth_features(blocked, efforts)


def fit_flexible(
    problem: FitProblem, solution: Solution, filters: DifferentiationFilter
) -> FlexibleRegression:
    """Fit the flexible regression jointly with the model's gains, with cross-validation.

    Args:
        problem: data on blocks, whose noise is assumed to be white.
        solution: the fitted model.
        filters: windows that derived velocity and acceleration.
    """
    blocked, all_names = problem.blocked, list(solution.model.gains)
    names = [name for name in all_names if name not in solution.fixed]
    free = np.array([name in names for name in all_names], dtype=np.bool_)
    fixed = np.array([solution.parameters[name] for name in all_names]) * ~free
    target = solution.target - solution.columns @ fixed
    blocks = _model_features(problem, solution)
    bias, _ = fit_smoothing_bias(problem, solution, filters)
    parts, signals = [solution.columns[:, free], bias, *blocks.values()], list(blocks)
    owner = np.repeat(np.arange(len(parts)) - 2, [part.shape[1] for part in parts])
    equations = problem.normal_equations(parts, target, names)
    without_signals = _fit_ridge(equations, owner, ())
    alone = [_fit_ridge(equations, owner, (number,)) for number in range(len(signals))]
    best = _select_signals(equations, owner, alone, without_signals)
    by_signal = {
        name: 1.0 - fit.energy / without_signals.energy if without_signals.energy > 0.0 else 0.0
        for name, fit in zip(signals, alone, strict=True)
    }
    residuals = []
    for fit in (best, without_signals):
        gains = np.zeros((len(owner), blocked.folds))
        gains[fit.kept] = held_out_gains(equations, fit.ridge, fit.kept).T
        predicted = np.zeros((len(target), blocked.folds))  # by gains fitted without each fold
        for number, part in enumerate(parts, start=-2):  # -2: the model, -1: the smoothing bias
            if number < 0 or number in fit.signals:
                predicted += part @ gains[owner == number]
        residuals.append(target - np.take_along_axis(predicted, blocked.fold[:, None], axis=1)[:, 0])
    after, before = residuals
    return FlexibleRegression(without_signals.held_out, best.held_out, after, before, by_signal)


@dataclass(frozen=True)
class _RidgeFit:
    """Ridge regression on some of the signals."""

    signals: tuple[int, ...]  # numbers of the signals
    kept: IntArray  # indices of the columns in use
    ridge: FloatArray  # ridge penalty of these columns
    held_out: FloatArray  # squared whitened residuals by fold, shape (folds,)

    @property
    def energy(self) -> float:
        return float(self.held_out.sum())


def _fit_ridge(equations: NormalEquations, owner: IntArray, signals: tuple[int, ...]) -> _RidgeFit:
    """Fit the given signals with the ridge penalty that predicts held-out folds best."""
    kept = np.flatnonzero((owner < 0) | np.isin(owner, signals))
    ridges = np.where(owner[kept] >= 0, np.array(_RIDGES)[:, None], 1e-9)
    sse = held_out_sse(equations, ridges, kept)
    best = int(np.argmin(sse.sum(axis=1)))
    return _RidgeFit(signals, kept, ridges[best], sse[best])


def _select_signals(
    equations: NormalEquations, owner: IntArray, alone: list[_RidgeFit], none: _RidgeFit
) -> _RidgeFit:
    """Select all signals, or those of a forward selection, by the held-out error."""
    best = none
    while len(best.signals) < _MAX_SIGNALS:
        extended = [
            _fit_ridge(equations, owner, (*best.signals, n)) if best.signals else alone[n]
            for n in range(len(alone))
            if n not in best.signals
        ]
        best_extended = min(extended, key=lambda fit: fit.energy)
        if best_extended.energy > best.energy - _MIN_GAIN * none.energy:
            break
        best = best_extended
    all_signals = _fit_ridge(equations, owner, tuple(range(len(alone))))
    return min(best, all_signals, key=lambda fit: fit.energy)


_KNOTS = 9  # number of knots at quantiles of the samples
_EVEN_KNOTS = 13  # number of knots at even distances over the range
_WAVES = 24
_SHARPNESS = (0.004, 0.02)  # widths of the change of direction, relative to the rms speed
_MEMORIES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # time constants, relative to the time scale of the motion
_LAGS = (1.0, 3.0, 10.0, 30.0)  # time constants of the effort's memory, in blocks
_TURNS = (0.001, 0.003, 0.01, 0.04, 0.15)  # path lengths of reversal memory, relative to the range
_CONTEXT = frozenset({"joint_position", "joint_velocity", "load"})


def _smooth_features(blocked: BlockedData, efforts: Sequence[FloatArray]) -> dict[str, FloatArray]:
    """Return smooth features (m, k) by signal, for efforts (m,) after and before sensor effects."""
    data, run, effort = blocked.data, blocked.run, efforts[0]
    x, time_s = blocked.reduce(data.position), blocked.time_s
    v, a = (blocked.reduce(s * data.engaged) for s in (data.velocity, data.acceleration))
    sharp, turn = (np.tanh(v / (share * _rms(v))) for share in _SHARPNESS)
    coarse_x, coarse_e = hats(x, even=0), hats(effort, even=0)
    # A trend, and products of velocity, effort and direction (m,) with time and with dissipated work.
    work = np.cumsum(np.abs(effort * v))
    clocks = (time_s, since_start(time_s, run), work, since_start(work, run))
    clocks = tuple((clock - clock[0]) / (float(np.ptp(clock)) or 1.0) for clock in clocks)
    fading = [clock * signal for clock in clocks for signal in (v, effort, turn)]
    features = {
        "offset": np.ones((len(x), 1)),
        "time": np.column_stack([clocks[0], clocks[0] ** 2, clocks[1], *fading]),
        "position": blocked.cache.get_or_compute("position", lambda: _position(blocked)),
        "velocity": np.column_stack([curves(v), *(w[:, None] * coarse_x for w in (v, v**2))]),
        "direction": np.column_stack([sharp, turn, turn[:, None] * coarse_x, turn[:, None] * coarse_e]),
        "acceleration": np.column_stack([hats(a), a[:, None] * coarse_x]),
        "past motion": blocked.cache.get_or_compute("past motion", lambda: _past(blocked)),
        "effort": np.hstack([part for e in efforts for part in (curves(e), _past_effort(e, time_s, run))]),
    }
    for name in sorted(_CONTEXT & data.context.keys()):
        columns = blocked.reduce(data.context[name]).reshape(len(x), -1)
        smooth = np.hstack([hats(column) for column in columns.T])
        # The only joint of an arm is the channel's own.
        own = name.removeprefix("joint_") if columns.shape[1] == 1 else ""
        features |= (
            {own: np.hstack([features[own], smooth])} if own in features else {name.replace("_", " "): smooth}
        )
    for name in sorted(data.recorded):
        # Effort that a recorded signal may add, and factors by which it may scale other signals.
        signal = blocked.reduce(data.context[name])
        unit = (signal - signal.mean()) / (float(np.std(signal)) or 1.0)
        features[f"recorded {name}" if name in features else name] = np.column_stack(
            [hats(unit), *(unit * factor for factor in (x, v, effort))]
        )
    if "load" in features:
        load = np.abs(blocked.reduce(data.context["load"]))
        features["load"] = np.column_stack([features["load"], sharp * load])
    return features


def _position(blocked: BlockedData) -> FloatArray:
    """Return features of the position, of its running maximum, and waves over a joint's range."""
    x = blocked.reduce(blocked.data.position)
    touching = blocked.reduce(blocked.data.engaged.astype(np.float64))
    columns = [curves(x), touching[:, None], hats(running_max(x, blocked.run))]
    if blocked.data.kind is not ChannelKind.CONTACT:
        span = float(np.ptp(x)) or 1.0
        angle = 2.0 * np.pi * (x / span)[:, None] * np.arange(1, _WAVES + 1)
        columns += [np.sin(angle), np.cos(angle)]
    return np.hstack(columns)


def _past(blocked: BlockedData) -> FloatArray:
    """Return features of the past motion: memory that decays over time or until a reversal."""
    data, run = blocked.data, blocked.run
    x, touching, time_s = *map(blocked.reduce, (data.position, data.engaged.astype(float))), blocked.time_s
    pressed, a = (blocked.reduce(s * data.engaged) for s in (data.position, data.acceleration))
    times = data.time_scale * np.array(_MEMORIES)
    if blocked.data.kind is ChannelKind.CONTACT:
        held = blocked.reduce(pressed_samples(data).astype(np.float64)) > 0.5
        fading = [
            remaining_strain(partial(relax, tau_s=tau), pressed, time_s, run, data, held) for tau in times
        ]
    else:
        fading = [pressed - low_pass(pressed, time_s, run, tau) for tau in times]
    turns = [reversal_memory(pressed, run, share) for share in _TURNS]
    squared = [f * np.abs(f) for f in fading]
    bent_back = [np.abs(turn) * signal for turn in turns for signal in (pressed, a)]
    past = np.column_stack([*fading, *squared, *turns, *bent_back])
    past *= touching[:, None]
    if blocked.data.kind is not ChannelKind.CONTACT:
        return past
    # Effort that persists outside the object after contact.
    touched = running_max((x > 0.0).astype(np.float64), run) * (x <= 0.0)
    reaches = np.max(x, initial=1e-9) * np.array([0.02, 0.06, 0.2])
    return np.hstack([past, touched[:, None] * np.exp(np.minimum(x, 0.0)[:, None] / reaches)])


def _past_effort(effort: FloatArray, time_s: FloatArray, run: IntArray) -> FloatArray:
    """Return features of the past effort, as of a sensor with delay, lag or hysteresis."""
    slope, step = derivative(effort, time_s, run), sample_time(time_s, run)
    late = [effort - low_pass(effort, time_s, run, lag * step) for lag in _LAGS]
    late += [effort - shift(effort, time_s, run, lag * step) for lag in _LAGS[:-1]]
    turns = [reversal_memory(effort, run, share) for share in _TURNS]
    return np.column_stack([slope, *late, np.tanh(slope / (0.1 * _rms(slope))), *turns])


def reversal_memory(signal: FloatArray, run: IntArray, share: float) -> FloatArray:
    """Return a signal (n,) minus its play operator, which follows the direction of motion after a path.

    Args:
        signal: signal, shape (n,).
        run: run number of each sample, shape (n,).
        share: half width of the play, relative to the signal's range.
    """
    return signal - play(signal, run, share * float(np.ptp(signal)))


def curves(signal: FloatArray) -> FloatArray:
    """Return piecewise linear columns and powers, which extrapolate to runs with a wider range.

    Args:
        signal: signal, shape (n,).
    """
    unit = signal / _rms(signal)
    return np.column_stack([hats(signal), unit, unit * np.abs(unit), unit**3])


def hats(signal: FloatArray, even: int = _EVEN_KNOTS) -> FloatArray:
    """Return hat functions of a signal without the one nearest to zero, so that no constant is included.

    Knots are at quantiles, plus `even` knots at even distances over the range. Nearly coinciding knots are
    merged.

    Args:
        signal: signal, shape (n,).
        even: number of knots at even distances.
    """
    low, high = float(signal.min()), float(signal.max())
    quantiles = np.quantile(signal, np.linspace(0.0, 1.0, _KNOTS))
    knots = np.sort(np.concatenate([quantiles, np.linspace(low, high, even)]))
    knots = knots[np.append(True, np.diff(knots) > 0.02 * (high - low))] if even else np.unique(knots)
    if len(knots) < 3:
        return signal[:, None]
    place = np.interp(signal, knots, np.arange(len(knots)))
    hats = np.maximum(1.0 - np.abs(place[:, None] - np.arange(len(knots))), 0.0)
    return np.delete(hats, int(np.argmin(np.abs(knots))), axis=1)


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2))) or 1.0
