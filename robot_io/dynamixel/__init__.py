"""Dynamixel servos of the X series: protocol, registers, models, and one bus of them."""

from robot_io.dynamixel.models import MODELS, ServoModel
from robot_io.dynamixel.servo_line import ServoIdentity
from robot_io.dynamixel.settings import DynamixelSettings, ServoSettings

__all__ = ["MODELS", "DynamixelSettings", "ServoIdentity", "ServoModel", "ServoSettings"]
