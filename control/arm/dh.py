"""Denavit-Hartenberg tables (standard convention): file format and forward kinematics.

Row i places frame i in frame i-1 as

    T = Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha)

with theta = joint position + `theta_rad` for a revolute joint, d = joint position + `d_m` for a prismatic
one, and neither for a fixed row (which places the first axis in the world, or the tool on the last link).
Denavit and Hartenberg, J. Applied Mechanics 22, 1955; Siciliano et al., "Robotics", Springer 2009,
section 2.8.2.

    name: example
    rows:
      - {name: base, type: fixed, alpha_rad: -1.5707963267948966}   # joint axes along world y
      - {name: joint_1, type: revolute, a_m: 0.3}
      - {name: joint_2, type: revolute, a_m: 0.25, theta_rad: 0.0, d_m: 0.0, alpha_rad: 0.0}
"""

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.files.file_model import FileModel, Number, matching
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray, frozen_array

if TYPE_CHECKING:
    import pinocchio as pin
else:
    pin = LazyModule("pinocchio")

Name = Annotated[
    str, matching(r"[A-Za-z][A-Za-z0-9_]{0,63}", "1 to 64 letters, digits or _, starting with a letter")
]
_POSTURES = 5  # besides the home position
_MAX_DISTANCE_M = 1e-4  # largest distance between the tips of table and URDF
_MAX_ROTATION = 1e-3  # largest difference between elements of two rotation matrices


class DhRow(FileModel):
    """One row of the table."""

    name: Name  # name of the joint, or of the fixed transform
    type: Literal["revolute", "prismatic", "fixed"]  # type of the joint
    theta_rad: Number = 0.0  # turn about the previous z, or its offset for a revolute joint [rad]
    d_m: Number = 0.0  # shift along the previous z, or its offset for a prismatic joint [m]
    a_m: Number = 0.0  # shift along the new x [m]
    alpha_rad: Number = 0.0  # turn about the new x [rad]

    def transform(self, position: float = 0.0) -> "pin.SE3":
        """Compute frame i in frame i-1.

        Args:
            position: position of the joint [rad or m]; ignored for a fixed row.
        """
        theta_rad = self.theta_rad + (position if self.type == "revolute" else 0.0)
        d_m = self.d_m + (position if self.type == "prismatic" else 0.0)
        about_z = pin.SE3(pin.utils.rotate("z", theta_rad), np.array([0.0, 0.0, d_m]))
        return about_z * pin.SE3(pin.utils.rotate("x", self.alpha_rad), np.array([self.a_m, 0.0, 0.0]))


class DhTable(FileModel):
    """An arm as a table of rows from the world to the tip."""

    name: Name
    rows: Annotated[tuple[DhRow, ...], Field(min_length=1, max_length=64)]

    @model_validator(mode="after")
    def _check_rows(self) -> "DhTable":
        names = [row.name for row in self.rows]
        if len(set(names)) != len(names):
            raise ValueError(f"two rows have the same name: {', '.join(names)}")
        if not self.joint_count:
            raise ValueError("no row is a joint; type is one of revolute, prismatic, fixed")
        return self

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return sum(row.type != "fixed" for row in self.rows)

    def tip_frame(self, position_rad: FloatArray) -> FloatArray:
        """Compute the last frame in the world by forward kinematics, shape (4, 4).

        Args:
            position_rad: joint positions, shape (n,) [rad or m].

        Raises:
            InputError: wrong number of positions.
        """
        positions = iter(frozen_array(position_rad, (self.joint_count,), what="joint positions"))
        frame = pin.SE3.Identity()
        for row in self.rows:
            frame = frame * row.transform(0.0 if row.type == "fixed" else next(positions))
        return np.asarray(frame.homogeneous)


def check_dh_table(robot_file: RobotFile, body: RigidBody) -> None:
    """Compare the tip positions of a robot file's DH table and its URDF; do nothing without a table.

    The tips are compared at the home posture and at postures between the position limits.

    Args:
        robot_file: robot file with the path of the table.
        body: model of the same arm, from its URDF.

    Raises:
        InputError: the table is invalid, or describes another arm.
    """
    if robot_file.dh is None:
        return
    path = robot_file.resolve(robot_file.dh)
    table = DhTable.load(path)
    if table.joint_count != body.joint_count:
        raise InputError(f"{path}: has {table.joint_count} joints, but the URDF has {body.joint_count}")
    low, high = robot_file.limits.position_min_rad, robot_file.limits.position_max_rad
    for position_rad in (np.array(robot_file.home_rad), *np.linspace(low, high, _POSTURES)):
        frame = table.tip_frame(position_rad)
        tip_m, rotation = body.tip_pose(position_rad)
        distance_m = float(np.linalg.norm(frame[:3, 3] - tip_m))
        difference = float(np.abs(frame[:3, :3] - rotation).max())
        if distance_m > _MAX_DISTANCE_M or difference > _MAX_ROTATION:
            what = f"{distance_m * 1e3:.3g} mm from" if distance_m > _MAX_DISTANCE_M else "at an angle to"
            raise InputError(
                f"{path}: at joint positions {np.round(position_rad, 3).tolist()} rad, this table puts the "
                f"tip {what} the URDF's '{robot_file.tip_frame}'; correct the table or the URDF"
            )
