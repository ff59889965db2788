"""Straight line that the tip follows with a constant tool direction."""

import math

import numpy as np

from palpate.control.arm.inverse_kinematics import NEAR_SINGULAR, Elbow, IkSolution, PlanarArm
from palpate.control.paths.trajectory import JointMotion, LineState
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, frozen_array

_REACH_STEP_M = 2e-3


class PressLine:
    """Line in the arm's plane along which an object is pressed.

    Args:
        arm: geometry of the arm.
        start_world_m: tip position at travel 0, shape (3,) [m].
        direction_world: direction of travel and tool, shape (3,); it is normalized.
        elbow: bending direction of the elbow.

    Raises:
        InputError: the start cannot be reached.
    """

    def __init__(
        self, arm: PlanarArm, start_world_m: FloatArray, direction_world: FloatArray, elbow: Elbow
    ) -> None:
        self.start: IkSolution = arm.solve(start_world_m, direction_world, elbow)
        self.start_world_m = frozen_array(start_world_m)
        self.direction_world = frozen_array(direction_world / np.linalg.norm(direction_world))
        self._arm = arm
        self._elbow = elbow
        self._origin = arm.plane_point(start_world_m)
        self._u, self._w, self._tool_rad = arm.plane_direction(direction_world)

    def travel_of(self, tip_position_world_m: FloatArray) -> float:
        """Compute the travel of the point on the line that is nearest to a position [m].

        Args:
            tip_position_world_m: shape (3,) [m].
        """
        return float((tip_position_world_m - self.start_world_m).dot(self.direction_world))

    def point_at(self, travel_m: float) -> FloatArray:
        """Compute the world position at a travel, shape (3,) [m].

        Args:
            travel_m: travel [m].
        """
        return self.start_world_m + travel_m * self.direction_world

    def reach_m(
        self, goal_m: float, near_rad: FloatArray, limits_rad: tuple[FloatArray, FloatArray]
    ) -> float:
        """Compute how far the tip can travel from the start, to within 2 mm [m].

        Args:
            goal_m: farthest travel of interest, negative for a travel backwards [m].
            near_rad: joint positions near the start, shape (3,) [rad].
            limits_rad: lowest and highest joint positions, shape (3,) each [rad].
        """
        steps = math.ceil(abs(goal_m) / _REACH_STEP_M)
        reached_m, positions = 0.0, near_rad.tolist()
        bounds = list(zip(*(limit.tolist() for limit in limits_rad), strict=True))
        for step in range(1, steps + 1):
            travel_m = goal_m * step / steps
            try:
                angles = self._angles(travel_m)
            except InputError:
                break
            positions = self._positions(angles, positions)
            is_within = all(low <= q <= high for q, (low, high) in zip(positions, bounds, strict=True))
            if not is_within or abs(math.sin(angles[1] - angles[0])) < NEAR_SINGULAR:
                break
            reached_m = travel_m
        return reached_m

    def joint_motion(self, state: LineState, near_rad: FloatArray) -> JointMotion:
        """Compute the joint motion for a motion along the line.

        Args:
            state: motion along the line.
            near_rad: joint positions that select the turn of each joint, shape (3,) [rad].

        Raises:
            InputError: out of reach, or singular.
        """
        angles = a1, a2, _ = self._angles(state.travel_m)
        first_m, second_m, _ = self._arm.lengths_m
        x1, y1 = first_m * math.cos(a1), first_m * math.sin(a1)
        x2, y2 = second_m * math.cos(a2), second_m * math.sin(a2)
        determinant = x1 * y2 - x2 * y1
        if abs(determinant) < 1e-6 * first_m * second_m:
            raise InputError("target is singular, because the first two links are collinear")
        # The third link keeps its direction: tip velocity = sum of rate_i (-y_i, x_i), i = 1, 2.
        vu, vw = self._u * state.speed_m_s, self._w * state.speed_m_s
        rate1 = (vu * x2 + vw * y2) / determinant
        rate2 = -(vu * x1 + vw * y1) / determinant
        # Tip acceleration = sum of spin_i (-y_i, x_i) - rate_i^2 (x_i, y_i).
        au = self._u * state.acceleration_m_s2 + rate1**2 * x1 + rate2**2 * x2
        aw = self._w * state.acceleration_m_s2 + rate1**2 * y1 + rate2**2 * y2
        spin1 = (au * x2 + aw * y2) / determinant
        spin2 = -(au * x1 + aw * y1) / determinant
        return JointMotion(
            np.array(self._positions(angles, near_rad.tolist())),
            self._per_joint(rate1, rate2),
            self._per_joint(spin1, spin2),
        )

    def _angles(self, travel_m: float) -> tuple[float, float, float]:
        u_m, w_m = self._origin[0] + travel_m * self._u, self._origin[1] + travel_m * self._w
        return self._arm.absolute_angles(u_m, w_m, self._tool_rad, self._elbow)

    def _positions(self, angles: tuple[float, float, float], near_rad: list[float]) -> list[float]:
        """Joint positions [rad] from the links' absolute angles, each in the turn nearest to `near_rad`."""
        positions = zip(self._arm.joint_positions(angles), near_rad, strict=True)
        return [q + math.tau * round((near - q) / math.tau) for q, near in positions]

    def _per_joint(self, first: float, second: float) -> FloatArray:
        """Rates of the joints from absolute rates of the first two links, the third standing still."""
        s1, s2, s3 = self._arm.signs
        return np.array((s1 * first, s2 * (second - first), -s3 * second))
