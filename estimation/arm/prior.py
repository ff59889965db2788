"""What the URDF says of an arm's base parameters, as if it had been measured."""

import numpy as np

from estimation.arm.base_parameters import BaseParameters
from estimation.arm.pseudo_inertia import Divergence, nearest_bodies
from estimation.information import Information
from robot_io.types import FloatArray

URDF_SPREAD = 1.0  # a link of the URDF may be wrong by as much as it is


def urdf_information(
    base: BaseParameters, urdf: FloatArray, spread: float = URDF_SPREAD, at: FloatArray | None = None
) -> Information:
    """The pull of the base parameters to the URDF: spread^-2 D, to second order.

    D is the entropic divergence of `estimation.arm.pseudo_inertia`, whose pull is the same in every unit
    and frame, and as nothing against thousands of samples. The inertial parameters that no torque shows are
    profiled out.

    Args:
        base: the arm's base parameters.
        urdf: inertial parameters of the URDF, shape (10 links,); raised to bodies by `nearest_bodies`.
        spread: standard deviation of the URDF's pseudo-inertias as a share of themselves.
        at: bodies at which D is expanded, shape (10 links,); None for the URDF's. Expanded at the bodies that
            `identify` found, the linear solution beside the same data is theirs, and so physically
            consistent.

    Returns:
        Of the base parameters, matrix (b, b) and vector (b,).
    """
    divergence = Divergence(nearest_bodies(urdf))
    point = divergence.origin if at is None else at
    inverse_root = np.linalg.pinv(divergence.curvature_root(point))  # C C' is the inverse curvature
    mean = point - inverse_root @ (inverse_root.T @ divergence.gradient(point))
    reach = base.grouping @ inverse_root
    matrix = np.linalg.inv(reach @ reach.T) / spread**2
    return Information(matrix, matrix @ (base.grouping @ mean))
