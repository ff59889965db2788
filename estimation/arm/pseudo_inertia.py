"""Which inertial parameters a body can have, and how far they are from those of another.

A link's ten parameters (m, h = m c, I about the joint's frame) belong to a distribution of positive mass if
and only if its pseudo-inertia is positive definite:

    P = [[tr(I)/2 - I, h], [h', m]]

P. Wensing, S. Kim, J.-J. Slotine, IEEE RA-L 3(1) (2018). P is linear in the parameters. The entropic
divergence

    D(P | P0) = tr(P0^-1 P) - log|P0^-1 P| - 4

is convex in them, does not depend on units or frames, is zero at P0 and infinite where P is no body any more:
T. Lee, P. Wensing, F. Park, IEEE T-RO 36(1) (2020). To second order D = |P0^-1/2 (P - P0) P0^-1/2|^2 / 2.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.robot_io.types import FloatArray

PARAMETERS = 10
_LEAST_MASS_SHARE = 1e-3  # of the heaviest link: a link that the URDF gives no mass
_LEAST_RADIUS_SHARE = 0.02  # of the arm's largest radius of gyration: a link that the URDF gives no inertia

_ROUNDING = 1e-13  # of the given body, in any direction: less is no body


def _unit_pseudo_inertias() -> FloatArray:
    """P of each parameter alone, shape (10, 4, 4), in Pinocchio's order m, h (3), Ixx Ixy Iyy Ixz Iyz Izz."""
    units = np.zeros((PARAMETERS, 4, 4))
    units[0, 3, 3] = 1.0
    for axis in range(3):
        units[1 + axis, axis, 3] = units[1 + axis, 3, axis] = 1.0
    for index, (row, column) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)], start=4):
        inertia = np.zeros((3, 3))
        inertia[row, column] = inertia[column, row] = 1.0
        units[index, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return units


_UNITS = _unit_pseudo_inertias()


def pseudo_inertias(inertial: FloatArray) -> FloatArray:
    """Return the pseudo-inertia of each link, shape (links, 4, 4).

    Args:
        inertial: parameters of all links, shape (10 links,), SI units.
    """
    return np.tensordot(inertial.reshape(-1, PARAMETERS), _UNITS, axes=1)


def inertial_of(pseudo: FloatArray) -> FloatArray:
    """Return the parameters, shape (10 links,), of pseudo-inertias.

    Args:
        pseudo: pseudo-inertias, shape (links, 4, 4).
    """
    second = pseudo[:, :3, :3]
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    tail = inertia[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate([pseudo[:, 3:, 3], pseudo[:, 3, :3], tail], axis=1).ravel()


def nearest_bodies(inertial: FloatArray) -> FloatArray:
    """Parameters (10 links,) of bodies that are at least a little extended, near those given.

    URDFs have links without mass or inertia, and rounded inertias that no body has. Masses are raised to a
    thousandth of the heaviest, and radii of gyration about the centre of mass to 2 % of the arm's largest.

    Args:
        inertial: parameters of all links, shape (10 links,), SI units.
    """
    pseudo = pseudo_inertias(inertial)
    mass = np.maximum(pseudo[:, 3, 3], _LEAST_MASS_SHARE * max(float(pseudo[:, 3, 3].max()), 1e-3))
    is_given = pseudo[:, 3, 3] == mass
    centre = np.where(is_given[:, None], pseudo[:, :3, 3] / mass[:, None], 0.0)
    spread = pseudo[:, :3, :3] / mass[:, None, None] - centre[:, :, None] * centre[:, None, :]
    squares, axes = np.linalg.eigh(spread)
    least = _LEAST_RADIUS_SHARE**2 * max(float(squares.max()), 1e-4)
    spread = (axes * np.maximum(squares, least)[:, None, :]) @ axes.transpose(0, 2, 1)
    pseudo = np.empty_like(pseudo)
    pseudo[:, :3, :3] = mass[:, None, None] * (spread + centre[:, :, None] * centre[:, None, :])
    pseudo[:, :3, 3] = pseudo[:, 3, :3] = mass[:, None] * centre
    pseudo[:, 3, 3] = mass
    return inertial_of(pseudo)


@dataclass(frozen=True)
class Divergence:
    """D from given bodies, summed over the links."""

    origin: FloatArray  # parameters of the given bodies, consistent, shape (10 links,)

    @cached_property
    def _origin_factor(self) -> FloatArray:
        """L^-1 of each given body, P0 = L L', shape (links, 4, 4)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(pseudo_inertias(self.origin))))

    def value(self, inertial: FloatArray) -> float:
        """D; infinite where a link is no body.

        Args:
            inertial: parameters of all links, shape (10 links,), SI units.
        """
        factor = self._origin_factor
        ratio = np.linalg.eigvalsh(factor @ pseudo_inertias(inertial) @ factor.transpose(0, 2, 1))
        if ratio.min() <= _ROUNDING:
            return np.inf
        return float(np.sum(ratio - np.log(ratio) - 1.0))

    def gradient(self, inertial: FloatArray) -> FloatArray:
        """Shape (10 links,).

        Args:
            inertial: parameters of all links, shape (10 links,), SI units.
        """
        change = np.linalg.inv(pseudo_inertias(self.origin)) - np.linalg.inv(pseudo_inertias(inertial))
        return np.asarray(np.einsum("lij,pij->lp", change, _UNITS).ravel())

    def curvature_root(self, inertial: FloatArray) -> FloatArray:
        """A root R of the second derivative R' R, shape (16 links, 10 links): L^-1 dP L^-T with P = L L'.

        Args:
            inertial: parameters of all links, shape (10 links,), SI units.
        """
        factor = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(inertial)))
        turned = np.einsum("lij,pjk,lmk->limp", factor, _UNITS, factor)
        links = np.arange(len(turned))
        whole = np.zeros((len(turned), 16, len(turned), PARAMETERS))
        whole[links, :, links, :] = turned.reshape(-1, 16, PARAMETERS)
        return np.asarray(whole.reshape(-1, inertial.size))
