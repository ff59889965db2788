"""Engine with MuJoCo, in which the object's force and all torques are applied as generalized forces."""

from collections.abc import Sequence

import mujoco
import numpy as np

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray
from palpate.sim_backend.engines.engine import Engine, Joints, Quaternion, check_serial

# Friction and stops are soft constraints here; this is the hardest setting (2 steps, 1 part in 1e4).
_STEPS_TO_STOP = 2.0
_HARD = [0.9999, 0.9999, 0.001, 0.5, 2.0]
_FRAME = mujoco.mjtObj.mjOBJ_XBODY

mujoco.set_mju_user_warning(lambda text: None)  # it would write MUJOCO_LOG.TXT into the working directory


class MujocoEngine(Engine):
    """See `Engine`. Joint damping, armature and friction of the URDF are off, as in PyBullet."""

    name = "mujoco"

    def __init__(
        self, urdf_text: str, tip_frame: str, *, step_s: float, gravity_m_s2: Sequence[float]
    ) -> None:
        try:
            specification = mujoco.MjSpec.from_string(urdf_text)
            specification.compiler.fusestatic = False  # else the tip frame would be merged into its link
            self._model = model = specification.compile()
        except ValueError as error:
            raise InputError(f"URDF: MuJoCo cannot load it ({' '.join(str(error).split())})") from error
        model.opt.timestep = step_s
        model.opt.gravity[:] = gravity_m_s2
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
        for losses in (model.dof_damping, model.dof_armature, model.dof_frictionloss, model.jnt_stiffness):
            losses[:] = 0.0
        model.jnt_solref[:] = model.dof_solref[:] = (_STEPS_TO_STOP * step_s, 1.0)
        model.jnt_solimp[:] = model.dof_solimp[:] = _HARD
        self._tip = int(model.body(tip_frame).id)
        body, names = self._tip, []
        while body > 0:
            first = self._model.body_jntadr[body]
            names += [self._model.joint(first + i).name for i in range(self._model.body_jntnum[body])]
            body = self._model.body_parentid[body]
        check_serial([model.joint(i).name for i in range(model.njnt)], names)
        effort = zip(model.jnt_actfrclimited, model.jnt_actfrcrange[:, 1], strict=True)
        self.torque_limit_nm = [float(limit) if limited else np.inf for limited, limit in effort]
        self._data = data = mujoco.MjData(model)
        self._aside = mujoco.MjData(model)  # for computations in other states
        # Views of the engine's memory, kept because creating a view takes as long as reading it.
        self._position, self._velocity, self._applied = data.qpos, data.qvel, data.qfrc_applied
        self._tip_position, self._tip_quaternion = data.xpos[self._tip], data.xquat[self._tip]
        self._tip_velocity = np.zeros(6)
        self._force_world_n = np.zeros(3)
        self._no_torque = np.zeros(3)
        self._update_views()

    def place(self, position_rad: Joints, velocity_rad_s: Joints) -> None:
        self._data.qpos[:] = position_rad
        self._data.qvel[:] = velocity_rad_s
        self._data.qacc_warmstart[:] = 0.0
        self._update_views()

    def joint_state(self) -> list[float]:
        positions: list[float] = self._position.tolist()
        velocities: list[float] = self._velocity.tolist()
        return positions + velocities

    def tip_state(self) -> tuple[Sequence[float], Sequence[float], Quaternion]:
        velocity = self._tip_velocity
        mujoco.mj_objectVelocity(self._model, self._data, _FRAME, self._tip, velocity, 0)
        w, x, y, z = self._tip_quaternion.tolist()
        return self._tip_position.tolist(), velocity.tolist()[3:], (x, y, z, w)

    def push(self, torque_nm: Joints, tip_force_z_n: float, tip_position_m: Sequence[float]) -> None:
        self._applied[:] = torque_nm
        if tip_force_z_n:
            self._force_world_n[2] = tip_force_z_n
            mujoco.mj_applyFT(
                self._model,
                self._data,
                self._force_world_n,
                self._no_torque,
                self._tip_position,
                self._tip,
                self._applied,
            )

    def brake(self, friction_nm: Joints) -> None:
        self._model.dof_frictionloss[:] = friction_nm
        self._update_views()  # the next step reads friction, a constraint, from there

    def step(self) -> None:
        mujoco.mj_step2(self._model, self._data)
        self._update_views()

    def _update_views(self) -> None:
        """Make the first half of MuJoCo's next step now, so that the links are at the present positions."""
        mujoco.mj_step1(self._model, self._data)

    def mass_matrix(self, position_rad: Joints) -> FloatArray:
        self._aside.qpos[:] = position_rad
        mujoco.mj_fwdPosition(self._model, self._aside)
        matrix = np.zeros((self.joint_count, self.joint_count))
        mujoco.mj_fullM(self._model, self._aside, matrix)
        return matrix

    def inverse_dynamics(
        self, position_rad: Joints, velocity_rad_s: Joints, acceleration_rad_s2: Joints
    ) -> FloatArray:
        aside, torque = self._aside, np.zeros(self.joint_count)
        aside.qpos[:], aside.qvel[:], aside.qacc[:] = position_rad, velocity_rad_s, acceleration_rad_s2
        mujoco.mj_fwdPosition(self._model, aside)
        mujoco.mj_fwdVelocity(self._model, aside)
        mujoco.mj_rne(self._model, aside, 1, torque)
        return torque
