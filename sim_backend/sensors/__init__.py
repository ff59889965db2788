"""Sensors as real devices have them: they sample, quantise, saturate, add noise and are late."""

from sim_backend.sensors.sampling import Sample
from sim_backend.sensors.sensors import SimulatedEncoder, SimulatedForceSensor, SimulatedTorqueSensor
from sim_backend.sensors.settings import SensorSettings

__all__ = ["Sample", "SensorSettings", "SimulatedEncoder", "SimulatedForceSensor", "SimulatedTorqueSensor"]
