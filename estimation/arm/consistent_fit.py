"""Inertial parameters that fit best among those that bodies can have, drawn to given ones.

Minimises phi' A phi / 2 - b' phi + precision D(P(phi) | P0), D of `estimation.arm.pseudo_inertia`: the
log-determinant in D keeps every link a body, its convexity makes the minimum the only one, and its
curvature is a prior that holds what the data do not determine. T. Lee, P. Wensing, F. Park, Geometric Robot
Dynamic Identification: A Convex Programming Approach, IEEE T-RO 36(2) (2020). Newton's method along the
central path: S. Boyd, L. Vandenberghe, Convex Optimization (2004), ch. 11, so that no solver for
semidefinite programs is needed.
"""

import numpy as np
import scipy

from estimation.arm.pseudo_inertia import Divergence
from estimation.information import Information
from robot_io.types import FloatArray

_FALL = 0.05  # of the precision from one point of the path to the next
_STEPS = 50  # Newton's, for one point
_CLOSE = 0.1  # Newton decrement squared, in units of the precision, that does on the way
_CLOSEST = 1e-12  # and at the end


def fit_bodies(information: Information, divergence: Divergence, precision: float) -> FloatArray:
    """The minimum.

    Args:
        information: A (10 links, 10 links) and b (10 links,): what the data say, see `Information`.
        divergence: from the bodies that the parameters are drawn to.
        precision: weight of D, see `estimation.arm.prior`.

    Returns:
        Shape (10 links,); every link a body.
    """
    problem = _Problem(information, divergence)
    inertial = divergence.origin
    pull = np.sqrt(problem.newton(inertial, precision)[1] / precision) * precision
    while pull > precision:
        inertial = problem.descend(inertial, pull, _CLOSE)
        pull *= _FALL
    return problem.descend(inertial, precision, _CLOSEST)


class _Problem:
    """Newton's method on the cost for one precision."""

    def __init__(self, information: Information, divergence: Divergence) -> None:
        self._information, self._divergence = information, divergence
        self._root = _root(information.matrix)

    def descend(self, inertial: FloatArray, precision: float, close: float) -> FloatArray:
        """From bodies to the bodies of least cost."""
        here = self._cost(inertial, precision)
        for _ in range(_STEPS):
            step, decrement = self.newton(inertial, precision)
            if decrement <= close * precision:
                break
            share = 1.0
            while (there := self._cost(inertial - share * step, precision)) > here - 0.1 * share * decrement:
                share *= 0.5
                if share < 1e-10:  # rounding errors: it goes no lower
                    return inertial
            inertial, here = inertial - share * step, there
        return inertial

    def newton(self, inertial: FloatArray, precision: float) -> tuple[FloatArray, float]:
        """Newton's step (10 links,), to be taken off, and its decrement squared.

        The curvature is factored by QR of its root: its eigenvalues can lie further apart than a double's
        digits.
        """
        slope = self._information.matrix @ inertial - self._information.vector
        slope = slope + precision * self._divergence.gradient(inertial)
        root = np.concatenate([self._root, np.sqrt(precision) * self._divergence.curvature_root(inertial)])
        scale = 1.0 / np.linalg.norm(root, axis=0)
        factor = np.linalg.qr(root * scale, mode="r")
        half = scipy.linalg.solve_triangular(factor, scale * slope, trans="T", check_finite=False)
        return scale * scipy.linalg.solve_triangular(factor, half, check_finite=False), float(half @ half)

    def _cost(self, inertial: FloatArray, precision: float) -> float:
        quadratic = inertial @ (0.5 * self._information.matrix @ inertial - self._information.vector)
        return float(quadratic + precision * self._divergence.value(inertial))


def _root(matrix: FloatArray) -> FloatArray:
    """R with R' R = matrix, whatever the units."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    values, axes = np.linalg.eigh(matrix * np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T * size)
