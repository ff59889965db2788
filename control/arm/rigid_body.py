"""Kinematics and dynamics of an arm, from its URDF, through Pinocchio.

Equation of motion with generalized torques tau and the external wrench w on the tip:

    M(q) a + C(q, v) v + g(q) = tau + J(q)^T w

Featherstone, "Rigid Body Dynamics Algorithms", Springer 2008, chapters 5 (RNEA) and 6 (mass matrix).
World frame: that of the URDF's root link; gravity is 9.81 m/s^2 along -z unless the base is tilted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from palpate.robot_io.calibration.applied import Calibrations, load_calibrations
from palpate.robot_io.capture_output import STDERR, STDOUT, capture_output
from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.files.file_model import read_text
from palpate.robot_io.files.urdf_text import parse_urdf
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import FloatArray, frozen_array

if TYPE_CHECKING:
    import pinocchio as pin
else:
    pin = LazyModule("pinocchio")

LEVEL = (0.0, 0.0, -9.81)


class TipMotion(NamedTuple):
    """Pose and velocity of the tip in the world frame."""

    position_world_m: FloatArray  # shape (3,) [m]
    rotation_world_tip: FloatArray  # shape (3, 3), turns tip coordinates into world coordinates
    velocity_world_m_s: FloatArray  # shape (3,) [m/s]
    # shape (6, n): tip velocity [m/s] above angular velocity [rad/s], per joint velocity.
    jacobian_world: FloatArray


@dataclass(frozen=True, slots=True)
class JointAxis:
    """Axis of a joint at zero position, in the world frame."""

    name: str
    origin_world_m: FloatArray  # shape (3,) [m]
    axis_world: FloatArray  # unit vector, shape (3,)
    revolute: bool


class RigidBody:
    """Kinematics and dynamics of an arm of revolute and prismatic joints on a fixed base. Not thread-safe.

    Units are those of revolute joints; for a prismatic joint read m, m/s, m/s^2 and N instead.

    Args:
        model: Pinocchio's model.
        tip_frame: name of the tip's frame.
        source: origin of the model, for errors.

    Raises:
        InputError: the frame is unknown, or a joint has more than one coordinate.
    """

    def __init__(self, model: "pin.Model", tip_frame: str, source: str = "URDF") -> None:
        for index in range(1, model.njoints):
            if model.joints[index].nq != 1:
                raise InputError(
                    f"{source}, joint '{model.names[index]}': only revolute (with limits) and prismatic "
                    "joints are supported; write a 'continuous' joint as 'revolute' with wide limits"
                )
        if not model.existFrame(tip_frame):
            valid = ", ".join(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY)
            raise InputError(f"{source}: no frame is called '{tip_frame}'. Valid: {valid}")
        self._model = model
        self._data = model.createData()
        self._tip = model.getFrameId(tip_frame)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RigidBody) and self._tip == other._tip and self._model == other._model

    def __hash__(self) -> int:
        return hash((self.joint_count, self._tip))

    @classmethod
    def of_robot(cls, robot_file: RobotFile, calibrations: Calibrations | None = None) -> "RigidBody":
        """Build the model of a robot file's arm, with the base tilted by its gravity calibration.

        Args:
            robot_file: names the URDF.
            calibrations: calibrations to apply; None for those of the robot file that are valid today.

        Raises:
            InputError: as for `from_urdf`, or a calibration is not valid.
        """
        if calibrations is None:
            calibrations = load_calibrations(robot_file)
        return cls.from_urdf(
            robot_file.urdf_path,
            robot_file.tip_frame,
            calibrations.gravity_base_m_s2,
            robot_file.rotor_inertia_kg_m2 or (),
        )

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        tip_frame: str,
        gravity_m_s2: Sequence[float] = LEVEL,
        rotor_inertia_kg_m2: Sequence[float] = (),
        *,
        origin: str = "URDF text",
    ) -> "RigidBody":
        """Read a URDF from a file or from its text.

        Args:
            urdf: path, or text (any string with a "<").
            tip_frame: name of the tip's frame.
            gravity_m_s2: gravity vector in the axes of the root link, shape (3,) [m/s^2].
            rotor_inertia_kg_m2: inertia that rotors add to the joints, shape (n,) or empty for none [kg m^2].
            origin: name of the text in errors.

        Raises:
            InputError: the file cannot be read, is too large, is not a URDF, lacks the frame, or has joints
                of other types.
        """
        is_text = isinstance(urdf, str) and "<" in urdf
        source, printed = origin if is_text else str(urdf), list[str]()
        try:
            text = str(urdf) if is_text else read_text(Path(urdf))
            parse_urdf(text)  # Pinocchio accepts a mass of -1 kg, and ignores invalid numbers
            with capture_output(printed, STDOUT, STDERR):
                model = pin.buildModelFromXML(text)
        except (OSError, ValueError, RuntimeError) as error:
            said = printed[0].removeprefix("Error:").strip() if printed else ""  # by the parser in C++
            reason = getattr(error, "strerror", None) or one_line(said or error)
            raise InputError(f"{source}: not a readable URDF ({reason:.100})") from error
        if model.nq == 0:
            raise InputError(f"{source}: has no movable joint")
        model.gravity.linear = frozen_array(gravity_m_s2, (3,), what="gravity")
        if len(rotor_inertia_kg_m2):
            model.armature = frozen_array(rotor_inertia_kg_m2, (model.nv,), what="rotor inertia").copy()
        return cls(model, tip_frame, source)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return int(self._model.nv)

    @property
    def gravity_m_s2(self) -> FloatArray:
        """Gravity vector in the axes of the root link, shape (3,) [m/s^2]."""
        return frozen_array(self._model.gravity.linear)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, from the base outwards, in the order of all arrays."""
        return tuple(self._model.names[1:])

    @property
    def tip_in_last_link(self) -> FloatArray:
        """Position of the tip in the frame of the link that the last joint moves, shape (3,) [m]."""
        return frozen_array(self._model.frames[self._tip].placement.translation)

    @property
    def weightless_joint(self) -> str:
        """Name of the first joint that moves neither mass nor inertia; empty if there is none."""
        diagonal = np.diag(self.mass_matrix(pin.neutral(self._model)))
        return next((name for name, i in zip(self.joint_names, diagonal, strict=True) if i <= 0.0), "")

    @property
    def position_limits_rad(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest joint positions of the URDF, each shape (n,) [rad]."""
        model = self._model
        return frozen_array(model.lowerPositionLimit), frozen_array(model.upperPositionLimit)

    @property
    def torque_limits_nm(self) -> FloatArray:
        """Largest torques of the URDF (its `effort`), shape (n,) [N m]."""
        return frozen_array(self._model.effortLimit)

    @property
    def velocity_limits_rad_s(self) -> FloatArray:
        """Largest speeds of the URDF, shape (n,) [rad/s]."""
        return frozen_array(self._model.velocityLimit)

    def tip_motion(self, position_rad: FloatArray, velocity_rad_s: FloatArray) -> TipMotion:
        """Compute pose, velocity and Jacobian of the tip in the world frame.

        Args:
            position_rad: joint positions, shape (n,) [rad].
            velocity_rad_s: joint velocities, shape (n,) [rad/s].
        """
        jacobian = self.tip_jacobian(position_rad)
        placement = pin.updateFramePlacement(self._model, self._data, self._tip)
        position, rotation = placement.translation.copy(), placement.rotation.copy()
        return TipMotion(position, rotation, jacobian[:3].dot(velocity_rad_s), jacobian)

    def tip_pose(self, position_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute position, shape (3,) [m], and rotation, shape (3, 3), of the tip in the world frame.

        Args:
            position_rad: joint positions, shape (n,) [rad].
        """
        pin.forwardKinematics(self._model, self._data, position_rad)
        placement = pin.updateFramePlacement(self._model, self._data, self._tip)
        return placement.translation.copy(), placement.rotation.copy()

    def heights_m(self, position_rad: FloatArray) -> FloatArray:
        """Compute the world heights of all joints and of the tip, shape (n + 1,) [m].

        Args:
            position_rad: joint positions, shape (n,) [rad].
        """
        tip_m, _ = self.tip_pose(position_rad)
        return np.array([*(joint.translation[2] for joint in self._data.oMi[1:]), tip_m[2]])

    def tip_jacobian(self, position_rad: FloatArray) -> FloatArray:
        """Compute the Jacobian of the tip in world axes.

        Args:
            position_rad: joint positions, shape (n,) [rad].

        Returns:
            Shape (6, n): tip velocity [m/s] above angular velocity [rad/s], per joint velocity.
        """
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, position_rad, self._tip, pin.LOCAL_WORLD_ALIGNED
        )
        return np.asarray(jacobian).reshape(6, -1)  # Pinocchio drops the second axis of an arm with one joint

    def inverse_dynamics(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, acceleration_rad_s2: FloatArray
    ) -> FloatArray:
        """Compute the torques for an acceleration in free air, including gravity, shape (n,) [N m].

        Args:
            position_rad: joint positions, shape (n,) [rad].
            velocity_rad_s: joint velocities, shape (n,) [rad/s].
            acceleration_rad_s2: joint accelerations, shape (n,) [rad/s^2].
        """
        motion = (position_rad, velocity_rad_s, acceleration_rad_s2)
        return np.asarray(pin.rnea(self._model, self._data, *motion))

    def inverse_dynamics_batch(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, acceleration_rad_s2: FloatArray
    ) -> FloatArray:
        """Compute `inverse_dynamics` of many samples at once, in a third of the time, shape (m, n) [N m].

        Args:
            position_rad: joint positions, shape (m, n) [rad].
            velocity_rad_s: joint velocities, shape (m, n) [rad/s].
            acceleration_rad_s2: joint accelerations, shape (m, n) [rad/s^2].
        """
        motion = (position_rad.T, velocity_rad_s.T, acceleration_rad_s2.T)
        torques = pin.rneaInParallel(1, pin.ModelPool(self._model, 1), *motion)
        return np.asarray(torques).reshape(self.joint_count, -1).T  # Pinocchio drops an axis of length 1

    def inertial_and_gravity_torques(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, acceleration_rad_s2: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Split the torques of `inverse_dynamics_batch` into I + G g, with the gravitational acceleration g.

        Args:
            position_rad: joint positions, shape (m, n) [rad].
            velocity_rad_s: joint velocities, shape (m, n) [rad/s].
            acceleration_rad_s2: joint accelerations, shape (m, n) [rad/s^2].

        Returns:
            I, shape (m, n) [N m], and G in the axes of the root link, shape (m, n, 3) [N m s^2/m].
        """
        jacobians = [pin.jacobianCenterOfMass(self._model, self._data, q).T.copy() for q in position_rad]
        gravity = -pin.computeTotalMass(self._model) * np.array(jacobians)
        torque_nm = self.inverse_dynamics_batch(position_rad, velocity_rad_s, acceleration_rad_s2)
        return torque_nm - gravity @ self._model.gravity.linear, gravity

    def with_load(self, mass_kg: float) -> "RigidBody":
        """Copy the arm with a point mass at its tip.

        Args:
            mass_kg: the mass [kg].
        """
        model, frame = self._model.copy(), self._model.frames[self._tip]
        load = pin.Inertia(mass_kg, np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, load, frame.placement)
        return RigidBody(model, frame.name)

    def mass_matrix(self, position_rad: FloatArray) -> FloatArray:
        """Compute the mass matrix M(q), shape (n, n), symmetric [kg m^2].

        Args:
            position_rad: joint positions, shape (n,) [rad].
        """
        return np.array(pin.crba(self._model, self._data, position_rad))  # the binding fills both triangles

    def forward_dynamics(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, torque_nm: FloatArray
    ) -> FloatArray:
        """Compute the accelerations under joint torques, shape (n,) [rad/s^2].

        Args:
            position_rad: joint positions, shape (n,) [rad].
            velocity_rad_s: joint velocities, shape (n,) [rad/s].
            torque_nm: torques of the drives and of forces at the arm, shape (n,) [N m].
        """
        return np.array(pin.aba(self._model, self._data, position_rad, velocity_rad_s, torque_nm))

    def effective_mass(self, position_rad: FloatArray, lever_m: FloatArray) -> float:
        """Compute the effective mass of the tip in one direction, 1 / (b^T M^-1 b) [kg].

        Args:
            position_rad: joint positions, shape (n,) [rad].
            lever_m: b, speed of the tip in that direction per joint velocity, shape (n,) [m].

        Returns:
            Effective mass [kg]; 0 if the tip cannot move in that direction.
        """
        inverse = pin.computeMinverse(self._model, self._data, position_rad)
        mobility_1_kg = float(lever_m.dot(inverse).dot(lever_m))
        return 1.0 / mobility_1_kg if mobility_1_kg > 0.0 else 0.0

    def gravity(self, position_rad: FloatArray) -> FloatArray:
        """Compute the torques g(q) that hold the arm still, shape (n,) [N m].

        Args:
            position_rad: joint positions, shape (n,) [rad].
        """
        return np.array(pin.computeGeneralizedGravity(self._model, self._data, position_rad))

    def regressor(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, acceleration_rad_s2: FloatArray
    ) -> FloatArray:
        """Compute the regressor Y(q, v, a), shape (n, 10 n): inverse dynamics is Y @ `parameters`.

        Ten columns per link: mass [kg], first moments [kg m] (x, y, z), inertias about the joint's frame [kg
        m^2] (xx, xy, yy, xz, yz, zz). Source: Atkeson, An and Hollerbach, IJRR 5(3), 1986.

        Args:
            position_rad: joint positions, shape (n,) [rad].
            velocity_rad_s: joint velocities, shape (n,) [rad/s].
            acceleration_rad_s2: joint accelerations, shape (n,) [rad/s^2].
        """
        motion = (position_rad, velocity_rad_s, acceleration_rad_s2)
        regressor = pin.computeJointTorqueRegressor(self._model, self._data, *motion)
        return np.array(regressor).reshape(self.joint_count, -1)  # Pinocchio drops an axis of length 1

    def joint_regressor(
        self,
        joint: int,
        position_rad: FloatArray,
        velocity_rad_s: FloatArray,
        acceleration_rad_s2: FloatArray,
    ) -> FloatArray:
        """Compute one joint's row of `regressor` for many samples, in half the time, shape (m, 10 n).

        Args:
            joint: index of the joint, from 0.
            position_rad: joint positions, shape (m, n) [rad].
            velocity_rad_s: joint velocities, shape (m, n) [rad/s].
            acceleration_rad_s2: joint accelerations, shape (m, n) [rad/s^2].
        """
        count, compute = self.joint_count, pin.computeJointTorqueRegressor
        rows = np.empty((len(position_rad), 10 * count))
        samples = zip(position_rad, velocity_rad_s, acceleration_rad_s2, strict=True)
        for number, motion in enumerate(samples):
            rows[number] = compute(self._model, self._data, *motion).reshape(count, -1)[joint]
        return rows

    @property
    def parameters(self) -> FloatArray:
        """Inertial parameters of the URDF, shape (10 n,), in the order of `regressor`'s columns."""
        return frozen_array(np.concatenate([link.toDynamicParameters() for link in self._model.inertias[1:]]))

    def joint_axes(self) -> tuple[JointAxis, ...]:
        """Compute origin and axis of every joint at zero position.

        Raises:
            InputError: the joints are not a single chain from base to tip.
        """
        model, data = self._model, self._data
        if list(model.parents[1:]) != list(range(model.nv)):
            raise InputError(
                "URDF: the arm has branches, but its joints must form one chain from base to tip"
            )
        # At the world's origin; Pinocchio drops the second axis of an arm with one joint.
        jacobian = pin.computeJointJacobians(model, data, np.zeros(model.nq)).reshape(6, model.nv)
        axes = []
        for index, name in enumerate(self.joint_names):
            revolute = bool(np.any(jacobian[3:, index]))
            axis = jacobian[3:, index] if revolute else jacobian[:3, index]
            origin = data.oMi[index + 1].translation
            axes.append(JointAxis(name, frozen_array(origin), frozen_array(axis), revolute))
        return tuple(axes)
