"""The simulated world: an arm, an object, sensors, and time that passes in physics steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import floor, isfinite
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import read_text
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray, clip, frozen_array
from palpate.sim_backend.contact import ComplianceObject, TipContact
from palpate.sim_backend.engines import engine_class
from palpate.sim_backend.engines.engine import dynamics_urdf
from palpate.sim_backend.hidden import hidden_effects
from palpate.sim_backend.hooks import NO_EFFECTS, HiddenEffects, JointStepState
from palpate.sim_backend.imperfections.joint import Rotors
from palpate.sim_backend.scenario import Scenario
from palpate.sim_backend.sensors import SimulatedEncoder, SimulatedForceSensor, SimulatedTorqueSensor


@dataclass(frozen=True)
class ArmDescription:
    """Properties of a robot that the world needs."""

    urdf_text: str  # the robot's URDF
    tip_frame: str  # URDF link whose origin is the contact point
    # Unit vector in the tip frame along which the force sensor measures compression.
    sensor_axis_tip: Sequence[float]
    home_rad: Sequence[float]  # where the joints are at the start (n) [rad]
    # What its drives' rotors add to the joints (n), or empty [kg m^2].
    rotor_inertia_kg_m2: Sequence[float] = ()


@dataclass(frozen=True)
class Truth:
    """The state of a world without sensor errors, for tests and for tables that compare with the truth."""

    time_s: float  # time of the state [s]
    joint_position_rad: FloatArray  # shape (n,) [rad]
    joint_velocity_rad_s: FloatArray  # shape (n,), of the middle of the last step [rad/s]
    drive_torque_nm: FloatArray  # torques of the drives during the last step, shape (n,) [N m]
    tip_position_world_m: FloatArray  # shape (3,) [m]
    depth_m: float  # how far the tip is below the undeformed surface [m]; negative above it
    rate_m_s: float  # d(depth)/dt [m/s]
    force_n: float  # force of the object on the tip, upwards [N]


class World:
    """A simulated world under one scenario, independent of other worlds in the process.

    Args:
        arm: the robot.
        scenario: object, sensors, physics and hidden effects.
        effects: hidden in addition to the scenario's.
        start_s: time of the initial state on the robot's clock [s].

    Attributes:
        object: the compliance object; its law and height may be changed at any time.
        sensor_load_n: additional force on the force sensor, such as a weight put on it by hand [N]; the arm
            stands on its rest meanwhile and does not feel it.
        held: while True the arm stands still under any load; time and sensors continue.

    Raises:
        InputError: the physics engine is not installed or cannot load the robot, or robot and hidden effects
            do not fit each other.
    """

    def __init__(
        self,
        arm: ArmDescription,
        scenario: Scenario,
        effects: HiddenEffects = NO_EFFECTS,
        start_s: float = 0.0,
    ) -> None:
        self.scenario = scenario
        rotors = (Rotors(arm.rotor_inertia_kg_m2),) if arm.rotor_inertia_kg_m2 else ()
        hidden = hidden_effects(scenario.hidden, len(arm.home_rad))
        self._effects = effects = hidden + effects + HiddenEffects(joint=rotors)
        self._sensor_axis_tip = tuple(arm.sensor_axis_tip)
        self._start_s = start_s
        self._step_s = 1.0 / scenario.physics.rate_hz
        self._steps = 0
        self._joints: list[float] | None = None
        self.sensor_load_n = 0.0
        self.held = False
        self._build_plant(arm)
        settings, step_s = scenario.sensors, self._step_s
        noise = {  # a random stream for each sensor
            sensor: np.random.default_rng([scenario.seed, crc32(sensor.encode())])
            for sensor in ("encoder", "torque", "force")
        }
        self.encoder = SimulatedEncoder(settings.encoder, noise["encoder"], start_s, step_s, effects.encoder)
        self.torque_sensor = SimulatedTorqueSensor(settings.torque, noise["torque"], start_s, effects.torque)
        self.force_sensor = SimulatedForceSensor(
            settings.force, noise["force"], start_s, step_s, effects.force
        )
        self._torque_nm: Sequence[float] = [0.0] * self.joint_count
        self._alters_joints = bool(effects.joint or effects.friction)
        self._observe()

    def _build_plant(self, arm: ArmDescription) -> None:
        scenario = self.scenario
        gravity_m_s2: Sequence[float] = (0.0, 0.0, -scenario.physics.gravity_m_s2)
        urdf_text = arm.urdf_text
        for effect in self._effects.plant:
            gravity_m_s2 = effect.gravity_m_s2(gravity_m_s2)
            urdf_text = effect.urdf(urdf_text, arm.tip_frame)
        text = dynamics_urdf(
            urdf_text,
            arm.tip_frame,
            mass_scale=scenario.arm.mass_scale,
            tip_radius_m=scenario.arm.tip_radius_m,
            sensor_axis_tip=arm.sensor_axis_tip,
        )
        engine = engine_class(scenario.physics.engine)
        self._engine = engine(text, arm.tip_frame, step_s=self._step_s, gravity_m_s2=gravity_m_s2)
        try:
            self._place(arm.home_rad)
            self.object = ComplianceObject(
                self._engine, scenario.object.law, scenario.object.surface_height_m
            )
        except InputError:
            self.close()
            raise
        self._contact = TipContact(self._engine, self.object, self._step_s, self._effects)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._engine.joint_count

    @property
    def time_s(self) -> float:
        """Time of the state on the robot's clock [s]."""
        return self._start_s + self._steps * self._step_s

    @property
    def torque_limit_nm(self) -> list[float]:
        """Largest torque of each drive (n) [N m]."""
        return self._engine.torque_limit_nm

    def place(self, position_rad: ArrayLike, velocity_rad_s: ArrayLike | None = None) -> None:
        """Set the joints' state.

        Args:
            position_rad: shape (n,) [rad].
            velocity_rad_s: shape (n,) [rad/s]; None for rest.

        Raises:
            InputError: wrong number of joints.
        """
        self._place(position_rad, velocity_rad_s)
        for effect in self._effects.joint:
            effect.restart()
        self._contact.restart()
        self._observe()

    def _place(self, position_rad: ArrayLike, velocity_rad_s: ArrayLike | None = None) -> None:
        shape = (self.joint_count,)
        position = frozen_array(position_rad, shape, what="joint position")
        velocity_rad_s = np.zeros(shape) if velocity_rad_s is None else velocity_rad_s
        speed = frozen_array(velocity_rad_s, shape, what="joint velocity")
        self._engine.place(position.tolist(), speed.tolist())

    def set_torque(self, torque_nm: Sequence[float]) -> None:
        """Set the drives' torques, clipped to their limits.

        Args:
            torque_nm: shape (n,) [N m].

        Raises:
            InputError: wrong number of joints, or a torque that is not finite.
        """
        limits = self._engine.torque_limit_nm
        if len(torque_nm) != len(limits) or not all(map(isfinite, torque_nm)):
            raise InputError(f"joint torque {list(torque_nm)} N m: must be {len(limits)} finite numbers")
        self._torque_nm = [clip(t, -limit, limit) for t, limit in zip(torque_nm, limits, strict=True)]

    def advance_to(self, time_s: float) -> None:
        """Integrate up to the last whole step that is not after a time; an earlier time changes nothing.

        Args:
            time_s: time on the robot's clock [s].
        """
        last_step = floor((time_s - self._start_s) / self._step_s + 1e-6)
        engine, contact = self._engine, self._contact
        while self._steps < last_step:
            if not self.held:
                torque_nm = self._joint_torque_nm() if self._alters_joints else self._torque_nm
                engine.push(torque_nm, contact.push_n, contact.tip_position_m)
                engine.step()
            self._steps += 1
            self._observe()

    def _joint_torque_nm(self) -> Sequence[float]:
        """Let effects change the torques in the next step (n) [N m]; set that step's friction."""
        n, joints = self.joint_count, self._joint_values()
        position = joints[:n]
        mass_matrix = partial(self._engine.mass_matrix, position)
        bias_torque_nm = partial(self._engine.inverse_dynamics, position, joints[n:], [0.0] * n)
        state = JointStepState(
            self.time_s, self._step_s, position, joints[n:], self._torque_nm, mass_matrix, bias_torque_nm
        )
        torque = self._torque_nm
        for effect in self._effects.joint:
            torque = effect.joint_torque_nm(state, torque)
        if self._effects.friction:
            limit = [0.0] * self.joint_count
            for friction in self._effects.friction:
                limit[friction.index] += friction.limit_nm(state)
            self._engine.brake(limit)
        return torque

    def _joint_values(self) -> list[float]:
        """Return the 2n positions and velocities of the current state, read once from the engine."""
        if self._joints is None:
            self._joints = self._engine.joint_state()
        return self._joints

    def _observe(self) -> None:
        """Compute the contact at the present state, and show the state to the sensors."""
        self._joints = None
        time_s = self._start_s + self._steps * self._step_s
        self._contact.update(time_s)
        if time_s >= self.encoder.next_sample_s:
            self.encoder.observe(time_s, self._joint_values())
        if time_s >= self.torque_sensor.next_sample_s:
            self.torque_sensor.observe(time_s, self._torque_nm)
        if time_s >= self.force_sensor.next_sample_s:
            force_n = self._contact.compression_n(self._sensor_axis_tip) + self.sensor_load_n
            self.force_sensor.observe(time_s, [force_n])

    def truth(self) -> Truth:
        """Return the true state."""
        joints = np.array(self._engine.joint_state())
        return Truth(
            time_s=self.time_s,
            joint_position_rad=joints[: self.joint_count],
            joint_velocity_rad_s=joints[self.joint_count :],
            drive_torque_nm=np.array(self._torque_nm),
            tip_position_world_m=np.array(self._contact.tip_position_m),
            depth_m=self._contact.depth_m,
            rate_m_s=self._contact.rate_m_s,
            force_n=self._contact.force_n,
        )

    def close(self) -> None:
        """Free resources; can be called repeatedly."""
        self._engine.close()


def world_of(robot_file: RobotFile, scenario: Scenario, start_s: float = 0.0) -> World:
    """Make the world of the arm that a robot file describes; see `World`.

    Args:
        robot_file: the robot.
        scenario: object, sensors, physics and hidden effects.
        start_s: time of the initial state on the robot's clock [s].

    Raises:
        InputError: as for `World`, or the URDF cannot be read; the error names both files.
    """
    try:
        arm = ArmDescription(
            read_text(robot_file.urdf_path),
            robot_file.tip_frame,
            robot_file.sensor_axis_tip,
            robot_file.home_rad,
            robot_file.rotor_inertia_kg_m2 or (),
        )
        return World(arm, scenario, start_s=start_s)
    except (OSError, ValueError) as error:  # an InputError is a ValueError
        raise InputError(f"{robot_file.path} with {robot_file.urdf}: {error}") from error
