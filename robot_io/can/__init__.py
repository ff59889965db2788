"""CAN: the adapter, and the codecs of the motors' protocols."""

from robot_io.can.frame import CanFrame
from robot_io.can.line import CanLine, CanLineSettings, Timestamps

__all__ = ["CanFrame", "CanLine", "CanLineSettings", "Timestamps"]
