"""Keyboard, mouse and gamepad: device files that move a modelled hand, read without waiting.

- Keyboard: each press moves the goal by a step. w s away and towards (x), a d left and right (y), r f up and
  down (z), space toggles selection.
- Mouse: moves the goal in the vertical plane ahead; the left button selects. The kernel's mouse device gives
  records of 3 bytes in PS/2 form: buttons and signs, dx right, dy up (kernel.org,
  Documentation/input/input.rst, "mousedev").
- Gamepad: sticks set speeds. The kernel's joystick device gives events of 8 bytes (kernel.org,
  Documentation/input/joydev/joystick-api.rst).
"""

import os
import struct
import termios
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from robot_io.errors import DeviceError
from robot_io.files.file_model import Number, Positive
from robot_io.operator.device import HandSettings, ModelledHand
from robot_io.types import FloatArray

_MOST_BYTES = 65_536  # in one reading


class RecordFile:
    """An open device file, such as /dev/input/js0.

    Args:
        path: of the file.
        size: of a record [bytes].

    Raises:
        DeviceError: it cannot be opened.
    """

    def __init__(self, path: str | Path, size: int) -> None:
        self.path, self._size = path, size
        self._rest = b""
        try:
            self.file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            raise DeviceError(f"{path}: cannot be opened ({error.strerror})") from error

    def read(self) -> list[bytes]:
        """Return all records that have come since the last call.

        Raises:
            DeviceError: the device is gone.
        """
        try:
            come = os.read(self.file, _MOST_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise DeviceError(f"{self.path}: the device is gone ({error.strerror})") from error
        if not come:
            raise DeviceError(f"{self.path}: the device is gone (end of file)")
        come = self._rest + come
        whole = len(come) - len(come) % self._size
        self._rest = come[whole:]
        return [come[start : start + self._size] for start in range(0, whole, self._size)]

    def close(self) -> None:
        """Close it."""
        os.close(self.file)


class RecordSettings(HandSettings):
    """Where the hand begins."""

    start_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)


class RecordHand(ModelledHand):
    """A modelled hand whose goal is moved by a device file."""

    settings: RecordSettings
    _file: RecordFile | None = None

    def _open_file(self, path: str, size: int) -> RecordFile:
        self._goal_m, self._select = np.array(self.settings.start_world_m), False
        self._file = RecordFile(path, size)
        return self._file

    def _records(self) -> list[bytes]:
        return self._file.read() if self._file else []

    def _release(self) -> None:
        super()._release()
        if self._file is not None:
            self._file.close()
            self._file = None


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
