"""What the URDF says of an arm's base parameters, as if it had been measured."""

import numpy as np

from estimation.arm.base_parameters import BaseParameters
from estimation.arm.consistent_fit import fit_bodies
from estimation.arm.pseudo_inertia import Divergence, nearest_bodies
from estimation.information import Information
from robot_io.types import FloatArray

URDF_SPREAD = 1.0  # of its pseudo-inertias, as a share: a link may be wrong by as much as it is


def urdf_information(base: BaseParameters, urdf: FloatArray, at: FloatArray | None = None) -> Information:
    """The pull of the base parameters to the URDF: `URDF_SPREAD`^-2 D, to second order.

    D is the entropic divergence of `estimation.arm.pseudo_inertia`, whose pull is the same in every unit
    and frame, and as nothing against thousands of samples. The inertial parameters that no torque shows are
    profiled out.

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


def consistent_information(base: BaseParameters, urdf: FloatArray, said: Information) -> Information:
    """The pull to the URDF beside data, such that the linear solution is one that bodies can have.

    Args:
        base: the arm's base parameters.
        urdf: see `urdf_information`.
        said: what all joints say of the base parameters, of f sets of runs: matrix (f, b, b), vector (f, b).

    Returns:
        Of the base parameters, matrix (f, b, b) and vector (f, b).
    """
    divergence, grouping = Divergence(nearest_bodies(urdf)), base.grouping
    pulls = []
    for matrix, vector in zip(said.matrix, said.vector, strict=True):
        onto = Information(grouping.T @ matrix @ grouping, grouping.T @ vector)
        bodies = fit_bodies(onto, divergence, URDF_SPREAD**-2)
        pulls.append(urdf_information(base, urdf, bodies))
    return Information(*(np.stack([getattr(one, part) for one in pulls]) for part in ("matrix", "vector")))
