"""Physically consistent fit of a whole arm by its normal equations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from palpate.estimation.arm.inertial_parameters import BaseParameters, Divergence, nearest_bodies
from palpate.estimation.channel import Information
from palpate.robot_io.types import FloatArray


@dataclass(frozen=True)
class JointMoments:
    """Cross products of one joint's columns and torque, fold by fold."""

    # Shape (folds, s + k + 1, s + k + 1): first the s shared columns, in the same order for all joints (zero
    # where the joint does not feel them), then the joint's own k, last the torque.
    products: FloatArray
    shared: int  # s
    sigma: float  # standard deviation of the joint's noise in a sample [N m]


def arranged(products: FloatArray, names: Sequence[str], shared: Sequence[str], sigma: float) -> JointMoments:
    """Moments of one joint from cross products in another order.

    Args:
        products: shape (folds, q + 1, q + 1), the last of the torque.
        names: names of the q columns.
        shared: names of the shared columns in their common order; those that are not among `names`, the
            joint does not feel. All other columns are the joint's own, in the order of `names`.
        sigma: standard deviation of the joint's noise.
    """
    private = [name for name in names if name not in set(shared)]
    place = {name: index for index, name in enumerate([*shared, *private])}
    places = np.array([*(place[name] for name in names), len(place)])
    ordered = np.zeros((len(products), len(place) + 1, len(place) + 1))
    ordered[:, places[:, None], places] = products
    return JointMoments(ordered, len(shared), sigma)


def training_sums(products: FloatArray) -> FloatArray:
    """Sum products over all folds, and over all but each.

    Args:
        products: by fold, shape (folds, q, q).

    Returns:
        Shape (1 + folds, q, q).
    """
    total = products.sum(axis=0, keepdims=True)
    return np.concatenate([total, total - products])


def shared_information(joint: JointMoments) -> Information:
    """Information of one joint on the shared parameters, its own gains profiled out.

    Args:
        joint: normal equations of one joint.

    Returns:
        Matrix (1 + folds, s, s): from all folds, then from all but each.
    """
    total = training_sums(joint.products) / joint.sigma**2
    return Information(total[:, :-1, :-1], total[:, :-1, -1]).about(np.arange(joint.shared))


def information_of_others(joints: Sequence[JointMoments], prior: Information) -> tuple[Information, ...]:
    """Return for each joint the information of all others and the prior on the shared parameters.

    Args:
        joints: their moments, with the same folds.
        prior: prior of the shared parameters, matrix (s, s) or (1 + folds, s, s), such as that of
            `palpate.estimation.arm.consistent_fit`.

    Returns:
        One a joint, matrix (1 + folds, s, s) and vector (1 + folds, s): [0] from all folds, [1 + f] from
        all but fold f. To be added to the joint's own sums over the same folds, divided by its sigma^2; or
        `times` its sigma^2 to sums that are not. The fit of the one joint is then the fit of all of them.
    """
    by_joint = [shared_information(joint) for joint in joints]
    return tuple(sum([*by_joint[:j], *by_joint[j + 1 :]], start=prior) for j in range(len(by_joint)))


URDF_SPREAD = 1.0  # relative uncertainty of the URDF's pseudo-inertias: a link may be wrong by its own size


def urdf_information(base: BaseParameters, urdf: FloatArray, at: FloatArray | None = None) -> Information:
    """Prior on the base parameters from the URDF: `URDF_SPREAD`^-2 D, to second order.

    D is the entropic divergence, see `Divergence`, whose pull is the same in every
    unit and frame, and as nothing against thousands of samples. The inertial parameters that no torque shows
    are profiled out.

    Args:
        base: the arm's base parameters.
        urdf: inertial parameters of the URDF, shape (10 links,); raised to bodies by `nearest_bodies`.
        at: bodies at which D is expanded, shape (10 links,); None for the URDF's.

    Returns:
        Of the base parameters, matrix (b, b) and vector (b,).
    """
    divergence = Divergence(nearest_bodies(urdf))
    point = divergence.origin if at is None else at
    inverse_root = np.linalg.pinv(divergence.curvature_root(point))  # C C' is the inverse curvature
    mean = point - inverse_root @ (inverse_root.T @ divergence.gradient(point))
    reach = base.grouping @ inverse_root
    matrix = np.linalg.inv(reach @ reach.T) / URDF_SPREAD**2
    return Information(matrix, matrix @ (base.grouping @ mean))


def consistent_information(base: BaseParameters, urdf: FloatArray, total: Information) -> Information:
    """Weight of the URDF prior for which the linear solution is physically consistent.

    Args:
        base: the arm's base parameters.
        urdf: see `urdf_information`.
        total: what all joints say of the base parameters, of f sets of runs: matrix (f, b, b), vector (f, b).

    Returns:
        Of the base parameters, matrix (f, b, b) and vector (f, b).
    """
    divergence, grouping = Divergence(nearest_bodies(urdf)), base.grouping
    pulls = []
    for matrix, vector in zip(total.matrix, total.vector, strict=True):
        onto = Information(grouping.T @ matrix @ grouping, grouping.T @ vector)
        bodies = fit_bodies(onto, divergence, URDF_SPREAD**-2)
        pulls.append(urdf_information(base, urdf, bodies))
    return Information(*(np.stack([getattr(pull, part) for pull in pulls]) for part in ("matrix", "vector")))


_FALL = 0.05  # factor on the prior's weight from one point of the path to the next
_STEPS = 50  # Newton steps for one point
_CLOSE = 0.1  # squared Newton decrement, relative to the prior's weight, that is enough on the path
_CLOSEST = 1e-12  # the same at its end


def fit_bodies(information: Information, divergence: Divergence, precision: float) -> FloatArray:
    """Minimize the penalized objective along the path.

    Args:
        information: A (10 links, 10 links) and b (10 links,): what the data say, see `Information`.
        divergence: divergence from the bodies that the parameters are drawn to.
        precision: weight of D, see `palpate.estimation.arm.consistent_fit`.

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
        """From bodies to the bodies of least cost.

        Args:
            inertial: parameters of all bodies, shape (10 links,).
            precision: weight of the divergence from the bodies of origin.
            close: squared decrement at which it ends, as a share of the precision.
        """
        current = self._cost(inertial, precision)
        for _ in range(_STEPS):
            step, decrement = self.newton(inertial, precision)
            if decrement <= close * precision:
                break
            share = 1.0
            while (
                proposed := self._cost(inertial - share * step, precision)
            ) > current - 0.1 * share * decrement:
                share *= 0.5
                if share < 1e-10:  # rounding errors: it goes no lower
                    return inertial
            inertial, current = inertial - share * step, proposed
        return inertial

    def newton(self, inertial: FloatArray, precision: float) -> tuple[FloatArray, float]:
        """Newton's step (10 links,), to be taken off, and its decrement squared.

        The curvature is factored by QR of its root: its eigenvalues can lie further apart than a double's
        digits.

        Args:
            inertial: pseudo-inertia parameters of the links, shape (10 links,).
            precision: weight of the divergence from the bodies of origin.
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
