"""Holds a robot file's DH table against its URDF: two descriptions of one arm must not disagree."""

import numpy as np

from control.arm.dh import load_dh_table
from control.arm.rigid_body import RigidBody
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile

_POSTURES = 5  # besides the home position
_APART_M = 1e-4
_TURNED = 1e-3  # largest difference of two rotation matrices


def check_dh_table(robot_file: RobotFile, body: RigidBody) -> None:
    """Compare where both put the tip, at home and on the way between the position limits.

    Args:
        robot_file: its DH table, if it names one.
        body: of its URDF.

    Raises:
        InputError: the table is not valid, or is that of another arm.
    """
    if robot_file.dh is None:
        return
    path = robot_file.resolve(robot_file.dh)
    table = load_dh_table(path)
    if table.joint_count != body.joint_count:
        raise InputError(f"{path}: has {table.joint_count} joints, the URDF has {body.joint_count}")
    low, high = robot_file.limits.position_min_rad, robot_file.limits.position_max_rad
    for position_rad in (np.array(robot_file.home_rad), *np.linspace(low, high, _POSTURES)):
        frame = table.tip_frame(position_rad)
        tip_m, rotation = body.tip_pose(position_rad)
        apart_m = float(np.linalg.norm(frame[:3, 3] - tip_m))
        turned = float(np.abs(frame[:3, :3] - rotation).max())
        if apart_m > _APART_M or turned > _TURNED:
            what = f"{apart_m * 1e3:.3g} mm from" if apart_m > _APART_M else "turned against"
            raise InputError(
                f"{path}: at joint positions {np.round(position_rad, 3).tolist()} rad it puts the tip {what} "
                f"where the URDF puts '{robot_file.tip_frame}'; correct one of them"
            )
