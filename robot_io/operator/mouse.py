"""A mouse: it moves the hand's goal in the vertical plane ahead; the left button selects.

Read from the kernel's mouse device, records of 3 bytes in PS/2 form: buttons and signs, dx right, dy up
(kernel.org, Documentation/input/input.rst, "mousedev").
"""

import numpy as np

from robot_io.files.file_model import Number, Positive
from robot_io.operator.records import RecordHand, RecordSettings
from robot_io.types import FloatArray

_LEFT, _X_NEGATIVE, _Y_NEGATIVE = 0x01, 0x10, 0x20


class MouseSettings(RecordSettings):
    """How far the hand goes for each count."""

    port: str = "/dev/input/mice"
    count_m: Positive = 5e-5
    # Unit vectors that the mouse's way to the right and its way ahead stand for.
    right_world: tuple[Number, Number, Number] = (1.0, 0.0, 0.0)
    ahead_world: tuple[Number, Number, Number] = (0.0, 0.0, 1.0)


class Mouse(RecordHand):
    """A mouse."""

    name = "mouse"
    Settings = MouseSettings
    settings: MouseSettings

    def _open(self) -> None:
        self._open_file(self.settings.port, 3)
        self._ways = np.array([self.settings.right_world, self.settings.ahead_world])

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for buttons, right, ahead in self._records():
            counts = (right - 256 * bool(buttons & _X_NEGATIVE), ahead - 256 * bool(buttons & _Y_NEGATIVE))
            self._goal_m += self.settings.count_m * np.array(counts) @ self._ways
            self._select = bool(buttons & _LEFT)
        return self._goal_m, np.zeros(3), self._select
