"""The keys of a terminal: each press moves the goal of the hand by a step.

w s  away and towards (x)    a d  left and right (y)    r f  up and down (z)    space  select, on and off
"""

import termios
from contextlib import suppress

import numpy as np

from robot_io.errors import DeviceError
from robot_io.files.file_model import Positive
from robot_io.operator.records import RecordHand, RecordSettings
from robot_io.types import FloatArray

_WAYS = {
    b"w": (1, 0, 0),
    b"s": (-1, 0, 0),
    b"a": (0, 1, 0),
    b"d": (0, -1, 0),
    b"r": (0, 0, 1),
    b"f": (0, 0, -1),
}


class KeyboardSettings(RecordSettings):
    """How far a key press goes."""

    step_m: Positive = 0.001
    terminal: str = "/dev/tty"


class Keyboard(RecordHand):
    """Reads keys as they are pressed, unechoed; the terminal is put back as it was."""

    name = "keyboard"
    Settings = KeyboardSettings
    settings: KeyboardSettings

    def _open(self) -> None:
        file = self._open_file(self.settings.terminal, 1).file
        try:
            self._before = termios.tcgetattr(file)
            modes = termios.tcgetattr(file)
            modes[3] &= ~(termios.ICANON | termios.ECHO)  # Ctrl-C stays a signal
            modes[6][termios.VMIN], modes[6][termios.VTIME] = 1, 0
            termios.tcsetattr(file, termios.TCSANOW, modes)
        except termios.error as error:
            super()._release()
            raise DeviceError(f"{self.settings.terminal}: is no terminal") from error

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for key in self._records():
            self._goal_m += self.settings.step_m * np.array(_WAYS.get(key.lower(), (0, 0, 0)))
            self._select ^= key == b" "
        return self._goal_m, np.zeros(3), self._select

    def _release(self) -> None:
        if self._file is not None:
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._file.file, termios.TCSANOW, self._before)
        super()._release()
