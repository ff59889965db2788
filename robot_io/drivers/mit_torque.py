"""MIT-mode motors as torque-controlled drives."""

from typing import ClassVar

from robot_io.can.motor_devices import MotorTorque
from robot_io.can.motor_joints import MotorBus
from robot_io.drivers.mit_bus import MitBus


class MitTorque(MotorTorque):
    """Torques to and from MIT-mode motors; the settings are the bus's."""

    name: ClassVar[str] = "mit_torque"
    bus_type: ClassVar[type[MotorBus]] = MitBus
