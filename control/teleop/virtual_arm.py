"""The arm that the operator sees: its joints follow the hand, with the tool kept in one direction."""

import math

import numpy as np

from control.arm.inverse_kinematics import PlanarArm
from control.arm.rigid_body import RigidBody
from robot_io.errors import InputError
from robot_io.types import FloatArray


class VirtualArm:
    """Kinematics only: what it weighs the operator need not carry.

    The tool's direction is given in the tip frame and in the world, shape (3,) each. Where the arm begins,
    `home_rad`, shape (3,) [rad], says how its elbow bends.

    Attributes:
        position_rad: joint positions, shape (3,) [rad].
        reached: whether the tip is where the hand is, apart from what lies out of the arm's plane.

    InputError: the arm is not planar, or the direction does not lie in its plane.
    """

    def __init__(
        self, body: RigidBody, tool_axis_tip: FloatArray, direction_world: FloatArray, home_rad: FloatArray
    ) -> None:
        self._body, self._arm = body, PlanarArm(body, tool_axis_tip)
        self._elbow = self._arm.elbow_of(home_rad)
        _, _, self._tool_rad = self._arm.plane_direction(direction_world)
        self.position_rad, self.reached = home_rad.copy(), True

    def follow(self, hand_world_m: FloatArray) -> None:
        """Put the tip where the hand is, shape (3,) [m]; out of reach, stay where it was."""
        u_m, w_m = self._arm.plane_point(hand_world_m)
        try:
            angles = self._arm.absolute_angles(u_m, w_m, self._tool_rad, self._elbow)
        except InputError:
            self.reached = False
            return
        self.reached = True
        joints = zip(self._arm.joint_positions(angles), self.position_rad.tolist(), strict=True)
        self.position_rad = np.array([q + math.tau * round((near - q) / math.tau) for q, near in joints])

    @property
    def tip_world_m(self) -> FloatArray:
        """Where its tip is, shape (3,) [m]."""
        tip, _ = self._body.tip_pose(self.position_rad)
        return tip
