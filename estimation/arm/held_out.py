"""How well an arm's identified parameters predict runs that they were not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.arm.base_parameters import BaseParameters
from estimation.arm.identify import identify
from estimation.arm.prior import URDF_SPREAD
from estimation.arm.rows import ArmRows
from robot_io.errors import InputError
from robot_io.types import FloatArray, IntArray


@dataclass(frozen=True)
class HeldOut:
    """Errors of held-out runs.

    Attributes:
        residual: measured less predicted torque, shape (n, joints) [N m].
        rmse: of each joint, weighted, shape (joints,) [N m].
        spread: standard deviation of each joint's torque, weighted alike about the mean, shape (joints,) [N
            m].
    """

    residual: FloatArray
    rmse: FloatArray
    spread: FloatArray

    @property
    def relative(self) -> float:
        """Root mean square over the joints of error over spread."""
        return float(np.sqrt(np.mean((self.rmse / self.spread) ** 2)))


def held_out(
    rows: ArmRows,
    base: BaseParameters,
    urdf: FloatArray,
    urdf_spread: float = URDF_SPREAD,
    *,
    groups: Sequence[IntArray] | None = None,
) -> HeldOut:
    """Fit on all runs but some, predict these, for each group of runs.

    Args:
        rows: the equations.
        base: see `identify`.
        urdf: see `identify`.
        urdf_spread: see `identify`.
        groups: run numbers that are held out together; None for each run by itself.

    Raises:
        InputError: there is only one group, or what is left of a joint is too little.
    """
    groups = [np.array([run]) for run in np.unique(rows.run)] if groups is None else groups
    if len(groups) < 2:
        raise InputError(
            "arm: one run cannot be held out, for nothing is left to fit to: record at least two"
        )
    residual = np.full_like(rows.torque, np.nan)
    for group in groups:
        inside = np.isin(rows.run, group)
        estimate = identify(rows.of_runs(np.unique(rows.run[~inside])), base, urdf, urdf_spread)
        tested = rows.of_runs(group)
        residual[inside] = tested.torque - estimate.predict(tested)
    weights = rows.weights / rows.weights.sum(axis=0)
    mean = np.sum(weights * rows.torque, axis=0)
    rmse, spread = (np.sqrt(np.sum(weights * e**2, axis=0)) for e in (residual, rows.torque - mean))
    return HeldOut(residual, rmse, spread)
