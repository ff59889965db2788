"""Drivers of the simulated robot; the robot file names them like any others."""

from sim_backend.drivers.devices import SimEncoder, SimForce, SimTorque
from sim_backend.drivers.pybullet_bus import PyBulletBus

__all__ = ["PyBulletBus", "SimEncoder", "SimForce", "SimTorque"]
