"""Dynamixel servos of the X series on a pseudo terminal, with the simulated arm behind them."""

from sim_backend.emulators.dynamixel.line import DynamixelLine
from sim_backend.emulators.dynamixel.servo import Mounting

__all__ = ["DynamixelLine", "Mounting"]
