"""Emulated motors on a CAN bus."""

from sim_backend.emulators.can.mit_motor import EmulatedMitMotor
from sim_backend.emulators.can.odrive import EmulatedOdrive
from sim_backend.emulators.can.wire import CanNode, CanWire

__all__ = ["CanNode", "CanWire", "EmulatedMitMotor", "EmulatedOdrive"]
