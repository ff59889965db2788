"""What of an arm's ten parameters a link the joint torques can show at all.

Some parameters act on no joint, others only in fixed combinations. The base parameters are the smallest set
that gives every torque: M. Gautier, J. Robotic Systems 8(4) (1991). They are the same for all joints of the
arm.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palpate.robot_io.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from palpate.control.arm.rigid_body import RigidBody

_POSTURES = 200
_INDEPENDENT = (
    1e-6  # of its length, what must be left of a column beside those before it; axes in URDFs are rounded
)
_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)


@dataclass(frozen=True)
class BaseParameters:
    """The base parameters of an arm: torque = Y phi = Y[:, columns] @ (grouping @ phi).

    Each is one parameter phi_i of a link, i in `columns`, with what other parameters add to it, whose
    columns of Y are sums of these. From the base outwards the first of several equivalent ones is taken, so
    that a link's mass and what it shares with the link before are counted there, as in W. Khalil, E. Dombre
    (2002), ch. 9.
    """

    # Of the regressor (see `palpate.control.arm.rigid_body.RigidBody.regressor`), ascending, shape (b,).
    columns: IntArray
    grouping: FloatArray  # shape (b, 10 links)
    felt: BoolArray  # joints whose torque depends on each, shape (joints, b)

    @property
    def names(self) -> tuple[str, ...]:
        """Such as "link2_Izz", in the order of `columns`."""
        return tuple(inertial_name(int(i)) for i in self.columns)

    @property
    def units(self) -> tuple[str, ...]:
        """In the order of `columns`."""
        return tuple(inertial_unit(int(i)) for i in self.columns)

    def felt_columns(self, joint: int) -> IntArray:
        """Return those of `columns` on which the torque of a joint depends.

        Args:
            joint: number of the joint, from 0.
        """
        return np.asarray(self.columns[self.felt[joint]])


def inertial_name(column: int) -> str:
    """Name the parameter of a column of the regressor, such as "link2_Izz".

    Args:
        column: of the regressor, from 0.
    """
    return f"link{column // len(_NAMES) + 1}_{_NAMES[column % len(_NAMES)]}"


def inertial_unit(column: int) -> str:
    """Return the unit of the parameter of a column of the regressor.

    Args:
        column: of the regressor, from 0.
    """
    return _UNITS[column % len(_NAMES)]


def base_parameters(body: "RigidBody") -> BaseParameters:
    """Find the base parameters of an arm from random postures, velocities and accelerations.

    Args:
        body: the arm.
    """
    rng = np.random.default_rng(0)
    motions = rng.uniform(-2.0, 2.0, (_POSTURES, 3, body.joint_count))
    regressor = np.array([body.regressor(*motion) for motion in motions])
    rows = regressor.reshape(-1, regressor.shape[2])
    # Columns that are not sums of those before them (Gram-Schmidt, each projection done twice).
    lengths = np.linalg.norm(rows, axis=0)
    least = _INDEPENDENT * np.maximum(lengths, 1e-3 * lengths.max())
    basis, chosen = np.zeros((len(rows), 0)), []
    for index, column in enumerate(rows.T):
        left = column - basis @ (basis.T @ column)
        left -= basis @ (basis.T @ left)
        length = np.linalg.norm(left)
        if length > least[index]:
            chosen.append(index)
            basis = np.column_stack([basis, left / length])
    columns = np.array(chosen, dtype=np.int64)
    grouping = np.linalg.lstsq(rows[:, columns], rows, rcond=None)[0]
    grouping[np.abs(grouping) < _INDEPENDENT] = 0.0
    size = np.abs(regressor[:, :, columns]).max(axis=0)
    return BaseParameters(columns, grouping, size > _INDEPENDENT * size.max(axis=0))
