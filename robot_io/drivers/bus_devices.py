"""Encoders and drives whose bus knows all that is read and sent."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from robot_io.driver import DriverContext
from robot_io.files.file_model import FileModel, input_error
from robot_io.interfaces import Bus, JointEncoder, JointTorque
from robot_io.types import FloatArray, Reading


def check_one_per_joint(context: DriverContext, count: int, devices: str) -> None:
    """Check that a bus has as many drives as the arm has joints.

    Args:
        context: What the bus was given.
        count: Number of its drives.
        devices: What to call them, such as "motors".

    Raises:
        InputError: There are more or fewer.
    """
    joint_count = context.robot_file.joint_count
    if count != joint_count:
        problem = f"has {count} {devices}, home_rad has {joint_count}: one per joint"
        raise input_error(context.robot_file.document, context.section, problem)


class JointBus(Bus):
    """A bus whose devices turn all joints.

    Attributes:
        position: newest positions of all joints [rad], as of the last poll.
        velocity: newest velocities [rad/s].
        torque: newest measured torques [N m].
    """

    position: Reading
    velocity: Reading
    torque: Reading

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Number of joints n."""

    @abstractmethod
    def power_on(self) -> None:
        """Make all drives obey torque commands, at zero torque. DeviceError: one refused."""

    @abstractmethod
    def power_off(self) -> None:
        """Take the torque off all drives, whatever state they are in, and drop a staged command.

        DeviceError: one did not confirm; all were told.
        """

    @abstractmethod
    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`. LifecycleError: the torque is off."""


class _OnBus:
    bus_type: ClassVar[type[JointBus]]
    Settings: ClassVar[type[FileModel]] = FileModel  # what the robot file says; that of the bus is the rest

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(self.Settings, settings)
        self._bus = context.bus_as(self.bus_type)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._bus.joint_count


class BusEncoder(_OnBus, JointEncoder):
    """Positions and velocities that a bus reports."""

    def read_position(self) -> Reading:
        return self._bus.position

    def read_velocity(self) -> Reading:
        return self._bus.velocity


class BusTorque(_OnBus, JointTorque):
    """The drives on a bus."""

    def activate(self) -> None:
        self._bus.power_on()

    def deactivate(self) -> None:
        self._bus.power_off()

    def read_torque(self) -> Reading:
        return self._bus.torque

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        return self._bus.stage(torque_nm)
