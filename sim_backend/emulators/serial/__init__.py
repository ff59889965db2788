"""Emulated force sensors on a serial line."""

from sim_backend.emulators.serial.gauge import EmulatedGauge
from sim_backend.emulators.serial.loadstar import EmulatedLoadstar
from sim_backend.emulators.serial.lorenz import EmulatedLorenz
from sim_backend.emulators.serial.pty_line import PtyLine, SerialSensor

__all__ = ["EmulatedGauge", "EmulatedLoadstar", "EmulatedLorenz", "PtyLine", "SerialSensor"]
