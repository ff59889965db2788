"""Encoders and torque-controlled drives of ODrive axes."""

from typing import ClassVar

from robot_io.drivers.can.motors import MotorBus, MotorEncoder, MotorTorque
from robot_io.drivers.odrive.bus import OdriveBus


class OdriveEncoder(MotorEncoder):
    """Positions and velocities that ODrive axes estimate; the settings are the bus's."""

    name: ClassVar[str] = "odrive_encoder"
    bus_type: ClassVar[type[MotorBus]] = OdriveBus


class OdriveTorque(MotorTorque):
    """Torques to and from ODrive axes; the settings are the bus's."""

    name: ClassVar[str] = "odrive_torque"
    bus_type: ClassVar[type[MotorBus]] = OdriveBus
