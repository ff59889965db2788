"""Encoders of the simulated arm."""

from collections.abc import Mapping
from typing import ClassVar

from robot_io.driver import DriverContext
from robot_io.files.file_model import FileModel
from robot_io.interfaces import JointEncoder
from robot_io.types import Reading
from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.drivers.readings import reading_of


class SimEncoder(JointEncoder):
    """Positions and velocities out of the world of a `pybullet` bus; the scenario says how good they are."""

    name: ClassVar[str] = "sim_encoder"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(PyBulletBus)
        self._joint_count = context.robot_file.joint_count

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._joint_count

    def read_position(self) -> Reading:
        return reading_of(self._bus.encoder_sample, slice(0, self._joint_count), self._joint_count)

    def read_velocity(self) -> Reading:
        return reading_of(self._bus.encoder_sample, slice(self._joint_count, None), self._joint_count)
