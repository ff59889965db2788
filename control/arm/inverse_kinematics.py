"""Closed-form inverse kinematics of a planar arm with three revolute joints of parallel axes.

In the arm's plane, with u any direction in it, n the first joint's axis and w = n x u, the links of lengths
L1, L2, L3 lie at the absolute angles a1, a2, a3 (positive about n):

    tip = shoulder + sum_i L_i (cos a_i, sin a_i),    a_i = rest_i + sum_{j<=i} sign_j q_j

The tool's direction fixes a3, so the wrist is known, and two links reach it with the elbow bent either way.
Siciliano et al., "Robotics", Springer 2009, section 2.12.1.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, clip, frozen_array

NEAR_SINGULAR = math.sin(math.radians(3.0))
_PARALLEL = 1e-6
_ROUNDING = 1e-9


class Elbow(IntEnum):
    """Bending direction of the elbow: sign of the angle from link 1 to link 2, about the axis of joint 1."""

    NEGATIVE = -1
    POSITIVE = 1


@dataclass(frozen=True, slots=True)
class IkSolution:
    """One joint configuration that reaches a target."""

    position_rad: FloatArray  # joint positions, shape (3,) within +-pi each [rad]
    elbow_sine: float  # |sin| of the angle between the first two links; 0 is singular, 1 is best

    @property
    def near_singular(self) -> bool:
        """Whether the first two links are within 3 degrees of a straight line; joint speeds grow there."""
        return self.elbow_sine < NEAR_SINGULAR


class PlanarArm:
    """Geometry of a planar arm, and its inverse kinematics for tip position and tool direction.

    Args:
        body: model of the arm.
        tool_axis_tip: direction of the tool in the tip frame, shape (3,).

    Raises:
        InputError: the arm does not have three revolute joints with parallel axes, or the tool is not in its
            plane.
    """

    def __init__(self, body: RigidBody, tool_axis_tip: FloatArray) -> None:
        joints = body.joint_axes()
        if len(joints) != 3 or not all(joint.revolute for joint in joints):
            kinds = ", ".join("revolute" if joint.revolute else "prismatic" for joint in joints)
            raise InputError(f"closed-form kinematics needs 3 revolute joints; this arm has: {kinds}")
        normal = joints[0].axis_world
        for joint in joints[1:]:
            if np.linalg.norm(np.cross(normal, joint.axis_world)) > _PARALLEL:
                raise InputError(
                    f"closed-form kinematics: the axis of '{joint.name}' is not parallel to that of "
                    f"'{joints[0].name}'"
                )
        self.signs = (1.0, *(math.copysign(1.0, normal @ joint.axis_world) for joint in joints[1:]))
        # If possible, u is horizontal: world x for an arm that moves in the x-z plane.
        guide = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        u_axis = guide - (guide @ normal) * normal
        self._normal, self._u_axis = normal, u_axis / np.linalg.norm(u_axis)
        self._w_axis = np.cross(normal, self._u_axis)
        tip, rotation = body.tip_pose(np.zeros(3))
        points = [self.plane_point(point) for point in (*(joint.origin_world_m for joint in joints), tip)]
        links = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(points)]
        self._shoulder = points[0]
        self._out_of_plane_m = float(tip @ normal)
        self.lengths_m: tuple[float, float, float] = tuple(math.hypot(*link) for link in links)  # type: ignore[assignment]
        self._rest = tuple(math.atan2(link[1], link[0]) for link in links)
        if min(self.lengths_m[:2]) < 1e-6:
            raise InputError(f"link lengths {self.lengths_m} m: the first two must be above 0")
        self._tool_rest = self._plane_angle(rotation @ frozen_array(tool_axis_tip, (3,), what="tool axis"))

    def solve(
        self, tip_position_world_m: FloatArray, tool_direction_world: FloatArray, elbow: Elbow
    ) -> IkSolution:
        """Compute joint positions for a tip position and a tool direction, and how singular they are.

        Args:
            tip_position_world_m: shape (3,) [m].
            tool_direction_world: shape (3,), of any length.
            elbow: bending direction of the elbow.

        Raises:
            InputError: the point cannot be reached, or point or direction are outside the plane.
        """
        tip = frozen_array(tip_position_world_m, (3,), what="tip position")
        offset_m = float(tip @ self._normal) - self._out_of_plane_m
        if abs(offset_m) > 1e-6:
            raise InputError(f"target {_text(tip)} m lies {offset_m * 1e3:.3g} mm out of the arm's plane")
        tool = self._plane_angle(frozen_array(tool_direction_world, (3,), what="tool direction"))
        angles = self.absolute_angles(*self.plane_point(tip), tool, elbow)
        positions = np.array(self.joint_positions(angles))
        positions = (positions + math.pi) % (2.0 * math.pi) - math.pi
        return IkSolution(positions, abs(math.sin(angles[1] - angles[0])))

    def elbow_of(self, position_rad: FloatArray) -> Elbow:
        """Determine which way the elbow is bent; straight counts as positive.

        Args:
            position_rad: joint positions, shape (3,) [rad].
        """
        turn = self._rest[1] - self._rest[0] + self.signs[1] * float(position_rad[1])
        return Elbow.POSITIVE if math.sin(turn) >= 0.0 else Elbow.NEGATIVE

    def absolute_angles(
        self, u_m: float, w_m: float, tool_rad: float, elbow: Elbow
    ) -> tuple[float, float, float]:
        """Compute the links' absolute angles a1, a2, a3 for a tip position in the plane [rad].

        Args:
            u_m: first coordinate of the tip in the plane [m].
            w_m: second coordinate [m].
            tool_rad: angle of the tool [rad].
            elbow: bending direction of the elbow.

        Raises:
            InputError: the wrist is out of reach.
        """
        first_m, second_m, third_m = self.lengths_m
        third = self._rest[2] + tool_rad - self._tool_rest
        wrist_u = u_m - self._shoulder[0] - third_m * math.cos(third)
        wrist_w = w_m - self._shoulder[1] - third_m * math.sin(third)
        distance_m = math.hypot(wrist_u, wrist_w)
        cosine = (distance_m**2 - first_m**2 - second_m**2) / (2.0 * first_m * second_m)
        if not abs(cosine) <= 1.0 + _ROUNDING:
            raise InputError(
                f"target out of reach: with this tool direction, the wrist is {distance_m:.4f} m from the "
                f"shoulder, but the arm reaches {abs(first_m - second_m):.4f} to {first_m + second_m:.4f} m"
            )
        bend = elbow * math.acos(clip(cosine, -1.0, 1.0))
        first = math.atan2(wrist_w, wrist_u) - math.atan2(
            second_m * math.sin(bend), first_m + second_m * math.cos(bend)
        )
        return first, first + bend, third

    def joint_positions(self, angles_rad: tuple[float, float, float]) -> tuple[float, float, float]:
        """Convert the links' absolute angles to joint positions, not wrapped [rad].

        Args:
            angles_rad: a1, a2, a3 [rad].
        """
        a1, a2, a3 = angles_rad
        rest1, rest2, rest3 = self._rest
        s1, s2, s3 = self.signs
        first, second = a1 - rest1, a2 - rest2
        return s1 * first, s2 * (second - first), s3 * (a3 - rest3 - second)

    def tips_in_plane(self, position_rad: FloatArray) -> FloatArray:
        """Compute tip coordinates (u, w) of many postures, shape (k, 2) [m].

        Args:
            position_rad: joint positions, shape (k, 3) [rad].
        """
        angles = np.cumsum(position_rad * self.signs, axis=1) + self._rest
        lengths_m = np.array(self.lengths_m)
        from_shoulder_m = np.column_stack((np.cos(angles) @ lengths_m, np.sin(angles) @ lengths_m))
        return from_shoulder_m + self._shoulder

    def plane_direction(self, direction_world: FloatArray) -> tuple[float, float, float]:
        """Project a world direction onto the plane: unit coordinates u and w, and the angle [rad].

        Args:
            direction_world: shape (3,); must lie in the plane.

        Raises:
            InputError: the direction does not lie in the plane.
        """
        angle = self._plane_angle(direction_world)
        return math.cos(angle), math.sin(angle), angle

    def plane_point(self, point_world_m: FloatArray) -> tuple[float, float]:
        """Project a world point onto the plane: coordinates u and w [m].

        Args:
            point_world_m: shape (3,) [m].
        """
        return float(point_world_m @ self._u_axis), float(point_world_m @ self._w_axis)

    def _plane_angle(self, direction_world: FloatArray) -> float:
        length = float(np.linalg.norm(direction_world))
        if length == 0.0 or abs(float(direction_world @ self._normal)) > 1e-6 * length:
            raise InputError(f"direction {_text(direction_world)} does not lie in the arm's plane")
        u, w = self.plane_point(direction_world)
        return math.atan2(w, u)


def _text(vector: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in vector) + ")"
