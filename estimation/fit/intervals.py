"""Parameter intervals from a sandwich covariance with derivatives by all parameters and correlated residuals.

Errors of the measured motion change the parameters but leave hardly any residual (W. A. Fuller, Measurement
Error Models (1987)). Their contribution is estimated by simulated measurements.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from palpate.estimation.effect import Parameter
from palpate.estimation.estimate import Determined, ParameterEstimate
from palpate.estimation.fit.fit_problem import FitProblem, Solution
from palpate.estimation.fit.measurement_model import (
    MeasurementModel,
    identify_measurement_model,
    inflate_acceleration_noise,
)
from palpate.estimation.model import own_parameters
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.estimation.statistics.noise import sum_covariance
from palpate.robot_io.types import FloatArray, IntArray

SIGMAS_95 = 1.96
_READINGS, _SEED = 8, 1  # simulated readings of the motion, and their seed
_STEP = 1e-3  # step of finite differences, relative to an inner parameter's value or typical range
# Eigenvalues below this share of the largest belong to combinations of parameters without effect.
_NULL_EIGENVALUE = 1e-10
_NULL_SHARE = 1e-6  # share of a parameter in such combinations above which the data do not determine it
_WIDEST_RATIO = 10.0  # largest uncertainty, relative to the value or the typical values of a parameter
_HARDLY_ANY = 1e-4  # share of the noise with which hardly any variance is due to noise
# The slope of a block is a jump if it exceeds 20 times the 95 % quantile over blocks.
_JUMP_RATIO, _JUMP_QUANTILE = 20.0, 0.95


def estimate_parameters(problem: FitProblem, solution: Solution) -> dict[str, ParameterEstimate]:
    """Estimate the parameters of a solution with 95 % intervals, by "effect.parameter".

    The covariance is a sandwich estimate with derivatives by gains and inner parameters and a prewhitened
    long-run covariance of the score (Andrews and Monahan 1992). The effect of reading errors of the motion is
    added to the variance. With differences between runs, the errors are those of the mean over all possible
    runs. Held parameters have no error.

    Args:
        problem: data, noise weights and folds of the fit.
        solution: the fitted model.
    """
    names = [name for name in (*solution.model.gains, *solution.model.inner) if name not in solution.fixed]
    slopes = problem.whiten(_free_slopes(problem, solution))
    residual = problem.whiten(solution.residual)
    errors = _errors(slopes, residual, problem.blocked.run[problem.used])
    measurement = identify_measurement_model(problem.blocked.data)
    errors = np.hypot(errors, _reading_errors(problem, solution, measurement))
    errors = _errors_of_mean_run(errors, problem, solution, names, slopes, residual)
    if measurement.filters[1] is None:
        # Change of the prediction with the acceleration corrected by the positions, shape (m,).
        blocked = problem.blocked
        inflated = solution.model.predict(inflate_acceleration_noise(blocked.data), solution.parameters)
        correction = blocked.reduce(inflated - solution.model.predict(blocked.data, solution.parameters))
        errors = np.hypot(errors, _compensation(slopes, problem.whiten(correction)))
    known = {**solution.model.gains, **solution.model.inner}
    units = {name: parameter.unit_of(problem.blocked.data) for name, parameter in known.items()}
    largest = np.array([_largest_error(known[name], solution.parameters[name]) for name in names])
    errors = np.where(errors < largest, errors, np.nan)
    errors_by_name = dict.fromkeys(known, 0.0) | dict(zip(names, errors.tolist(), strict=True))
    estimates = {}
    for name, error in errors_by_name.items():
        value, half = float(solution.parameters[name]), SIGMAS_95 * error
        at_bound = solution.model.at_bound(name, value) or name in solution.fixed - solution.model.held.keys()
        interval = (value - half, value + half)
        is_known = error == 0.0 or interval[0] > 0.0 or interval[1] < 0.0  # the error is NaN if unknown
        determined = Determined.YES if is_known and not at_bound else Determined.NO
        estimates[name] = ParameterEstimate(name, units[name], value, error, interval, at_bound, determined)
    return estimates


def _largest_error(parameter: Parameter, value: float) -> float:
    """Return the largest plausible standard error; a larger one means that the data do not determine it."""
    return min(parameter.upper - parameter.lower, _WIDEST_RATIO * max(abs(value), *parameter.typical))


def _free_slopes(problem: FitProblem, solution: Solution) -> FloatArray:
    """Return the derivatives (m, q) of the prediction by all parameters that are not fixed."""
    slopes = np.column_stack([solution.columns, *inner_slopes(problem, solution)])
    names = (*solution.model.gains, *solution.model.inner)
    return slopes[:, [name not in solution.fixed for name in names]] if solution.fixed else slopes


def inner_slopes(problem: FitProblem, solution: Solution) -> list[FloatArray]:
    """Return the derivative of the prediction by each inner parameter at fixed gains, each of shape (m,).

    Args:
        problem: data, noise weights and folds of the fit.
        solution: the fitted model.
    """
    blocked, model = problem.blocked, solution.model
    slopes = model.inner_slopes(blocked.data, solution.parameters, _STEP, blocked.at_full_rate)
    return [_without_jumps(blocked.reduce(slope)) for slope in slopes]


def _without_jumps(slope: FloatArray) -> FloatArray:
    """Set the slope (m,) to zero where the step moved a sample across a boundary, such as into contact."""
    size = np.abs(slope)
    if not size.any():
        return slope
    return np.where(size > _JUMP_RATIO * np.quantile(size[size > 0.0], _JUMP_QUANTILE), 0.0, slope)


def _reading_errors(problem: FitProblem, solution: Solution, measurement: MeasurementModel) -> FloatArray:
    """Simulate the standard errors (q,) due to reading errors of the motion, by Gauss-Newton steps."""
    rng = np.random.default_rng(_SEED)
    expected = solution.model.predict(measurement.smoothed_motion, solution.parameters)
    compensations = []
    for _ in range(_READINGS):
        blocked = replace(
            problem.blocked,
            data=replace(measurement.simulate(rng), effort=expected),
            cache=FitCache(),
        )
        simulated = FitProblem(blocked, problem.noise_model)
        columns, effort = solution.model.linearize(blocked.data, solution.parameters)
        refitted = replace(solution, columns=blocked.reduce(columns))
        slopes = simulated.whiten(_free_slopes(simulated, refitted))
        residual = simulated.whiten(blocked.reduce(expected - effort))
        compensations.append(_compensation(slopes, residual))
    return np.asarray(np.sqrt(np.mean(np.square(compensations), axis=0)))


def _errors_of_mean_run(  # noqa: PLR0917
    errors: FloatArray,
    problem: FitProblem,
    solution: Solution,
    names: Sequence[str],
    slopes: FloatArray,
    residual: FloatArray,
) -> FloatArray:
    """Enlarge standard errors (q,) to those of the mean over all possible runs, if there are random effects.

    Only a few runs were recorded. With the derivatives X_r and the changes B_r of the prediction by one
    standard deviation of each random value in run r, the covariance of the parameters is

        (sum of X_r' V_r^-1 X_r)^-1,  V_r = sigma^2 I + B_r B_r'

    (N. M. Laird, J. H. Ware, Biometrics 38 (1982)). The part of the variance that remains without noise is
    due to the number of runs; it is enlarged so that 1.96 standard errors give Student's interval.

    Args:
        errors: standard errors for the recorded runs, shape (q,).
        problem: data, noise weights and folds of the fit.
        solution: the fitted model.
        names: the q free parameters.
        slopes: derivatives of the prediction by them, whitened, shape (w, q).
        residual: whitened residual, shape (w,).
    """
    model, known, data = solution.model, solution.parameters, problem.blocked.data
    deviations, own = list[FloatArray](), set[str]()
    for effect in model.sensors:
        effort = model.without(effect.name).predict(data, known)
        inner = own_parameters(effect, known)
        deviations.append(effect.run_deviations(effort, data, inner))
        own |= {f"{effect.name}.{name}" for name in inner} if deviations[-1].any() else set()
    if not own:
        return errors
    others = [index for index, name in enumerate(names) if name not in own]
    lengths = np.maximum(np.linalg.norm(slopes[:, others], axis=0), 1e-300)
    scaled = slopes[:, others] / lengths
    by_run = problem.whiten(problem.blocked.reduce(np.hstack(deviations)))
    starts = block_index(problem.blocked.run[problem.used])[0]

    def variances(noise: float) -> FloatArray:
        information = scaled.T @ scaled
        for rows in np.split(np.arange(len(residual)), starts[1:]):
            deviation = by_run[rows]
            shared = deviation.T @ scaled[rows]
            inner_product = deviation.T @ deviation + noise * np.eye(deviation.shape[1])
            information -= shared.T @ np.linalg.solve(inner_product, shared)
        covariance = noise * np.linalg.pinv(information, rcond=_NULL_EIGENVALUE, hermitian=True)
        return np.asarray(np.maximum(np.diag(covariance), 0.0) / lengths**2)

    noise = float(residual @ residual) / max(len(residual) - len(names), 1)
    few_runs = scipy.special.stdtrit(max(len(starts) - 1, 1), 0.975) / SIGMAS_95
    combined = errors.copy()
    enlarged = (few_runs**2 - 1.0) * variances(_HARDLY_ANY * noise)
    combined[others] = np.sqrt(np.maximum(errors[others] ** 2, variances(noise)) + enlarged)
    return combined


def _compensation(slopes: FloatArray, change: FloatArray) -> FloatArray:
    """Return the absolute change of the parameters (q,) that compensates a change (w,) of the prediction."""
    lengths = np.sqrt(np.sum(slopes**2, axis=0))
    lengths = np.where(lengths > 0.0, lengths, np.inf)
    change_of_parameters: FloatArray = np.linalg.lstsq(slopes / lengths, change, rcond=1e-5)[0] / lengths
    return np.abs(change_of_parameters)


def _errors(slopes: FloatArray, residual: FloatArray, run: IntArray) -> FloatArray:
    """Compute sandwich standard errors (q,); NaN for parameters that the data do not determine."""
    lengths = np.sqrt(np.sum(slopes**2, axis=0))
    scaled = slopes / np.where(lengths > 0.0, lengths, 1.0)
    eigenvalues, directions = np.linalg.eigh(scaled.T @ scaled)
    known = eigenvalues > _NULL_EIGENVALUE * eigenvalues.max(initial=0.0)
    bread = (directions[:, known] / eigenvalues[known]) @ directions[:, known].T
    meat = sum_covariance(scaled * residual[:, None], run).matrix
    count = len(residual)
    covariance = bread @ meat @ bread * (count / max(count - slopes.shape[1], 1))
    undetermined = np.sum(directions[:, ~known] ** 2, axis=1) > _NULL_SHARE
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / np.where(lengths > 0.0, lengths, 1.0)
    return np.where(undetermined, np.nan, errors)
