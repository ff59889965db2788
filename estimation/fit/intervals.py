"""Honest intervals: from the slopes by all parameters, with the correlation of what is left.

Errors of the motion's readings turn parameters and leave next to nothing in the residual (W. A. Fuller,
Measurement Error Models (1987)): they are added, from readings drawn again.
"""

from dataclasses import replace

import numpy as np

from estimation.channel import ChannelKind
from estimation.effect import Parameter
from estimation.estimate import ParameterEstimate
from estimation.fit.acceleration_doubt import doubted
from estimation.fit.flexible import Windows, is_of_size, taken_off
from estimation.fit.memory import Memory
from estimation.fit.polish import polish
from estimation.fit.readings import Readings, readings_of
from estimation.fit.standing import Standing
from estimation.fit.trial import Bench, Trial, attempt
from estimation.statistics.serial_covariance import sum_covariance
from robot_io.types import FloatArray, IntArray

SIGMAS_95 = 1.96
_READINGS, _SEED = 8, 1  # of the motion, drawn again
_NOISE_ALONE = 1.05  # times the floor: an error up to which it is noise
_BETTER = 0.9  # times the squared error in held-out runs, beside what smoothing took off
_STEP = 1e-3  # of an inner parameter in a difference quotient, relative to its value or typical range
_NOTHING = 1e-10  # of the largest eigenvalue: a way to change parameters together that changes nothing
_FREE = 1e-6  # share of a parameter in such ways, from which on the data do not determine it
_FAR = 10.0  # times a value, or what is met in practice
_JUMP, _MOST = 20.0, 0.95  # times the slope that most blocks stay below: a block that jumps, and has no slope


def values(bench: Bench, trial: Trial) -> dict[str, ParameterEstimate]:
    """Parameters of a trial with 95 % intervals, by "effect.parameter".

    The sandwich of slopes by gains and inner parameters, around the covariance of residuals times slopes with
    the noise's colour taken out first (Andrews and Monahan 1992). What another reading of the motion
    would turn the parameters by is added to their variance. One that is held has no error.
    """
    names = [name for name in (*trial.model.gains, *trial.model.inner) if name not in trial.model.held]
    slopes = bench.whiten(_free_slopes(bench, trial))
    residual = bench.whiten(trial.residual)
    errors = _errors(slopes, residual, bench.frame.run[bench.kept])
    readings = readings_of(bench.frame.data)
    errors = np.hypot(errors, _by_readings(bench, trial, readings))
    if readings.windows[1] is None:
        errors = np.hypot(errors, _turned(slopes, bench.whiten(_by_positions(bench, trial))))
    kind = bench.frame.data.kind
    known = {**trial.model.gains, **trial.model.inner}
    units = {
        name: parameter.unit.format(effort=kind.effort_unit, position=kind.position_unit)
        for name, parameter in known.items()
    }
    most = np.array([_widest(known[name], trial.parameters[name]) for name in names])
    errors = np.where(errors < most, errors, np.nan)
    found = dict.fromkeys(known, 0.0) | dict(zip(names, errors.tolist(), strict=True))
    estimates = {}
    for name, error in found.items():
        value, half = float(trial.parameters[name]), SIGMAS_95 * error
        at_bound = trial.model.at_bound(name, value)
        estimates[name] = ParameterEstimate(
            name, units[name], value, error, (value - half, value + half), at_bound
        )
    return estimates


def _widest(parameter: Parameter, value: float) -> float:
    """An error beyond all that makes physical sense, or far beyond all that is met, determines nothing."""
    return min(parameter.upper - parameter.lower, _FAR * max(abs(value), *parameter.typical))


def _free_slopes(bench: Bench, trial: Trial) -> FloatArray:
    """Slopes (m, q) of the prediction by all parameters that are not held."""
    slopes = np.column_stack([trial.columns, *inner_slopes(bench, trial)])
    names = (*trial.model.gains, *trial.model.inner)
    return slopes[:, [name not in trial.model.held for name in names]] if trial.model.held else slopes


def inner_slopes(bench: Bench, trial: Trial) -> list[FloatArray]:
    """Slope of the prediction by each inner parameter at fixed gains, each of shape (m,)."""
    found = trial.model.inner_slopes(bench.frame.data, trial.parameters, _STEP)
    return [_without_jumps(bench.frame.reduce(slope)) for slope in found]


def _without_jumps(slope: FloatArray) -> FloatArray:
    """Zero where a small step carried a sample over a border, such as into contact: a jump is no slope."""
    size = np.abs(slope)
    if not size.any():
        return slope
    return np.where(size > _JUMP * np.quantile(size[size > 0.0], _MOST), 0.0, slope)


def _by_positions(bench: Bench, trial: Trial) -> FloatArray:
    """Change of the prediction with the acceleration that positions speak for, shape (m,)."""
    frame = bench.frame
    other = trial.model.predict(doubted(frame.data), trial.parameters)
    return frame.reduce(other - trial.model.predict(frame.data, trial.parameters))


def _by_readings(bench: Bench, trial: Trial, readings: Readings) -> FloatArray:
    """By how much other readings of the motion would have turned each parameter, root mean square, (q,).

    The model is fitted by one step of Gauss and Newton to what it expects of the smooth motion, read again.
    """
    rng = np.random.default_rng(_SEED)
    expected = trial.model.predict(readings.true_motion, trial.parameters)
    turned = []
    for _ in range(_READINGS):
        frame = replace(
            bench.frame, data=replace(readings.draw(rng), effort=expected), memory=Memory(), of_load=Memory()
        )
        again = Bench(frame, bench.colour)
        read = replace(trial, columns=frame.reduce(trial.model.linearise(frame.data, trial.parameters)[0]))
        slopes = again.whiten(_free_slopes(again, read))
        left = again.whiten(frame.reduce(expected - trial.model.predict(frame.data, trial.parameters)))
        turned.append(_turned(slopes, left))
    return np.asarray(np.sqrt(np.mean(np.square(turned), axis=0)))


def _turned(slopes: FloatArray, change: FloatArray) -> FloatArray:
    """How far parameters make up for a change (w,) of the prediction, shape (q,)."""
    width = np.sqrt(np.sum(slopes**2, axis=0))
    width = np.where(width > 0.0, width, np.inf)
    turned: FloatArray = np.linalg.lstsq(slopes / width, change, rcond=1e-5)[0] / width
    return np.abs(turned)


def _errors(slopes: FloatArray, residual: FloatArray, run: IntArray) -> FloatArray:
    """Standard errors (q,); NaN for parameters that make up for each other, or change nothing."""
    width = np.sqrt(np.sum(slopes**2, axis=0))
    scaled = slopes / np.where(width > 0.0, width, 1.0)
    size, ways = np.linalg.eigh(scaled.T @ scaled)
    known = size > _NOTHING * size.max(initial=0.0)
    bread = (ways[:, known] / size[known]) @ ways[:, known].T
    meat = sum_covariance(scaled * residual[:, None], run).matrix
    count = len(residual)
    covariance = bread @ meat @ bread * (count / max(count - slopes.shape[1], 1))
    free = np.sum(ways[:, ~known] ** 2, axis=1) > _FREE
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / np.where(width > 0.0, width, 1.0)
    return np.where(free, np.nan, errors)


def final(standing: Standing) -> tuple[Bench, Trial]:
    """The last word on a model's parameters, and where it was said.

    With the noise's colour taken out they are most exact; but only once nothing is missing, since what is
    missing would pass for coloured noise, and only near where the model stands: a colour that is badly known
    may leave another place as little.
    """
    if standing.data.shared is not None or standing.rmse > _NOISE_ALONE * standing.floor():
        return standing.plain, standing.trial
    judge = standing.judge
    trial = polish(judge, attempt(judge, standing.trial.model, standing.trial.parameters))
    kept = standing.plain.kept
    here, there = (float(np.sum(one.residual[kept] ** 2)) for one in (standing.trial, trial))
    if there > _NOISE_ALONE**2 * here:
        return standing.plain, standing.trial
    return judge, _beside_smoothing(judge, trial, standing.windows)


def _beside_smoothing(bench: Bench, trial: Trial, windows: Windows) -> Trial:
    """A joint's model with the gains that it has beside what windows took off its motion.

    A mass makes up for peaks that were rounded off its acceleration, and a weight for the mass.
    """
    if bench.frame.data.kind is ChannelKind.CONTACT or windows == ((), ()):
        return trial
    taken = taken_off(bench.frame, bench.frame.effort - trial.residual, windows)
    names = list(trial.model.gains)
    every = [*names, *(f"taken off {number}" for number in range(taken.shape[1]))]
    fitted = bench.fit(np.hstack([trial.columns, taken]), trial.target, every, trial.model.held)
    own = len(names)
    if fitted.held_out.sum() > _BETTER * trial.held_out or not is_of_size(taken, fitted.gains[own:]):
        return trial
    gains = dict(zip(names, fitted.gains.tolist(), strict=False))
    return replace(trial, parameters={**trial.parameters, **gains})
