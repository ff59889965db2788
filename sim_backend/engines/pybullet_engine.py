"""Engine with PyBullet, with its unexpected defaults disabled."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from weakref import finalize

import numpy as np

from palpate.robot_io.capture_output import STDERR, STDOUT, capture_output
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray
from palpate.sim_backend.contact_laws.standard import EngineContact
from palpate.sim_backend.engines.engine import Engine, Joints, Quaternion, Vector, check_serial

with capture_output([], STDERR):  # hides the engine's greeting
    import pybullet as bullet

_NO_SPEED_LIMIT = 1e6  # the engine would cut joint speeds at 100 rad/s
_RIGID_N_M = 1e18  # the engine combines both bodies' stiffness in series, and adds their damping
_HALF_WIDTH_M = 2.0  # half width of the surface's box
_HALF_HEIGHT_M = 0.5


class PyBulletEngine(Engine):
    """See `Engine`."""

    name = "pybullet"

    def __init__(
        self, urdf_text: str, tip_frame: str, *, step_s: float, gravity_m_s2: Sequence[float]
    ) -> None:
        self._client: int = bullet.connect(bullet.DIRECT)
        self._end = finalize(self, _disconnect, self._client)  # an unclosed engine would keep its 28 MB
        self._end.atexit = False
        try:
            self._load(urdf_text, tip_frame)
        except InputError:
            self.close()
            raise
        self._box: int | None = None
        for link in range(-1, bullet.getNumJoints(self._body, self._client)):
            bullet.changeDynamics(
                self._body,
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
        # A loaded joint has a velocity motor that brakes it; a motor without force is off.
        self._zeros = [0.0] * len(self._joints)
        self.brake(self._zeros)
        bullet.setGravity(*gravity_m_s2, self._client)
        bullet.setPhysicsEngineParameter(fixedTimeStep=step_s, contactSlop=0.0, physicsClientId=self._client)

    def _load(self, urdf_text: str, tip_frame: str) -> None:
        self._body = body = _load(self._client, urdf_text)
        links = bullet.getNumJoints(body, self._client)
        infos = [bullet.getJointInfo(body, i, self._client) for i in range(links)]
        movable = [info for info in infos if info[2] != bullet.JOINT_FIXED]
        self._joints = [info[0] for info in movable]
        self._tip = next((info[0] for info in infos if info[12].decode() == tip_frame), -1)
        tip = self._tip
        names = []
        while tip >= 0:
            names.append(str(infos[tip][1], "utf-8"))
            tip = infos[tip][16]
        check_serial([info[1].decode() for info in movable], names)
        self.torque_limit_nm = [info[10] or np.inf for info in movable]

    def place(self, position_rad: Joints, velocity_rad_s: Joints) -> None:
        for joint, q, qd in zip(self._joints, position_rad, velocity_rad_s, strict=True):
            bullet.resetJointState(self._body, joint, q, qd, self._client)

    def joint_state(self) -> list[float]:
        states = bullet.getJointStates(self._body, self._joints, self._client)
        return [state[0] for state in states] + [state[1] for state in states]

    def tip_state(self) -> tuple[Vector, Vector, Quaternion]:
        # Without recomputation the engine would return the state of the previous step.
        state = bullet.getLinkState(self._body, self._tip, 1, 1, self._client)
        return state[4], state[6], state[5]

    def push(self, torque_nm: Joints, tip_force_z_n: float, tip_position_m: Sequence[float]) -> None:
        # Keyword arguments would double the time of this call. In this mode PyBullet ignores the zeros.
        body, joints, mode, zeros = self._body, self._joints, bullet.TORQUE_CONTROL, self._zeros
        bullet.setJointMotorControlArray(
            body, joints, mode, zeros, zeros, torque_nm, zeros, zeros, self._client
        )
        if tip_force_z_n:
            force = [0.0, 0.0, tip_force_z_n]
            bullet.applyExternalForce(
                self._body, self._tip, force, tip_position_m, bullet.WORLD_FRAME, self._client
            )

    def brake(self, friction_nm: Joints) -> None:
        # A velocity motor with target zero and limited torque acts as dry friction.
        bullet.setJointMotorControlArray(
            self._body,
            self._joints,
            bullet.VELOCITY_CONTROL,
            forces=friction_nm,
            physicsClientId=self._client,
        )

    def mass_matrix(self, position_rad: Joints) -> FloatArray:
        matrix = bullet.calculateMassMatrix(self._body, list(position_rad), physicsClientId=self._client)
        return np.array(matrix)

    def inverse_dynamics(
        self, position_rad: Joints, velocity_rad_s: Joints, acceleration_rad_s2: Joints
    ) -> FloatArray:
        # PyBullet crashes on arrays here; it accepts lists.
        lists = [list(values) for values in (position_rad, velocity_rad_s, acceleration_rad_s2)]
        return np.array(bullet.calculateInverseDynamics(self._body, *lists, physicsClientId=self._client))

    def step(self) -> None:
        bullet.stepSimulation(self._client)

    def set_surface(self, contact: EngineContact | None, height_m: float) -> None:
        if self._box is not None:
            bullet.removeBody(self._box, self._client)
            self._box = None
        if contact is None:
            return
        half_extents = [_HALF_WIDTH_M, _HALF_WIDTH_M, _HALF_HEIGHT_M]
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=half_extents, physicsClientId=self._client
        )
        center = [0.0, 0.0, height_m - _HALF_HEIGHT_M]
        self._box = bullet.createMultiBody(0.0, shape, basePosition=center, physicsClientId=self._client)
        bullet.changeDynamics(
            self._box,
            -1,
            contactStiffness=contact.stiffness_n_m,
            contactDamping=contact.damping_n_s_m,
            lateralFriction=0.0,
            restitution=0.0,
            physicsClientId=self._client,
        )

    def surface_force_n(self) -> float:
        if self._box is None:
            return 0.0
        points = bullet.getContactPoints(self._body, self._box, physicsClientId=self._client)
        return float(sum(point[9] for point in points))

    def close(self) -> None:
        self._end()


def _disconnect(client: int) -> None:
    if bullet.isConnected(client):
        bullet.disconnect(client)


def _load(client: int, text: str) -> int:
    with tempfile.TemporaryDirectory(prefix="palpate-") as folder:
        path = Path(folder) / "arm.urdf"  # PyBullet reads URDF from files only
        path.write_text(text, encoding="utf-8")
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        output: list[str] = []
        try:
            with capture_output(output, STDOUT):
                body: int = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
        except bullet.error as error:
            reason = " ".join(line for line in output if not line.startswith("b3")) or str(error)
            raise InputError(f"URDF: PyBullet cannot load it ({reason})") from error
    return body
