"""Serial force sensors: what they send, as pure functions, and the reader of their port."""

from robot_io.serial_force.framing import LineSplitter, Stream
from robot_io.serial_force.reader import ForceSample, SerialReader
from robot_io.serial_force.units import newtons_per

__all__ = ["ForceSample", "LineSplitter", "SerialReader", "Stream", "newtons_per"]
