"""The inertial parameters of an arm and each joint's own gains, from the torques of all joints in one fit.

    tau_j(t) = Y_j(q, v, a) phi + S_j(t) c + X_j(t) g_j + e_j(t)

Weighted by each joint's noise, which the residuals tell (iterated), physically consistent, and drawn to the
URDF where the motion does not excite them. Standard errors allow for noise that is correlated in time and
between joints. C. G. Atkeson, C. H. An, J. M. Hollerbach, IJRR 5(3) (1986); W. Khalil, E. Dombre, Modeling,
Identification and Control of Robots (2002), ch. 12.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from estimation.arm.arm_estimate import ArmEstimate, Uncertainty
from estimation.arm.base_parameters import BaseParameters
from estimation.arm.consistent_fit import fit_bodies
from estimation.arm.normal_equations import JointMoments, joint_moments, own_gains, shared_information
from estimation.arm.prior import URDF_SPREAD
from estimation.arm.pseudo_inertia import Divergence, nearest_bodies
from estimation.arm.rows import ArmRows
from estimation.information import Information, pseudo_inverse
from estimation.statistics.noise_level import robust_sigma
from estimation.statistics.serial_covariance import sum_covariance
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

_ROUNDS = 20
_SETTLED = 1e-3  # relative change of every joint's noise
_SINGULAR = 1e-14  # of the largest eigenvalue
_LOST = 1e-3  # share of a parameter that lies in directions without information
_NO_NOISE = 1e-9  # of the torque: smaller residuals are rounding errors


@dataclass(frozen=True)
class _Fit:
    """Parameters for given noise, and the information that the data had of the base parameters, (b, b)."""

    inertial: FloatArray
    shared: FloatArray
    own: tuple[FloatArray, ...]
    said: FloatArray


def identify(
    rows: ArmRows, base: BaseParameters, urdf: FloatArray, urdf_spread: float = URDF_SPREAD
) -> ArmEstimate:
    """Fit all joints together.

    Args:
        rows: the equations.
        base: the arm's base parameters, whose columns `rows.regressor` holds.
        urdf: inertial parameters of the URDF, shape (10 joints,); raised to bodies by `nearest_bodies`.
        urdf_spread: standard deviation of the URDF's pseudo-inertias as a share of themselves.

    Raises:
        InputError: a joint has fewer samples than parameters.
    """
    _check(rows, base)
    divergence, precision = Divergence(nearest_bodies(urdf)), urdf_spread**-2
    moments = _moments(rows)
    sigma = level = _rms(rows)
    inertial = divergence.origin
    for _ in range(_ROUNDS):
        fit = _fit(moments, sigma, base, divergence, precision, start=inertial)
        inertial = fit.inertial
        residual = _residual(rows, base, fit)
        before, sigma = sigma, np.maximum(_noise(residual, rows.weights), _NO_NOISE * level)
        if np.all(np.abs(sigma - before) <= _SETTLED * before):
            break
    prior, at_urdf = (precision * divergence.hessian(at) for at in (inertial, divergence.origin))
    uncertainty = _uncertainty(rows, base, sigma, residual, prior)
    share, determined = _shares(base.grouping.T @ fit.said @ base.grouping, at_urdf)
    return ArmEstimate(inertial, base, fit.shared, fit.own, sigma, uncertainty, share, determined)


def _check(rows: ArmRows, base: BaseParameters) -> None:
    if rows.regressor.shape[1:] != base.felt.shape:
        raise InputError(
            f"arm: regressor is of {rows.regressor.shape[1:]} joints and base parameters, "
            f"expected {base.felt.shape}"
        )
    for joint, weights in enumerate(rows.weights.T):
        used = np.count_nonzero(weights)
        needed = np.count_nonzero(base.felt[joint]) + rows.own[joint].shape[1]
        if used <= needed:
            raise InputError(f"joint {joint + 1}: {used} samples cannot determine {needed} parameters")
        if not np.any(weights * rows.torque[:, joint]):
            raise InputError(f"joint {joint + 1}: its torque is 0 throughout, so it was not measured")


def _moments(rows: ArmRows) -> list[JointMoments]:
    """With noise of 1: it only scales them."""
    columns = np.concatenate([rows.regressor, rows.shared], axis=2)
    return [
        joint_moments(columns[:, j], own, rows.torque[:, j], sigma=1.0, weights=rows.weights[:, j])
        for j, own in enumerate(rows.own)
    ]


def _fit(
    moments: Sequence[JointMoments],
    sigma: FloatArray,
    base: BaseParameters,
    divergence: Divergence,
    precision: float,
    *,
    start: FloatArray,
) -> _Fit:
    """All parameters for given noise, from bodies `start` near them."""
    count, grouping = len(base.columns), base.grouping
    parts = [shared_information(one).times(float(s) ** -2) for one, s in zip(moments, sigma, strict=True)]
    whole = Information(sum(part.matrix[0] for part in parts), sum(part.vector[0] for part in parts))
    said = whole.about(np.arange(count))
    onto = Information(grouping.T @ said.matrix @ grouping, grouping.T @ said.vector)
    inertial = fit_bodies(onto, divergence, precision, start)
    beside = whole.vector[count:] - whole.matrix[count:, :count] @ (grouping @ inertial)
    shared = pseudo_inverse(whole.matrix[count:, count:]) @ beside
    every = np.concatenate([grouping @ inertial, shared])[None]
    return _Fit(inertial, shared, tuple(own_gains(joint, every)[0] for joint in moments), said.matrix)


def _residual(rows: ArmRows, base: BaseParameters, fit: _Fit) -> FloatArray:
    own = np.column_stack([columns @ gains for columns, gains in zip(rows.own, fit.own, strict=True)])
    return np.asarray(
        rows.torque - rows.regressor @ (base.grouping @ fit.inertial) - rows.shared @ fit.shared - own
    )


def _rms(rows: ArmRows) -> FloatArray:
    power = np.sum(rows.weights * rows.torque**2, axis=0) / np.sum(rows.weights, axis=0)
    return np.asarray(np.sqrt(np.maximum(power, np.finfo(float).tiny)))


def _noise(residual: FloatArray, weights: FloatArray) -> FloatArray:
    """Robust standard deviation of each joint's residuals, shape (joints,)."""
    return np.array([robust_sigma(e[w > 0.0]) for e, w in zip(residual.T, weights.T, strict=True)])


def _uncertainty(
    rows: ArmRows, base: BaseParameters, sigma: FloatArray, residual: FloatArray, prior: FloatArray
) -> Uncertainty:
    """The sandwich, with the URDF as one more independent measurement of the inertial parameters."""
    weights = rows.weights / sigma**2
    own = [columns * (weights * residual)[:, j, None] for j, columns in enumerate(rows.own)]
    columns = np.concatenate([rows.regressor, rows.shared], axis=2)
    score = np.concatenate([np.einsum("njb,nj->nb", columns, weights * residual), *own], axis=1)
    gains = score.shape[1] - len(base.columns)
    onto = block_diag(base.grouping, np.eye(gains))  # from (inertial, gains) to (base, gains)
    known = block_diag(prior, np.zeros((gains, gains)))
    bread, lost = _inverse(onto.T @ _curvature(columns, rows.own, weights) @ onto + known)
    used = np.count_nonzero(rows.weights)
    few = used / max(1.0, used - score.shape[1])

    def sandwich(middle: FloatArray) -> FloatArray:
        covariance = bread @ (onto.T @ (few * middle) @ onto + known) @ bread
        covariance[lost], covariance[:, lost] = np.nan, np.nan
        return np.asarray(covariance)

    return Uncertainty(
        sandwich(sum_covariance(score, rows.run).matrix), sandwich(score.T @ score), len(score)
    )


def _curvature(columns: FloatArray, own: tuple[FloatArray, ...], weights: FloatArray) -> FloatArray:
    """Second derivative of half the squared residuals by (base, shared, own gains)."""
    first = columns.shape[2]
    starts = first + np.cumsum([0, *(part.shape[1] for part in own)])
    whole = np.zeros((starts[-1], starts[-1]))
    for joint, part in enumerate(own):
        places = np.concatenate([np.arange(first), np.arange(starts[joint], starts[joint + 1])])
        both = np.column_stack([columns[:, joint], part])
        whole[np.ix_(places, places)] += both.T @ (both * weights[:, joint, None])
    return whole


def _inverse(matrix: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Of a symmetric matrix, and which parameters it does not determine."""
    size = np.sqrt(np.diag(matrix))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    scaled = matrix * np.outer(scale, scale)
    inverse = np.linalg.pinv(scaled, rcond=_SINGULAR, hermitian=True)
    lost = np.abs(1.0 - np.diag(inverse @ scaled)) > _LOST
    return inverse * np.outer(scale, scale), lost


def _shares(said: FloatArray, urdf: FloatArray) -> tuple[FloatArray, int]:
    """`data_share` and `determined`, from what data and URDF say of the inertial parameters."""
    scale = 1.0 / np.sqrt(np.diag(urdf))
    root = np.linalg.inv(np.linalg.cholesky(urdf * np.outer(scale, scale)))
    relative, axes = np.linalg.eigh(root @ (said * np.outer(scale, scale)) @ root.T)
    relative = np.maximum(relative, 0.0)
    turned = root.T @ axes  # variance by the URDF is turned turned', by both turned / (1 + relative) turned'
    share = 1.0 - (turned**2 / (1.0 + relative)).sum(axis=1) / (turned**2).sum(axis=1)
    return share, int(np.sum(relative > 1.0))
