"""Errors on runs that a fit has not seen, sample by sample."""

import numpy as np

from estimation.fit.frame import Frame
from estimation.fit.trial import Trial
from robot_io.types import FloatArray


def held_out_residual(frame: Frame, trial: Trial) -> FloatArray:
    """Effort less what the gains fitted to the other folds predict, shape (n,); NaN outside blocks."""
    slopes, effort = trial.model.linearise(frame.data, trial.parameters)
    gains = np.array([trial.parameters[name] for name in trial.model.gains])
    residual = np.full(len(frame.data), np.nan)
    for fold, fitted in enumerate(trial.scores.fold_gains):
        rows = frame.rows[(frame.fold == fold) & frame.trusted].ravel()
        residual[rows] = frame.data.effort[rows] - effort[rows] - slopes[rows] @ (fitted - gains)
    return residual


def rmse(residual: FloatArray) -> float:
    """Root mean square over the samples that have a value."""
    return float(np.sqrt(np.nanmean(residual**2)))
