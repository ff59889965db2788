"""Physically consistent fit of a whole arm: information on gains that its joints share."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
import scipy

from palpate.estimation.arm.inertial_parameters import BaseParameters, Divergence, nearest_bodies
from palpate.estimation.channel import ChannelData, Information, SharedGains
from palpate.estimation.data_quality import reject_reason, usable
from palpate.estimation.effects.friction import CoulombFriction
from palpate.estimation.effects.gravity_load import RigidBodyFitted
from palpate.estimation.effects.inertia import Armature
from palpate.estimation.effects.sensor_statics import Bias
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.model import Model
from palpate.robot_io.types import FloatArray


def arrange_products(products: FloatArray, names: Sequence[str], shared: Sequence[str]) -> FloatArray:
    """Reorder the cross products of one joint: shared columns, own columns, torque.

    Args:
        products: shape (folds, q + 1, q + 1); the last row and column belong to the torque.
        names: names of the q columns.
        shared: names of the shared columns in their common order; those missing in `names` become zero. All
            other columns are the joint's own, in the order of `names`.
    """
    own_names = [name for name in names if name not in set(shared)]
    index_by_name = {name: index for index, name in enumerate([*shared, *own_names])}
    indices = np.array([*(index_by_name[name] for name in names), len(index_by_name)])
    ordered = np.zeros((len(products), len(index_by_name) + 1, len(index_by_name) + 1))
    ordered[:, indices[:, None], indices] = products
    return ordered


def shared_information(products: FloatArray, shared: int, sigma: float) -> Information:
    """Compute the information of one joint on the shared parameters, with its own gains profiled out.

    Args:
        products: cross products of the joint, see `arrange_products`.
        shared: number of shared columns s.
        sigma: standard deviation of the joint's noise in a sample [N m].

    Returns:
        Matrix (1 + folds, s, s) and vector (1 + folds, s): [0] from all folds, [1 + f] without fold f.
    """
    total = products.sum(axis=0, keepdims=True)
    total = np.concatenate([total, total - products]) / sigma**2
    return Information(total[:, :-1, :-1], total[:, :-1, -1]).about(np.arange(shared))


def information_of_others(by_joint: Sequence[Information], prior: Information) -> tuple[Information, ...]:
    """Return for each joint the information on the shared parameters from all other joints and the prior.

    Args:
        by_joint: information of each joint, with the same folds.
        prior: prior of the shared parameters, matrix (s, s) or (1 + folds, s, s), for example from
            `consistent_information`.

    Returns:
        For each joint, matrix (1 + folds, s, s) and vector (1 + folds, s): [0] from all folds, [1 + f]
        without fold f. Add it to the joint's own sums over the same folds after division by its sigma^2, or
        add `times(sigma**2)` to the undivided sums. The fit of this joint then equals the fit of all joints.
    """
    return tuple(sum([*by_joint[:j], *by_joint[j + 1 :]], start=prior) for j in range(len(by_joint)))


URDF_SPREAD = 1.0  # relative uncertainty of the URDF's pseudo-inertias: 1 means an error of 100 %


def urdf_information(base: BaseParameters, urdf: FloatArray, at: FloatArray | None = None) -> Information:
    """Compute the prior on the b base parameters from the URDF: `URDF_SPREAD`^-2 D, to second order.

    D is the entropic divergence, see `Divergence`. It does not depend on units or frames, and its weight is
    negligible against thousands of samples. Inertial parameters that affect no torque are profiled out.

    Args:
        base: the arm's base parameters.
        urdf: inertial parameters of the URDF, shape (10 links,); `nearest_bodies` makes them consistent.
        at: consistent parameters at which D is expanded, shape (10 links,); None for those of the URDF.
    """
    divergence = Divergence(nearest_bodies(urdf))
    point = divergence.origin if at is None else at
    inverse_root = np.linalg.pinv(divergence.curvature_root(point))  # C C' is the inverse curvature
    mean = point - inverse_root @ (inverse_root.T @ divergence.gradient(point))
    grouped_root = base.grouping @ inverse_root
    matrix = np.linalg.inv(grouped_root @ grouped_root.T) / URDF_SPREAD**2
    return Information(matrix, matrix @ (base.grouping @ mean))


def consistent_information(base: BaseParameters, urdf: FloatArray, total: Information) -> Information:
    """Expand the URDF prior at each consistent fit, so that linear fits with it are physically consistent.

    Args:
        base: the arm's base parameters.
        urdf: see `urdf_information`.
        total: information of all joints on the base parameters from f sets of runs: matrix (f, b, b), vector
            (f, b).
    """
    divergence, grouping = Divergence(nearest_bodies(urdf)), base.grouping
    expanded = []
    for matrix, vector in zip(total.matrix, total.vector, strict=True):
        body_information = Information(grouping.T @ matrix @ grouping, grouping.T @ vector)
        bodies = fit_bodies(body_information, divergence, URDF_SPREAD**-2)
        expanded.append(urdf_information(base, urdf, bodies))
    return Information(np.stack([p.matrix for p in expanded]), np.stack([p.vector for p in expanded]))


_WEIGHT_FACTOR = 0.05  # factor on the prior's weight from one point of the path to the next
_MAX_STEPS = 50  # maximum number of Newton steps at one point
_PATH_TOLERANCE = 0.1  # squared Newton decrement at which a point of the path ends, as a share of the weight
_FINAL_TOLERANCE = 1e-12  # the same at the last point of the path


def fit_bodies(information: Information, divergence: Divergence, precision: float) -> FloatArray:
    """Find the consistent inertial parameters (10 links,) that minimize the objective plus precision * D.

    The weight of D decreases to the precision step by step.

    Args:
        information: quadratic objective of the data, matrix (10 links, 10 links) and vector (10 links,).
        divergence: divergence D from the prior's inertial parameters.
        precision: final weight of D.
    """
    problem = _Problem(information, divergence)
    inertial = divergence.origin
    weight = np.sqrt(problem.newton(inertial, precision)[1] / precision) * precision
    while weight > precision:
        inertial = problem.descend(inertial, weight, _PATH_TOLERANCE)
        weight *= _WEIGHT_FACTOR
    return problem.descend(inertial, precision, _FINAL_TOLERANCE)


class _Problem:
    """Newton's method for the penalized objective at a given precision."""

    def __init__(self, information: Information, divergence: Divergence) -> None:
        self._information, self._divergence = information, divergence
        self._root = _root(information.matrix)

    def descend(self, inertial: FloatArray, precision: float, tolerance: float) -> FloatArray:
        """Return the parameters (10 links,) at which damped Newton steps minimize the cost.

        Args:
            inertial: consistent inertial parameters to start from, shape (10 links,).
            precision: weight of the divergence from the prior's parameters.
            tolerance: squared Newton decrement at which the search ends, as a share of the precision.
        """
        cost = self._cost(inertial, precision)
        for _ in range(_MAX_STEPS):
            step, decrement = self.newton(inertial, precision)
            if decrement <= tolerance * precision:
                break
            step_size = 1.0
            while (
                new := self._cost(inertial - step_size * step, precision)
            ) > cost - 0.1 * step_size * decrement:
                step_size *= 0.5
                if step_size < 1e-10:  # rounding errors prevent a further decrease
                    return inertial
            inertial, cost = inertial - step_size * step, new
        return inertial

    def newton(self, inertial: FloatArray, precision: float) -> tuple[FloatArray, float]:
        """Compute the Newton step (10 links,), which is to be subtracted, and the squared decrement.

        The Hessian is factored by QR of its root, because the ratio of its eigenvalues can exceed the
        precision of a double.

        Args:
            inertial: inertial parameters of the links, shape (10 links,).
            precision: weight of the divergence from the prior's parameters.
        """
        gradient = self._information.matrix @ inertial - self._information.vector
        gradient = gradient + precision * self._divergence.gradient(inertial)
        root = np.concatenate([self._root, np.sqrt(precision) * self._divergence.curvature_root(inertial)])
        scale = 1.0 / np.linalg.norm(root, axis=0)
        factor = np.linalg.qr(root * scale, mode="r")
        half = scipy.linalg.solve_triangular(factor, scale * gradient, trans="T", check_finite=False)
        step = scipy.linalg.solve_triangular(factor, half, check_finite=False)
        return scale * step, float(half @ half)

    def _cost(self, inertial: FloatArray, precision: float) -> float:
        quadratic = inertial @ (0.5 * self._information.matrix @ inertial - self._information.vector)
        return float(quadratic + precision * self._divergence.value(inertial))


def _root(matrix: FloatArray) -> FloatArray:
    """Return R with R' R = matrix; the result does not depend on the units of the columns."""
    column_size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.divide(1.0, column_size, out=np.zeros_like(column_size), where=column_size > 0.0)
    values, axes = np.linalg.eigh(matrix * np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T * column_size)


def with_shared_gains(channels: Sequence[ChannelData], models: Sequence[Model]) -> list[ChannelData]:
    """Add to each channel the information of the arm's other joints on the base parameters.

    Args:
        channels: channels of one robot.
        models: the base model of each channel.

    Returns:
        Channels in the order given. They are unchanged if any has shared information already, or if no joint
        with fitted base parameters passes the data checks.
    """
    if any(channel.shared is not None for channel in channels):
        return list(channels)
    arm_channels = [
        number
        for number, (data, model) in enumerate(zip(channels, models, strict=True))
        if _rigid_body(model) is not None and reject_reason(data) is None
    ]
    effect = _rigid_body(models[arm_channels[0]]) if arm_channels else None
    if effect is None or effect.arm is None or effect.urdf is None:
        return list(channels)
    names = [f"{effect.name}.{name}" for name in effect.arm.names]
    fits = []
    for number in arm_channels:  # without these effects, friction, a zero or a rotor biases base parameters
        model, data = models[number], channels[number]
        present = {term.kind for term in model.effects}
        missing = [term for term in (CoulombFriction(), Bias(), Armature()) if term.kind not in present]
        model = reduce(Model.with_effect, missing, model)
        fits.append(fit_model(data, model, {}, usable(data)))
    if len({fit.problem.blocked.folds for fit in fits}) > 1:
        return list(channels)
    by_joint = []
    for fit in fits:
        products = fit.problem.normal_equations([fit.solution.columns], fit.solution.target).products
        ordered = arrange_products(products, list(fit.solution.model.gains), names)
        by_joint.append(shared_information(ordered, len(names), _residual_rms(fit)))
    prior = consistent_information(effect.arm, effect.urdf, reduce(add, by_joint))
    information = information_of_others(by_joint, prior)
    prepared = list(channels)
    for number, fit, others in zip(arm_channels, fits, information, strict=True):
        shared_names = [name for name in names if name in fit.solution.model.gains]
        is_shared = np.array([name in shared_names for name in names])
        shared = SharedGains(tuple(shared_names), others.about(is_shared).times(_residual_rms(fit) ** 2))
        prepared[number] = replace(channels[number], shared=shared)
    return prepared


def _rigid_body(model: Model) -> RigidBodyFitted | None:
    return next((effect for effect in model.effects if isinstance(effect, RigidBodyFitted)), None)


def _residual_rms(fitted: FitResult) -> float:
    """Return the root mean square residual of a joint's own fit on blocks."""
    return float(np.sqrt(np.mean(fitted.solution.residual[fitted.problem.used] ** 2)))
