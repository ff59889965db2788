"""Sensors as real devices have them: they sample, quantise, saturate, add noise and are late."""

from sim_backend.sensors.encoder import SimulatedEncoder
from sim_backend.sensors.force_sensor import SimulatedForceSensor
from sim_backend.sensors.sampling import Sample
from sim_backend.sensors.settings import (
    EncoderSettings,
    ForceSettings,
    SensorSettings,
    TorqueSettings,
    VelocitySettings,
)
from sim_backend.sensors.torque_sensor import SimulatedTorqueSensor

__all__ = [
    "EncoderSettings",
    "ForceSettings",
    "Sample",
    "SensorSettings",
    "SimulatedEncoder",
    "SimulatedForceSensor",
    "SimulatedTorqueSensor",
    "TorqueSettings",
    "VelocitySettings",
]
