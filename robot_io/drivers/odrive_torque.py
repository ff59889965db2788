"""ODrive axes as torque-controlled drives."""

from typing import ClassVar

from robot_io.can.motor_devices import MotorTorque
from robot_io.can.motor_joints import MotorBus
from robot_io.drivers.odrive_bus import OdriveBus


class OdriveTorque(MotorTorque):
    """Torques to and from ODrive axes; the settings are the bus's."""

    name: ClassVar[str] = "odrive_torque"
    bus_type: ClassVar[type[MotorBus]] = OdriveBus
