"""Whether the runs follow one law: each predicted from the others, beside each fitted by itself.

Nothing else in a diagnosis sees this. What would explain why one run differs (another specimen, another zero,
a sensor that died) is no signal of the data, so the other runs teach nothing about it.
"""

from dataclasses import dataclass

import numpy as np

from estimation.fit.held_out import held_out_residual, rmse
from estimation.fit.standing import Standing
from estimation.signals.blocks import rows_of_runs
from robot_io.types import IntArray

_TIMES = 1.5  # the error by itself; slow noise of a few runs stays well below that
_ROWS = 30  # samples for each gain, with which a run can be fitted by itself


@dataclass(frozen=True)
class Disagreement:
    """Runs that do not follow one law.

    Attributes:
        run: the one that the others predict worst, beside what it is by itself.
        predicted: root mean square error of all runs, each predicted from the others.
        alone: the same, each fitted by itself.
        run_predicted: error of `run`, predicted from the others.
        run_alone: the same, fitted by itself.
    """

    run: int
    predicted: float
    alone: float
    run_predicted: float
    run_alone: float


def disagreement(standing: Standing) -> Disagreement | None:
    """How the runs disagree about the gains and the zero of a model, or None if they do not."""
    frame, trial = standing.plain.frame, standing.trial
    data = frame.data
    predicted = held_out_residual(frame, trial)
    slopes, effort = trial.model.linearise(data, trial.parameters)
    slopes = np.column_stack([slopes, np.ones(len(data))])  # a run may have a zero of its own
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
        fitted = np.linalg.lstsq(columns, residual[rows], rcond=1e-9)[0]
        freedom = len(rows) / (len(rows) - slopes.shape[1])
        alone[rows] = (residual[rows] - columns @ fitted) * np.sqrt(freedom)
        judged.append(rows)
    if len(judged) < 2 or not rmse(predicted) > _TIMES * rmse(alone):
        return None
    errors = [(rmse(predicted[rows]), rmse(alone[rows])) for rows in judged]
    worst = int(np.argmax([together**2 - single**2 for together, single in errors]))
    run = int(data.run[judged[worst][0]])
    return Disagreement(run, rmse(predicted), rmse(alone), *errors[worst])
