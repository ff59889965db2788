"""Heterogeneity between runs: compare predictions of each run from the others with separate fits."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import Solution, held_out_residual, rmse
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import FloatArray, IntArray

MIN_RATIO = 1.25  # least ratio of a run's predicted error to its own error; smaller ratios are not tested
_SAMPLES_PER_GAIN = 30  # samples per gain needed to fit a run alone


@dataclass(frozen=True)
class RunHeterogeneity:
    """Runs that do not follow one law."""

    run: int  # the run with the largest ratio of the predicted error to the error when fitted alone
    predicted: float  # root mean square error of all runs, each predicted from the others
    alone: float  # the same with each run fitted alone
    own_residual: FloatArray  # residual of each run fitted alone, shape (n,); 0 if a run is too short
    run_predicted: float  # error of `run`, predicted from the others
    run_alone: float  # the same, fitted alone


def run_heterogeneity(
    blocked: BlockedData, solution: Solution, least: float = MIN_RATIO
) -> RunHeterogeneity | None:
    """Measure how much the runs disagree about the gains and the zero of a model.

    Args:
        blocked: the channel on blocks.
        solution: the model fitted to all runs.
        least: least ratio of the error predicted from other runs to the error of runs fitted alone.

    Returns:
        The errors; None if the ratio is smaller, or fewer than two runs are long enough to be fitted.
    """
    data = blocked.data
    predicted = held_out_residual(blocked, solution)
    slopes, effort = solution.model.linearize(data, solution.parameters)
    free = [name not in solution.model.held for name in solution.model.gains]
    slopes = np.column_stack([slopes[:, free], np.ones(len(data))])  # each run may have its own zero
    residual = data.effort - effort
    alone = np.full(len(data), np.nan)
    tested_rows: list[IntArray] = []
    for run_rows in rows_of_runs(data.run):
        rows = run_rows[np.isfinite(predicted[run_rows])]
        if len(rows) < _SAMPLES_PER_GAIN * slopes.shape[1]:
            predicted[rows] = np.nan  # too short to be fitted alone
            continue
        scale = np.linalg.norm(slopes[rows], axis=0)
        columns = slopes[rows] / np.where(scale > 0.0, scale, 1.0)
        fitted = np.linalg.lstsq(columns, residual[rows], rcond=None)[0]
        inflation = len(rows) / (len(rows) - slopes.shape[1])
        alone[rows] = (residual[rows] - columns @ fitted) * np.sqrt(inflation)
        tested_rows.append(rows)
    if len(tested_rows) < 2 or not rmse(predicted) > least * rmse(alone):
        return None
    errors = [(rmse(predicted[rows]), rmse(alone[rows])) for rows in tested_rows]
    worst = int(np.argmax([together**2 - single**2 for together, single in errors]))
    run = int(data.run[tested_rows[worst][0]])
    return RunHeterogeneity(run, rmse(predicted), rmse(alone), np.nan_to_num(alone), *errors[worst])
