"""Drivers of the simulated robot; the robot file names them like any others."""

from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.drivers.sim_encoder import SimEncoder
from sim_backend.drivers.sim_force import SimForce
from sim_backend.drivers.sim_torque import SimTorque

__all__ = ["PyBulletBus", "SimEncoder", "SimForce", "SimTorque"]
