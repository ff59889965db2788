"""Encoders of ODrive axes."""

from typing import ClassVar

from robot_io.can.motor_devices import MotorEncoder
from robot_io.can.motor_joints import MotorBus
from robot_io.drivers.odrive_bus import OdriveBus


class OdriveEncoder(MotorEncoder):
    """Positions and velocities that ODrive axes estimate; the settings are the bus's."""

    name: ClassVar[str] = "odrive_encoder"
    bus_type: ClassVar[type[MotorBus]] = OdriveBus
