"""Encoder and drives as seen by the robot, for any motors on a CAN bus."""

from collections.abc import Mapping
from typing import ClassVar

from robot_io.can.motor_joints import MotorBus
from robot_io.driver import DriverContext
from robot_io.errors import LifecycleError
from robot_io.files.file_model import FileModel
from robot_io.interfaces import JointEncoder, JointTorque
from robot_io.types import FloatArray, Reading


class MotorEncoder(JointEncoder):
    """Positions and velocities that motors on a CAN bus report.

    Args:
        settings: none are known.
        context: must hold a bus of the protocol's `bus_type`.
    """

    bus_type: ClassVar[type[MotorBus]]

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(self.bus_type)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._bus.joint_count

    def read_position(self) -> Reading:
        """See `JointEncoder.read_position`."""
        return self._bus.position

    def read_velocity(self) -> Reading:
        """See `JointEncoder.read_velocity`."""
        return self._bus.velocity


class MotorTorque(JointTorque):
    """Motors on a CAN bus in torque mode.

    Args:
        settings: none are known.
        context: must hold a bus of the protocol's `bus_type`.
    """

    bus_type: ClassVar[type[MotorBus]]

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(self.bus_type)
        self._active = False

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._bus.joint_count

    def activate(self) -> None:
        """See `MotorBus.power_on`."""
        self._bus.power_on()
        self._active = True

    def deactivate(self) -> None:
        """See `MotorBus.power_off`."""
        self._active = False
        self._bus.power_off()

    def read_torque(self) -> Reading:
        """See `JointTorque.read_torque`."""
        return self._bus.torque

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`.

        Raises:
            LifecycleError: the motors are off.
        """
        if not self._active:
            raise LifecycleError("the motors are off: activate them before the first command")
        return self._bus.stage(torque_nm)
