"""Encoders of MIT-mode motors."""

from typing import ClassVar

from robot_io.can.motor_devices import MotorEncoder
from robot_io.can.motor_joints import MotorBus
from robot_io.drivers.mit_bus import MitBus


class MitEncoder(MotorEncoder):
    """Positions and velocities that MIT-mode motors report; the settings are the bus's."""

    name: ClassVar[str] = "mit_encoder"
    bus_type: ClassVar[type[MotorBus]] = MitBus
