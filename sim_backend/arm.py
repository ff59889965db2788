"""One serial arm in PyBullet: loading it without the engine's surprises, and what is asked of it."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robot_io.errors import InputError
from robot_io.types import FloatArray, frozen_array
from sim_backend.bullet import STDOUT, bullet, captured
from sim_backend.dynamics_urdf import dynamics_urdf

_NO_SPEED_LIMIT = 1e6  # the engine would cut joint speeds at 100 rad/s
_RIGID_N_M = 1e18  # the engine puts the stiffness of both bodies in series, and adds their damping


Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # (x, y, z, w)


class SimulatedArm:
    """A serial arm with its base fixed at the world's origin, moved by joint torques and a force at the tip.

    Kinematics and dynamics are PyBullet's own: any serial arm of revolute and prismatic joints works.

    Args:
        client: PyBullet client to load it into.
        urdf_text: the robot's URDF.
        tip_frame: URDF link at the contact point.
        mass_scale: factor on all masses and inertias [-].
        tip_radius_m: radius of the sphere behind the tip [m]; only the engine's own contact feels it.
        sensor_axis_tip: unit vector in the tip frame in which the tool pushes.

    Raises:
        InputError: the URDF cannot be loaded, or is not a serial arm that ends at the tip frame.

    Attributes:
        body: PyBullet's number of the arm.
        torque_limit_nm: largest torque of each drive, the URDF's effort limits (n) [N m].
    """

    def __init__(
        self,
        client: int,
        urdf_text: str,
        tip_frame: str,
        *,
        mass_scale: float,
        tip_radius_m: float,
        sensor_axis_tip: Sequence[float],
    ) -> None:
        self._client = client
        text = dynamics_urdf(
            urdf_text,
            tip_frame,
            mass_scale=mass_scale,
            tip_radius_m=tip_radius_m,
            sensor_axis_tip=sensor_axis_tip,
        )
        self.body = _load(client, text)
        infos = [
            bullet.getJointInfo(self.body, i, client) for i in range(bullet.getNumJoints(self.body, client))
        ]
        movable = [info for info in infos if info[2] != bullet.JOINT_FIXED]
        self._joints = [info[0] for info in movable]
        self._tip = next((info[0] for info in infos if info[12].decode() == tip_frame), -1)
        _check_serial(infos, self._tip, self._joints)
        self.torque_limit_nm = [info[10] or np.inf for info in movable]
        self._remove_losses()

    def _remove_losses(self) -> None:
        for link in range(-1, bullet.getNumJoints(self.body, self._client)):
            bullet.changeDynamics(
                self.body,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                lateralFriction=0.0,
                contactStiffness=_RIGID_N_M,
                contactDamping=0.0,
                maxJointVelocity=_NO_SPEED_LIMIT,
                physicsClientId=self._client,
            )
        # A loaded joint comes with a velocity motor that brakes it; a motor without force is off.
        zeros = [0.0] * len(self._joints)
        bullet.setJointMotorControlArray(
            self.body, self._joints, bullet.VELOCITY_CONTROL, forces=zeros, physicsClientId=self._client
        )

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self._joints)

    def place(self, position_rad: ArrayLike, velocity_rad_s: ArrayLike | None = None) -> None:
        """Put the joints at `position_rad` (n) with `velocity_rad_s` (n), at rest if None.

        InputError: wrong number of joints.
        """
        shape = (self.joint_count,)
        position = frozen_array(position_rad, shape, what="joint position")
        speed = (
            np.zeros(shape)
            if velocity_rad_s is None
            else frozen_array(velocity_rad_s, shape, what="joint velocity")
        )
        for joint, q, qd in zip(self._joints, position.tolist(), speed.tolist(), strict=True):
            bullet.resetJointState(self.body, joint, q, qd, self._client)

    def joint_state(self) -> list[float]:
        """The n positions [rad] followed by the n velocities [rad/s]."""
        states = bullet.getJointStates(self.body, self._joints, self._client)
        return [state[0] for state in states] + [state[1] for state in states]

    def tip_state(self) -> tuple[Vector, Vector, Quaternion]:
        """Position [m], velocity [m/s] and orientation of the tip frame in the world.

        It is of the present state; without recomputing it the engine would show the one a step before.
        """
        state = bullet.getLinkState(self.body, self._tip, 1, 1, self._client)
        return state[4], state[6], state[5]

    def push(self, torque_nm: Sequence[float], tip_force_z_n: float, tip_position_m: Sequence[float]) -> None:
        """Apply torques (n) along the joint axes and an upward force at the tip for the next step only."""
        bullet.setJointMotorControlArray(
            self.body, self._joints, bullet.TORQUE_CONTROL, forces=torque_nm, physicsClientId=self._client
        )
        if tip_force_z_n:
            force = [0.0, 0.0, tip_force_z_n]
            bullet.applyExternalForce(
                self.body, self._tip, force, tip_position_m, bullet.WORLD_FRAME, self._client
            )

    def brake(self, friction_nm: Sequence[float]) -> None:
        """Resist the joints' motion with at most these torques (n) [N m], from the next step on.

        A velocity motor towards zero of limited torque is dry friction: the engine solves for it with the
        motion, and its torque is the limit while the joint moves and what is needed while it stands.
        """
        bullet.setJointMotorControlArray(
            self.body, self._joints, bullet.VELOCITY_CONTROL, forces=friction_nm, physicsClientId=self._client
        )

    def mass_matrix(self, position_rad: Sequence[float]) -> FloatArray:
        """Joint-space inertia (n, n) [kg m^2] at n positions [rad]."""
        matrix = bullet.calculateMassMatrix(self.body, list(position_rad), physicsClientId=self._client)
        return np.array(matrix)

    def inverse_dynamics(
        self, position_rad: ArrayLike, velocity_rad_s: ArrayLike, acceleration_rad_s2: ArrayLike
    ) -> FloatArray:
        """Torques (n) [N m] for a motion in free air, by PyBullet's recursive Newton-Euler.

        Args:
            position_rad: (n) [rad].
            velocity_rad_s: (n) [rad/s].
            acceleration_rad_s2: (n) [rad/s^2].

        Raises:
            InputError: wrong number of joints.
        """
        shape = (self.joint_count,)
        motion = (position_rad, velocity_rad_s, acceleration_rad_s2)
        # PyBullet crashes on arrays here; it takes lists.
        lists = [frozen_array(values, shape, what="joint motion").tolist() for values in motion]
        return np.array(bullet.calculateInverseDynamics(self.body, *lists, physicsClientId=self._client))


def _load(client: int, text: str) -> int:
    with tempfile.TemporaryDirectory(prefix="palpate-") as folder:
        path = Path(folder) / "arm.urdf"  # PyBullet reads URDF from files only
        path.write_text(text, encoding="utf-8")
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        said: list[str] = []
        try:
            with captured(STDOUT, said):
                body: int = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
        except bullet.error as error:
            reason = " ".join(line for line in said if not line.startswith("b3")) or str(error)
            raise InputError(f"URDF: PyBullet cannot load it ({reason})") from error
    return body


def _check_serial(infos: Sequence[Sequence[Any]], tip: int, joints: Sequence[int]) -> None:
    on_the_way = set()
    link = tip
    while link >= 0:
        on_the_way.add(link)
        link = infos[link][16]
    aside = [str(infos[joint][1], "utf-8") for joint in joints if joint not in on_the_way]
    if aside or not joints:
        names = ", ".join(aside) or "(the arm has none)"
        raise InputError(f"URDF: not a serial arm; joints that do not move the tip: {names}")
