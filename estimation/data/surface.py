"""Where the surface is, from the touches of one place."""

import numpy as np

from estimation.statistics.least_squares import solve
from estimation.statistics.uncertainty import common_error_covariance, sandwich
from estimation.surface import Surface
from estimation.tare import Tare
from robot_io.types import FloatArray, IntArray


def find_surface(
    along_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, run: IntArray, tare: Tare
) -> Surface:
    """The surface that the runs at one place share: where a spring and damper through them would begin.

    It does not lie deeper than the shallowest sample in contact, which is what counts for an object that does
    not begin like a spring.

    Args:
        along_m: tip along the press direction, shape (n,), samples in contact only [m].
        speed_m_s: its derivative, shape (n,) [m/s].
        force_n: force above that in free air, shape (n,) [N].
        run: shape (n,).
        tare: what was taken off the force.
    """
    first_m = float(along_m.min())
    columns = np.column_stack([along_m - first_m, speed_m_s, np.ones(len(along_m))])
    stiffness, _, offset_n = gains = solve(columns, force_n).gains
    residuals = force_n - columns @ gains
    covariance = sandwich(columns, residuals, np.ones(len(residuals)), run)
    if stiffness <= 0.0:
        return Surface(first_m, float("nan"))
    deeper_m = -offset_n / stiffness
    slope = np.array([-deeper_m, 0.0, -1.0]) / stiffness  # of deeper_m with the gains
    matrix = covariance.matrix + common_error_covariance(columns, tare.errors(run))
    std_err_m = float(np.sqrt(slope @ matrix @ slope))
    return Surface(first_m + min(float(deeper_m), 0.0), std_err_m)
