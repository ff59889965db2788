"""The arm that the operator sees: its joints follow the hand, with the tool kept in one direction."""

import math

import numpy as np

from palpate.control.arm.inverse_kinematics import PlanarArm
from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray


class VirtualArm:
    """Kinematic arm without mass.

    Args:
        body: model of the arm.
        tool_axis_tip: direction of the tool, tip frame, shape (3,).
        direction_world: direction of the tool, world frame, shape (3,).
        home_rad: joint positions at the start, shape (3,) [rad]; they decide how the elbow bends.

    Attributes:
        position_rad: joint positions, shape (3,) [rad].
        reached: whether the tip is where the hand is, within the arm's plane.

    Raises:
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
        """Put the tip where the hand is; out of reach, stay.

        Args:
            hand_world_m: shape (3,) [m].
        """
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
        """Tip position, shape (3,) [m]."""
        tip, _ = self._body.tip_pose(self.position_rad)
        return tip
