"""Force sensor of the simulated arm."""

from collections.abc import Mapping
from typing import ClassVar

from robot_io.driver import DriverContext
from robot_io.files.file_model import FileModel
from robot_io.interfaces import ForceSensor
from robot_io.types import Reading
from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.drivers.readings import reading_of


class SimForce(ForceSensor):
    """The contact force out of the world of a `pybullet` bus; the scenario says how good it is."""

    name: ClassVar[str] = "sim_force"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(PyBulletBus)

    def read_force(self) -> Reading:
        return reading_of(self._bus.force_sample, slice(None), 1)
