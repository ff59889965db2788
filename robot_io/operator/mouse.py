"""A mouse: it moves the hand's goal in the vertical plane ahead; the left button selects.

Read from the kernel's mouse device, records of 3 bytes in PS/2 form: buttons and signs, dx right, dy up
(kernel.org, Documentation/input/input.rst, "mousedev").
"""

from typing import ClassVar

import numpy as np

from robot_io.clock import Clock
from robot_io.files.file_model import FileModel, Number, Positive
from robot_io.operator.modelled_hand import HandSettings, ModelledHand
from robot_io.operator.records import RecordFile
from robot_io.types import FloatArray

_LEFT, _X_NEGATIVE, _Y_NEGATIVE = 0x01, 0x10, 0x20


class MouseSettings(HandSettings):
    """Where the hand begins, and how far it goes for each count."""

    port: str = "/dev/input/mice"
    start_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)
    count_m: Positive = 5e-5
    # Unit vectors that the mouse's way to the right and its way ahead stand for.
    right_world: tuple[Number, Number, Number] = (1.0, 0.0, 0.0)
    ahead_world: tuple[Number, Number, Number] = (0.0, 0.0, 1.0)


class Mouse(ModelledHand):
    """A mouse."""

    name = "mouse"
    Settings: ClassVar[type[FileModel]] = MouseSettings
    settings: MouseSettings

    def __init__(self, settings: MouseSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._moves: RecordFile | None = None

    def _open(self) -> None:
        self._moves = RecordFile(self.settings.port, 3)
        self._goal_m, self._select = np.array(self.settings.start_world_m), False
        self._ways = np.array([self.settings.right_world, self.settings.ahead_world])

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for buttons, right, ahead in self._moves.read() if self._moves else ():
            counts = (right - 256 * bool(buttons & _X_NEGATIVE), ahead - 256 * bool(buttons & _Y_NEGATIVE))
            self._goal_m += self.settings.count_m * np.array(counts) @ self._ways
            self._select = bool(buttons & _LEFT)
        return self._goal_m, np.zeros(3), self._select

    def _release(self) -> None:
        super()._release()
        if self._moves is not None:
            self._moves.close()
            self._moves = None
