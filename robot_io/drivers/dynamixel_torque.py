"""Dynamixel servos as torque-controlled drives: torque is motor current times the torque constant."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from robot_io.driver import DriverContext
from robot_io.drivers.dynamixel_bus import DynamixelBus
from robot_io.files.file_model import FileModel
from robot_io.interfaces import JointTorque
from robot_io.types import FloatArray, Reading, Status


class DynamixelTorque(JointTorque):
    """The drives of a `dynamixel_bus`.

    Both command and measurement are of the motor current; what the gears' friction takes is in neither.
    """

    name: ClassVar[str] = "dynamixel_torque"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(DynamixelBus)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._bus.joint_count

    def activate(self) -> None:
        """Torque on, at zero until the first command."""
        self._bus.torque_on()

    def deactivate(self) -> None:
        """Torque off, confirmed by every servo."""
        self._bus.torque_off()

    def read_torque(self) -> Reading:
        """See `JointTorque.read_torque`."""
        sample = self._bus.sample
        if sample is None:
            return Reading(np.full(self.joint_count, np.nan), -np.inf, Status.STALE)
        return Reading(sample.torque_nm, sample.sampled_at_s, sample.torque_status)

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`."""
        return self._bus.stage(np.asarray(torque_nm, dtype=np.float64))
