"""Inertial parameters of an arm: identifiability, physical consistency and divergence.

Some parameters affect no torque, others only in fixed combinations. The base parameters are the smallest set
that determines all torques: M. Gautier, J. Robotic Systems 8(4) (1991). They are the same for all joints of
the arm.

A link's ten parameters (m, h = m c, I about the joint's frame) belong to a distribution of positive mass if
and only if its pseudo-inertia is positive definite:

    P = [[tr(I)/2 - I, h], [h', m]]

P. Wensing, S. Kim, J.-J. Slotine, IEEE RA-L 3(1) (2018). P is linear in the parameters. The entropic
divergence

    D(P | P0) = tr(P0^-1 P) - log|P0^-1 P| - 4

is convex in the parameters and does not depend on units or frames. It is zero at P0, and infinite where P is
not positive definite: T. Lee, P. Wensing, F. Park, IEEE T-RO 36(1) (2020). To second order
D = |P0^-1/2 (P - P0) P0^-1/2|^2 / 2.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from palpate.robot_io.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from palpate.control.arm.rigid_body import RigidBody

_POSTURE_COUNT = 200
_MIN_RESIDUAL = 1e-6  # least relative residual of an independent column; URDFs contain rounded axes
_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)


@dataclass(frozen=True)
class BaseParameters:
    """The base parameters of an arm: torque = Y phi = Y[:, columns] @ (grouping @ phi).

    Each base parameter is a link parameter phi_i, i in `columns`, plus a linear combination of the parameters
    whose columns of Y depend linearly on the chosen ones. Of several equivalent parameters, the first one
    from the base outwards is chosen, as in W. Khalil, E. Dombre (2002), ch. 9.
    """

    # Indices of independent columns of the regressor, ascending, shape (b,); see
    # `palpate.control.arm.rigid_body.RigidBody.regressor`.
    columns: IntArray
    grouping: FloatArray  # coefficients of the link parameters in each base parameter, shape (b, 10 links)
    affects_joint: BoolArray  # whether a joint's torque depends on each base parameter, shape (joints, b)

    @property
    def names(self) -> tuple[str, ...]:
        """Names such as "link2_Izz", in the order of `columns`."""
        return tuple(inertial_name(int(i)) for i in self.columns)


def inertial_name(column: int) -> str:
    """Return the name of the parameter of a regressor column, such as "link2_Izz".

    Args:
        column: column of the regressor, from 0.
    """
    return f"link{column // len(_NAMES) + 1}_{_NAMES[column % len(_NAMES)]}"


def inertial_unit(column: int) -> str:
    """Return the unit of the parameter of a regressor column.

    Args:
        column: column of the regressor, from 0.
    """
    return _UNITS[column % len(_NAMES)]


@lru_cache(maxsize=4)
def base_parameters(body: "RigidBody") -> BaseParameters:
    """Compute the base parameters of an arm from random postures, velocities and accelerations.

    The columns of the regressor are selected one by one from the base outwards, by Gram-Schmidt, and the
    others are expressed by them. The motions are the same in each call.

    Args:
        body: rigid-body model of the arm.
    """
    motions = np.random.default_rng(0).uniform(-2.0, 2.0, (_POSTURE_COUNT, 3, body.joint_count))
    regressor = np.array([body.regressor(*motion) for motion in motions])
    rows = regressor.reshape(-1, regressor.shape[2])
    # Select columns that are linearly independent of the previous ones (Gram-Schmidt, projected twice).
    lengths = np.linalg.norm(rows, axis=0)
    min_length = _MIN_RESIDUAL * np.maximum(lengths, 1e-3 * lengths.max())
    basis, independent = np.zeros((len(rows), 0)), []
    for index, column in enumerate(rows.T):
        residual = column - basis @ (basis.T @ column)
        residual -= basis @ (basis.T @ residual)
        length = np.linalg.norm(residual)
        if length > min_length[index]:
            independent.append(index)
            basis = np.column_stack([basis, residual / length])
    columns = np.array(independent, dtype=np.int64)
    grouping = np.linalg.lstsq(rows[:, columns], rows, rcond=None)[0]
    grouping[np.abs(grouping) < _MIN_RESIDUAL] = 0.0
    torque_scale = np.abs(regressor[:, :, columns]).max(axis=0)
    return BaseParameters(columns, grouping, torque_scale > _MIN_RESIDUAL * torque_scale.max(axis=0))


PARAMETERS = 10
_MIN_MASS_SHARE = 1e-3  # mass of a link without mass in the URDF, relative to the heaviest link
_MIN_RADIUS_SHARE = 0.02  # gyration radius of a link without inertia in the URDF, relative to the largest one
_ROUNDING = 1e-13  # relative to the given body: smaller eigenvalues are not physical


def _unit_pseudo_inertias() -> FloatArray:
    """Return P for a unit of each parameter, shape (10, 4, 4), in Pinocchio's order (as `_NAMES`)."""
    units = np.zeros((PARAMETERS, 4, 4))
    units[0, 3, 3] = 1.0
    for axis in range(3):
        units[1 + axis, axis, 3] = units[1 + axis, 3, axis] = 1.0
    for index, (row, column) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)], start=4):
        inertia = np.zeros((3, 3))
        inertia[row, column] = inertia[column, row] = 1.0
        units[index, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return units


_PSEUDO_UNITS = _unit_pseudo_inertias()


def pseudo_inertias(inertial: FloatArray) -> FloatArray:
    """Return the pseudo-inertia of each link, shape (links, 4, 4).

    Args:
        inertial: parameters of all links, shape (10 links,), SI units.
    """
    return np.tensordot(inertial.reshape(-1, PARAMETERS), _PSEUDO_UNITS, axes=1)


def inertial_of(pseudo: FloatArray) -> FloatArray:
    """Return the inertial parameters, shape (10 links,), of pseudo-inertias.

    Args:
        pseudo: pseudo-inertias, shape (links, 4, 4).
    """
    second = pseudo[:, :3, :3]
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    moments = inertia[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate([pseudo[:, 3:, 3], pseudo[:, 3, :3], moments], axis=1).ravel()


def nearest_bodies(inertial: FloatArray) -> FloatArray:
    """Return physically consistent inertial parameters near the given ones, shape (10 links,).

    URDFs contain links without mass or inertia, and rounded inertias that are not physical. Masses are raised
    to a thousandth of the heaviest, and radii of gyration about the center of mass to 2 % of the arm's
    largest.

    Args:
        inertial: parameters of all links, shape (10 links,), SI units.
    """
    pseudo = pseudo_inertias(inertial)
    mass = np.maximum(pseudo[:, 3, 3], _MIN_MASS_SHARE * max(float(pseudo[:, 3, 3].max()), 1e-3))
    is_given = pseudo[:, 3, 3] == mass
    center = np.where(is_given[:, None], pseudo[:, :3, 3] / mass[:, None], 0.0)
    covariance = pseudo[:, :3, :3] / mass[:, None, None] - center[:, :, None] * center[:, None, :]
    squared_radii, axes = np.linalg.eigh(covariance)
    min_squared_radius = _MIN_RADIUS_SHARE**2 * max(float(squared_radii.max()), 1e-4)
    covariance = (axes * np.maximum(squared_radii, min_squared_radius)[:, None, :]) @ axes.transpose(0, 2, 1)
    pseudo = np.empty_like(pseudo)
    pseudo[:, :3, :3] = mass[:, None, None] * (covariance + center[:, :, None] * center[:, None, :])
    pseudo[:, :3, 3] = pseudo[:, 3, :3] = mass[:, None] * center
    pseudo[:, 3, 3] = mass
    return inertial_of(pseudo)


@dataclass(frozen=True)
class Divergence:
    """Entropic divergence D from given inertial parameters, summed over the links."""

    origin: FloatArray  # the given inertial parameters, physically consistent, shape (10 links,)

    @cached_property
    def _origin_factor(self) -> FloatArray:
        """L^-1 of each given pseudo-inertia P0 = L L', shape (links, 4, 4)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(pseudo_inertias(self.origin))))

    def value(self, inertial: FloatArray) -> float:
        """Compute D; infinite if the parameters of a link are not physical.

        Args:
            inertial: parameters of all links, shape (10 links,), SI units.
        """
        factor = self._origin_factor
        ratio = np.linalg.eigvalsh(factor @ pseudo_inertias(inertial) @ factor.transpose(0, 2, 1))
        if ratio.min() <= _ROUNDING:
            return np.inf
        return float(np.sum(ratio - np.log(ratio) - 1.0))

    def gradient(self, inertial: FloatArray) -> FloatArray:
        """Compute the gradient of D, shape (10 links,).

        Args:
            inertial: parameters of all links, shape (10 links,), SI units.
        """
        change = np.linalg.inv(pseudo_inertias(self.origin)) - np.linalg.inv(pseudo_inertias(inertial))
        return np.asarray(np.einsum("lij,pij->lp", change, _PSEUDO_UNITS).ravel())

    def curvature_root(self, inertial: FloatArray) -> FloatArray:
        """Compute a root R of the Hessian R' R, shape (16 links, 10 links): L^-1 dP L^-T with P = L L'.

        Args:
            inertial: parameters of all links, shape (10 links,), SI units.
        """
        factor = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(inertial)))
        scaled_units = np.einsum("lij,pjk,lmk->limp", factor, _PSEUDO_UNITS, factor)
        links = np.arange(len(scaled_units))
        root = np.zeros((len(scaled_units), 16, len(scaled_units), PARAMETERS))
        root[links, :, links, :] = scaled_units.reshape(-1, 16, PARAMETERS)
        return np.asarray(root.reshape(-1, inertial.size))
