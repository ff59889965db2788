"""Runs that do not follow one law: each predicted from the others, and fitted by itself."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import Solution, held_out_residual, rmse
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import FloatArray, IntArray

APART = 1.25  # times the error by itself: less is told by draws alone, and changes little
_ROWS = 30  # samples for each gain, with which a run can be fitted by itself


@dataclass(frozen=True)
class RunHeterogeneity:
    """Runs that do not follow one law."""

    run: int  # the one that the others predict worst, beside what it is by itself
    predicted: float  # root mean square error of all runs, each predicted from the others
    alone: float  # the same, each fitted by itself
    own_residual: FloatArray  # what each run leaves by itself, shape (n,); 0 where none can be fitted
    run_predicted: float  # error of `run`, predicted from the others
    run_alone: float  # the same, fitted by itself


def run_heterogeneity(
    blocked: BlockedData, solution: Solution, least: float = APART
) -> RunHeterogeneity | None:
    """How the runs disagree about the gains and the zero of a model.

    Args:
        blocked: the channel on blocks.
        solution: the model fitted to all runs.
        least: ratio of the error that is predicted from the other runs to that of runs fitted by themselves.

    Returns:
        None where the ratio is no larger, or fewer than two runs are long enough to be fitted.
    """
    data = blocked.data
    predicted = held_out_residual(blocked, solution)
    slopes, effort = solution.model.linearise(data, solution.parameters)
    free = [name not in solution.model.held for name in solution.model.gains]
    slopes = np.column_stack([slopes[:, free], np.ones(len(data))])  # a run may have a zero of its own
    residual = data.effort - effort
    alone = np.full(len(data), np.nan)
    judged: list[IntArray] = []
    for of_run in rows_of_runs(data.run):
        rows = of_run[np.isfinite(predicted[of_run])]
        if len(rows) < _ROWS * slopes.shape[1]:
            predicted[rows] = np.nan  # too short to be fitted by itself
            continue
        scale = np.linalg.norm(slopes[rows], axis=0)
        columns = slopes[rows] / np.where(scale > 0.0, scale, 1.0)
        fitted = np.linalg.lstsq(columns, residual[rows], rcond=None)[0]
        freedom = len(rows) / (len(rows) - slopes.shape[1])
        alone[rows] = (residual[rows] - columns @ fitted) * np.sqrt(freedom)
        judged.append(rows)
    if len(judged) < 2 or not rmse(predicted) > least * rmse(alone):
        return None
    errors = [(rmse(predicted[rows]), rmse(alone[rows])) for rows in judged]
    worst = int(np.argmax([together**2 - single**2 for together, single in errors]))
    run = int(data.run[judged[worst][0]])
    return RunHeterogeneity(run, rmse(predicted), rmse(alone), np.nan_to_num(alone), *errors[worst])
