"""Virtual object for the operator: a half space with any force law, which can change during contact.

The object only pushes, along the outward normal of its surface. Two rules hold for any law and any changes of
it, so the law itself need not be passive:

1. **Energy.** With E the work that the tip has done on the object since touch (exact for a force that is held
   from one step to the next) and x the depth, the force is at most

       F <= p (E + E_r) / x,   p = 4

   The best that a tip can then get back on its way out is dE/dx = p (E + E_r) / x, so E + E_r falls as x^p
   and never below zero: no contact returns more than the reserve E_r above what was put in. A law F ~ x^n
   stores F x / (n + 1), so the rule does not touch one with n <= 3 that is left unchanged, nor, at rest, one
   whose stiffness is raised by up to p / (n + 1); after more the full force comes with the next touch.
   It is a passivity observer (Hannaford and Ryu, IEEE T-RA 18(1), 2002) whose limit acts before the energy
   is spent, and so without that controller's sudden drop of force; model updates as the source of energy:
   Willaert et al., "Stability of model-mediated teleoperation: discussion and experiments", EuroHaptics 2012.
2. **Continuity.** A new law takes over from the present force: the difference fades by at most
   `largest_jump_n` a step. A surface that moves during contact does so at 10 mm/s.

Pure: no clock, no device. One step takes a few microseconds.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palpate.control.arm.inverse_kinematics import PlanarArm
from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, clip, frozen_array

# force_n = law(depth_m, rate_m_s, dt_s): compression positive, 0 for depth <= 0. It is called once in each
# step, with and without contact, so that a law may have memory.
ForceLaw = Callable[[float, float, float], float]

FORCE_LIMIT_N = 50.0  # largest force
# E_r, energy that one contact may return beyond its input; k q^2 / 4 lets an encoder of step q [m] begin to
# press on stiffness k [N/m].
RESERVE_J = 1e-4
_SURFACE_SPEED_M_S = 0.01  # speed of the surface to a new position during contact
_ENERGY_EXPONENT = 4.0  # p: laws up to depth^3 are rendered unchanged
_ENERGY_STEPS = 2.0  # number of steps of a retracting tip for which the energy must last


class RenderedForce(NamedTuple):
    """Result of one step of the virtual object."""

    force_world_n: FloatArray  # force on the tip, shape (3,) [N]
    force_n: float  # force along the normal, positive in compression [N]
    depth_m: float  # depth of the tip below the surface; negative above it [m]
    energy_j: float  # energy input by the tip since touch, from the rendered forces [J]
    withheld_n: float  # reduction of the law's force by the two rules [N]


class VirtualObject:
    """Half space with a force law that can be replaced at any time.

    Args:
        law: the force law.
        point_world_m: any point of the undeformed surface, shape (3,) [m].
        normal_world: outward normal, shape (3,); it is normalized.
        largest_jump_n: largest change of force by an update in one step, positive [N].

    Raises:
        InputError: the normal is zero, or a value is not finite.
    """

    def __init__(
        self, law: ForceLaw, point_world_m: FloatArray, normal_world: FloatArray, largest_jump_n: float = 0.05
    ) -> None:
        normal = frozen_array(normal_world, (3,), what="normal of the surface")
        length = math.sqrt(float(normal.dot(normal)))
        if length == 0.0:
            raise InputError("normal of the surface: must not be zero")
        self._normal = normal / length
        self._law = law
        self._height_m = self._next_height_m = self._along_normal(point_world_m)
        self._jump_n = largest_jump_n
        self._tip_m = math.nan  # tip position along the normal in the last step
        self._force_n = self._energy_j = self._fading_n = 0.0
        self._updated = False

    def update(self, law: ForceLaw, point_world_m: FloatArray) -> None:
        """Render another law from the next step on.

        Args:
            law: force law.
            point_world_m: a point of the new surface, shape (3,) [m].

        Raises:
            InputError: the point is not finite.
        """
        self._next_height_m = self._along_normal(point_world_m)
        self._law = law
        self._updated = True

    def step(
        self, tip_position_world_m: FloatArray, tip_velocity_world_m_s: FloatArray, dt_s: float
    ) -> RenderedForce:
        """Compute the force that the tip feels until the next step, with depth and energy.

        Args:
            tip_position_world_m: shape (3,) [m].
            tip_velocity_world_m_s: shape (3,) [m/s].
            dt_s: time until the next step [s].
        """
        tip_m = float(self._normal.dot(tip_position_world_m))
        rate_m_s = -float(self._normal.dot(tip_velocity_world_m_s))
        # A surface without contact moves at once; with contact it moves at a limited speed.
        if tip_m >= max(self._height_m, self._next_height_m):
            self._height_m = self._next_height_m
        max_motion_m = _SURFACE_SPEED_M_S * dt_s
        self._height_m += clip(self._next_height_m - self._height_m, -max_motion_m, max_motion_m)
        depth_m = self._height_m - tip_m
        law_n = self._law(depth_m, rate_m_s, dt_s)
        if depth_m > 0.0:
            if self._force_n > 0.0:
                self._energy_j += self._force_n * (self._tip_m - tip_m)
            if self._updated:
                self._fading_n = self._force_n - law_n  # difference to the former law's force
            self._fading_n -= clip(self._fading_n, -self._jump_n, self._jump_n)
            distance_m = max(depth_m / _ENERGY_EXPONENT, -_ENERGY_STEPS * rate_m_s * dt_s)
            energy_limit_n = max(0.0, RESERVE_J + self._energy_j) / distance_m
            self._force_n = min(max(0.0, law_n + self._fading_n), energy_limit_n, FORCE_LIMIT_N)
        else:
            self._force_n = self._energy_j = self._fading_n = law_n = 0.0
        self._tip_m, self._updated = tip_m, False
        force_world_n = self._normal * self._force_n
        return RenderedForce(force_world_n, self._force_n, depth_m, self._energy_j, law_n - self._force_n)

    def _along_normal(self, point_world_m: FloatArray) -> float:
        return float(self._normal.dot(frozen_array(point_world_m, (3,), what="point of the surface")))


class VirtualArm:
    """Kinematic arm without mass.

    Args:
        body: model of the arm.
        tool_axis_tip: direction of the tool, tip frame, shape (3,).
        direction_world: direction of the tool, world frame, shape (3,).
        home_rad: initial joint positions, shape (3,) [rad]; they determine the elbow's bending direction.

    Attributes:
        position_rad: joint positions, shape (3,) [rad].
        reached: whether the tip is at the hand's position in the arm's plane.

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
        """Move the tip to the hand's position; if it is out of reach, do not move.

        Args:
            hand_world_m: position of the hand, shape (3,) [m].
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
