"""Feetech servos of the STS series on a pseudo terminal, with the simulated arm behind them."""

from sim_backend.emulators.feetech.line import FeetechLine
from sim_backend.emulators.feetech.servo import Mounting

__all__ = ["FeetechLine", "Mounting"]
