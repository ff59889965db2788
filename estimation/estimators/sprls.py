"""Recursive least squares that perturbs itself."""

import numpy as np

from estimation.estimators.recursive import INITIAL_VARIANCE, RecursiveEstimator
from robot_io.errors import InputError
from robot_io.types import FloatArray


class Sprls(RecursiveEstimator):
    """Self-perturbing: the covariance grows by beta * nint(gamma * error^2) * I after each sample.

    nint is the nearest integer, so that the term is nought for small errors and acts when the error is LARGE
    (gamma * error^2 >= 1/2): it wakes the filter up after a change. The paper says that it acts when the
    error gets too small, which does not fit the formula that it cites; the formula is followed here. With
    beta = 0 it is RLS.

    Source: D. J. Park, B. E. Jun, Self-Perturbing Recursive Least Squares Algorithm with Fast Tracking
    Capability, Electronics Letters 28 (1992); beta and gamma of the paper, sec. VI-C.

    Args:
        beta: design constant, at least 0; 20 in the paper.
        gamma: sensitivity gain, at least 0, per squared effort; 1 in the paper.
        variance: of each gain at the start.
    """

    name = "sprls"

    def __init__(self, beta: float = 20.0, gamma: float = 1.0, variance: float = INITIAL_VARIANCE) -> None:
        if beta < 0 or gamma < 0:
            raise InputError(f"sprls: beta {beta} and gamma {gamma} must not be negative")
        super().__init__(variance)
        self.beta = beta
        self.gamma = gamma

    def _next_covariance(self, reduced: FloatArray, error: float) -> FloatArray:
        perturbation = self.beta * round(self.gamma * error * error)
        return reduced + perturbation * np.eye(len(reduced)) if perturbation else reduced
