"""Emulated force sensors on a serial line."""

from sim_backend.emulators.serial.cell import EmulatedCell
from sim_backend.emulators.serial.pty_line import PtyLine, SerialSensor
from sim_backend.emulators.serial.sensors import EmulatedGauge, EmulatedLoadstar, EmulatedLorenz

__all__ = ["EmulatedCell", "EmulatedGauge", "EmulatedLoadstar", "EmulatedLorenz", "PtyLine", "SerialSensor"]
