"""Encoders, drives and force sensor of the simulated arm, on a bus called `pybullet`."""

from collections.abc import Mapping

from robot_io.driver import DriverContext
from robot_io.drivers.bus_devices import BusEncoder, BusTorque
from robot_io.files.file_model import FileModel
from robot_io.interfaces import ForceSensor
from robot_io.types import Reading
from sim_backend.drivers.simulated_bus import SimulatedBus


class SimEncoder(BusEncoder):
    """Positions and velocities out of the world; the scenario says how good they are."""

    name = "sim_encoder"
    bus_type = SimulatedBus


class SimTorque(BusTorque):
    """Torque-controlled drives in the world.

    Their range is the URDF's effort limit; their resolution and the quality of what they measure are the
    scenario's.
    """

    name = "sim_torque"
    bus_type = SimulatedBus


class SimForce(ForceSensor):
    """The contact force out of the world; the scenario says how good it is."""

    name = "sim_force"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(SimulatedBus)

    def read_force(self) -> Reading:
        return self._bus.force
