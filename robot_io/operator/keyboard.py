"""The keys of a terminal: each press moves the goal of the hand by a step.

w s  away and towards (x)    a d  left and right (y)    r f  up and down (z)    space  select, on and off
"""

import termios
from contextlib import suppress
from typing import ClassVar

import numpy as np

from robot_io.clock import Clock
from robot_io.errors import DeviceError
from robot_io.files.file_model import FileModel, Number, Positive
from robot_io.operator.modelled_hand import HandSettings, ModelledHand
from robot_io.operator.records import RecordFile
from robot_io.types import FloatArray

_WAYS = {
    b"w": (1, 0, 0),
    b"s": (-1, 0, 0),
    b"a": (0, 1, 0),
    b"d": (0, -1, 0),
    b"r": (0, 0, 1),
    b"f": (0, 0, -1),
}


class KeyboardSettings(HandSettings):
    """Where the hand begins, and how far a key press goes."""

    start_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)
    step_m: Positive = 0.001
    terminal: str = "/dev/tty"


class Keyboard(ModelledHand):
    """Reads keys as they are pressed, unechoed; the terminal is put back as it was."""

    name = "keyboard"
    Settings: ClassVar[type[FileModel]] = KeyboardSettings
    settings: KeyboardSettings

    def __init__(self, settings: KeyboardSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._keys: RecordFile | None = None

    def _open(self) -> None:
        self._goal_m, self._select = np.array(self.settings.start_world_m), False
        self._keys = RecordFile(self.settings.terminal, 1)
        try:
            self._before = termios.tcgetattr(self._keys.file)
            modes = termios.tcgetattr(self._keys.file)
            modes[3] &= ~(termios.ICANON | termios.ECHO)  # Ctrl-C stays a signal
            modes[6][termios.VMIN], modes[6][termios.VTIME] = 1, 0
            termios.tcsetattr(self._keys.file, termios.TCSANOW, modes)
        except termios.error as error:
            self._keys.close()
            self._keys = None
            raise DeviceError(f"{self.settings.terminal}: is no terminal") from error

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for key in self._keys.read() if self._keys else ():
            self._goal_m += self.settings.step_m * np.array(_WAYS.get(key.lower(), (0, 0, 0)))
            self._select ^= key == b" "
        return self._goal_m, np.zeros(3), self._select

    def _release(self) -> None:
        super()._release()
        if self._keys is not None:
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._keys.file, termios.TCSANOW, self._before)
            self._keys.close()
            self._keys = None
