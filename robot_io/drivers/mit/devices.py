"""Encoders and torque-controlled drives of MIT-mode motors."""

from typing import ClassVar

from robot_io.drivers.can.motors import MotorBus, MotorEncoder, MotorTorque
from robot_io.drivers.mit.bus import MitBus


class MitEncoder(MotorEncoder):
    """Positions and velocities that MIT-mode motors report; the settings are the bus's."""

    name: ClassVar[str] = "mit_encoder"
    bus_type: ClassVar[type[MotorBus]] = MitBus


class MitTorque(MotorTorque):
    """Torques to and from MIT-mode motors; the settings are the bus's."""

    name: ClassVar[str] = "mit_torque"
    bus_type: ClassVar[type[MotorBus]] = MitBus
