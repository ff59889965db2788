"""Drivers of the simulated robot; the robot file names them like any others."""

from sim_backend.drivers.devices import SimEncoder, SimForce, SimTorque
from sim_backend.drivers.simulated_bus import SimulatedBus

__all__ = ["SimEncoder", "SimForce", "SimTorque", "SimulatedBus"]
