"""The stand-in for hardware: an arm, an object and sensors in a physics engine, as robot_io's devices."""

from sim_backend.hooks import ContactEffect, Effects, JointEffect, SensorEffect
from sim_backend.scenario import Scenario, load_scenario, parse_scenario, shipped_scenarios
from sim_backend.world import ArmDescription, Truth, World

__all__ = [
    "ArmDescription",
    "ContactEffect",
    "Effects",
    "JointEffect",
    "Scenario",
    "SensorEffect",
    "Truth",
    "World",
    "load_scenario",
    "parse_scenario",
    "shipped_scenarios",
]
