"""A gamepad or joystick: its sticks set the speed of the hand's goal.

Read through Linux' joystick interface: records of 8 bytes, `time_ms u32, value s16, type u8, number u8`, all
little-endian here (kernel.org, Documentation/input/joydev/joystick-api.rst).
"""

import struct
from typing import Annotated

import numpy as np
from pydantic import Field

from robot_io.files.file_model import Number, Positive
from robot_io.operator.records import RecordHand, RecordSettings
from robot_io.types import FloatArray

_EVENT = struct.Struct("=IhBB")
_BUTTON, _AXIS, _INITIAL = 0x01, 0x02, 0x80
_FULL = 32767.0

AxisNumber = Annotated[int, Field(ge=0, le=63)]


class GamepadSettings(RecordSettings):
    """Which stick moves what; the defaults are those of most pads, whose sticks give -1 when pushed away."""

    port: str = "/dev/input/js0"
    axes: tuple[AxisNumber, AxisNumber, AxisNumber] = (1, 0, 4)  # for x, y and z
    signs: tuple[Number, Number, Number] = (-1.0, -1.0, -1.0)
    speed_m_s: Positive = 0.05  # at full deflection
    dead_zone: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.1
    select_button: AxisNumber = 0


class Gamepad(RecordHand):
    """A gamepad."""

    name = "gamepad"
    Settings = GamepadSettings
    settings: GamepadSettings

    def _open(self) -> None:
        self._open_file(self.settings.port, _EVENT.size)
        self._goal_s, self._deflection = self.clock.now_s(), np.zeros(3)

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for event in self._records():
            _, value, kind, number = _EVENT.unpack(event)
            if kind & ~_INITIAL == _AXIS and number in self.settings.axes:
                self._deflection[self.settings.axes.index(number)] = value / _FULL
            elif kind & ~_INITIAL == _BUTTON and number == self.settings.select_button:
                self._select = bool(value)
        beyond = np.maximum(0.0, np.abs(self._deflection) - self.settings.dead_zone)
        share = np.sign(self._deflection) * beyond / (1.0 - self.settings.dead_zone)
        velocity = self.settings.speed_m_s * np.array(self.settings.signs) * share
        self._goal_m = self._goal_m + velocity * (now_s - self._goal_s)
        self._goal_s = now_s
        return self._goal_m, velocity, self._select
