"""Keyboard, mouse and gamepad, which move a modeled hand, and Touch, which has motors.

- Keyboard: each press moves the goal by a step. w s away and towards (x), a d left and right (y), r f up and
  down (z), space toggles selection.
- Mouse: moves the goal in the vertical plane ahead; the left button selects. The kernel's mouse device gives
  records of 3 bytes in PS/2 form: buttons and signs, dx right, dy up (kernel.org,
  Documentation/input/input.rst, "mousedev").
- Gamepad: sticks set speeds. The kernel's joystick device gives events of 8 bytes (kernel.org,
  Documentation/input/joydev/joystick-api.rst).

Touch and other devices of 3D Systems are driven through OpenHaptics (libHD) if it is installed. Calls,
constants and units (mm, mm/s, N; x to the right, y up, z towards the operator) are those of the "OpenHaptics
Toolkit API Reference Guide", HDAPI. The library runs a servo loop of 1 kHz of its own, in which a callback
exchanges motion and force with ours; without a new force for `watchdog_s` it renders none.
"""

import ctypes
import os
import struct
import termios
import threading
from contextlib import suppress
from typing import Annotated

import numpy as np
from pydantic import Field

from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.files.file_model import FileModel, Number, Positive
from palpate.robot_io.operator.device import HandSettings, HandState, ModeledHand, OperatorDevice
from palpate.robot_io.types import FloatArray

_MOST_BYTES = 65_536  # in one reading


class RecordSettings(HandSettings):
    """Initial position of the hand."""

    start_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)  # world position [m]


class RecordHand(ModeledHand):
    """A modeled hand whose goal is moved by the records of a device file, such as /dev/input/js0."""

    settings: RecordSettings
    _file = -1  # file descriptor

    def _open_file(self, path: str, size: int) -> None:
        """Open a device file with records of `size` bytes; raise `DeviceError` if it cannot be opened."""
        self._goal_m, self._select = np.array(self.settings.start_world_m), False
        self._path, self._size, self._unfinished = path, size, b""
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            raise DeviceError(f"{path}: cannot be opened ({error.strerror})") from error

    def _records(self) -> list[bytes]:
        """Return all records received since the last call; raise `DeviceError` if the device is gone."""
        try:
            received = os.read(self._file, _MOST_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise DeviceError(f"{self._path}: the device has disappeared ({error.strerror})") from error
        if not received:
            raise DeviceError(f"{self._path}: the device has disappeared (end of file)")
        received = self._unfinished + received
        end = len(received) - len(received) % self._size
        self._unfinished = received[end:]
        return [received[start : start + self._size] for start in range(0, end, self._size)]

    def _release(self) -> None:
        super()._release()
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


# Direction of each key, world axes.
_DIRECTIONS = {
    **{b"w": (1, 0, 0), b"s": (-1, 0, 0), b"a": (0, 1, 0), b"d": (0, -1, 0)},
    **{b"r": (0, 0, 1), b"f": (0, 0, -1)},
}


class KeyboardSettings(RecordSettings):
    """Settings of a keyboard, with the step of a key press."""

    step_m: Positive = 0.001  # motion of the goal for one key press [m]
    terminal: str = "/dev/tty"  # device file of the terminal


class Keyboard(RecordHand):
    """Reads keys as they are pressed, without echo; restores the terminal's settings at the end."""

    name = "keyboard"
    Settings = KeyboardSettings
    settings: KeyboardSettings

    def _open(self) -> None:
        self._open_file(self.settings.terminal, 1)
        try:
            self._before = termios.tcgetattr(self._file)
            modes = termios.tcgetattr(self._file)
            modes[3] &= ~(termios.ICANON | termios.ECHO)  # Ctrl-C stays a signal
            modes[6][termios.VMIN], modes[6][termios.VTIME] = 1, 0
            termios.tcsetattr(self._file, termios.TCSANOW, modes)
        except termios.error as error:
            super()._release()
            raise DeviceError(f"{self.settings.terminal}: is not a terminal") from error

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for key in self._records():
            self._goal_m += self.settings.step_m * np.array(_DIRECTIONS.get(key.lower(), (0, 0, 0)))
            self._select ^= key == b" "
        return self._goal_m, np.zeros(3), self._select

    def _release(self) -> None:
        if self._file >= 0:
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._file, termios.TCSANOW, self._before)
        super()._release()


_LEFT, _X_NEGATIVE, _Y_NEGATIVE = 0x01, 0x10, 0x20


class MouseSettings(RecordSettings):
    """Settings of a mouse, with the motion of the hand per count."""

    port: str = "/dev/input/mice"  # device file
    count_m: Positive = 5e-5  # motion of the goal for one count of the mouse [m]
    # World directions of the mouse's motion to the right and ahead, unit vectors.
    right_world: tuple[Number, Number, Number] = (1.0, 0.0, 0.0)
    ahead_world: tuple[Number, Number, Number] = (0.0, 0.0, 1.0)


class Mouse(RecordHand):
    """A mouse."""

    name = "mouse"
    Settings = MouseSettings
    settings: MouseSettings

    def _open(self) -> None:
        self._open_file(self.settings.port, 3)
        self._directions = np.array([self.settings.right_world, self.settings.ahead_world])

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        for buttons, right, ahead in self._records():
            counts = (right - 256 * bool(buttons & _X_NEGATIVE), ahead - 256 * bool(buttons & _Y_NEGATIVE))
            self._goal_m += self.settings.count_m * np.array(counts) @ self._directions
            self._select = bool(buttons & _LEFT)
        return self._goal_m, np.zeros(3), self._select


_EVENT = struct.Struct("=IhBB")
_BUTTON, _AXIS, _INITIAL = 0x01, 0x02, 0x80
_FULL = 32767.0

AxisNumber = Annotated[int, Field(ge=0, le=63)]


class GamepadSettings(RecordSettings):
    """Axes of the sticks; the defaults suit most pads, whose sticks return -1 when pushed away."""

    port: str = "/dev/input/js0"  # device file
    axes: tuple[AxisNumber, AxisNumber, AxisNumber] = (1, 0, 4)  # numbers of the axes for world x, y and z
    signs: tuple[Number, Number, Number] = (-1.0, -1.0, -1.0)  # signs of these axes along x, y and z
    speed_m_s: Positive = 0.05  # speed of the goal at full deflection [m/s]
    dead_zone: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.1  # share of the deflection that is ignored
    select_button: AxisNumber = 0  # number of the button


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


_BUTTONS, _POSITION, _VELOCITY = 0x2000, 0x2050, 0x2051
_CALIBRATION_STYLE, _MAX_FORCE, _FORCE = 0x2555, 0x2603, 0x2700
_FORCE_OUTPUT = 0x4000
_CALIBRATION_OK, _CALIBRATION_NEEDS_UPDATE = 0x5000, 0x5001
_SUCCESS, _INVALID_DEVICE = 0, 0xFFFFFFFF
_DONE, _CONTINUE = 0, 1
_DEFAULT_PRIORITY = 0x7FFF
_M_OF_MM = 1e-3
_WAIT_S = 5.0  # for the first sample
# World x is away from the operator, y to the left, z up.
_WORLD_OF_DEVICE = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

_Vector = ctypes.c_double * 3
_Callback = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)


class _ErrorInfo(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint), ("internal", ctypes.c_int), ("device", ctypes.c_uint))


class TouchSettings(FileModel):
    """The device, and the place of its work space in the world."""

    device: str | None = None  # name in the vendor's setup program; None for the default device
    library: str = "libHD.so"  # file of OpenHaptics
    origin_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)  # place of the device's origin [m]
    scale: Positive = 1.0  # world meters for each meter of the stylus
    watchdog_s: Positive = 0.02  # time without a new force after which none is rendered [s]
    oldest_s: Positive = 0.1  # longest time without a sample, after which the device has disappeared [s]
    select_button: Annotated[int, Field(ge=1, le=4)] = 1  # number of the button


class TouchDevice(OperatorDevice):
    """A haptic stylus."""

    name = "touch"
    Settings = TouchSettings
    settings: TouchSettings

    def __init__(self, settings: TouchSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._origin = np.array(settings.origin_world_m)
        self._library: ctypes.CDLL | None = None
        self._handle, self._servo = _INVALID_DEVICE, 0
        self._callback = _Callback(self._servo_step)  # kept: the library holds only its address
        self._state: HandState | None = None  # replaced as a whole, so the threads need no lock
        # In device axes (3,) [N], and when it was set [s].
        self._force: tuple[FloatArray, float] | None = None
        self._problem = ""
        self._first = threading.Event()

    def _open(self) -> None:
        self._state, self._force, self._problem = None, None, ""
        self._first.clear()
        library = self._library = _load(self.settings.library)
        name = self.settings.device
        self._handle = library.hdInitDevice(name.encode() if name else None)
        self._check("cannot be opened")
        if self._handle == _INVALID_DEVICE:
            raise DeviceError(f"touch: no device is called '{name or 'default'}'")
        if library.hdCheckCalibration() == _CALIBRATION_NEEDS_UPDATE:
            style = ctypes.c_int()
            library.hdGetIntegerv(_CALIBRATION_STYLE, ctypes.byref(style))
            library.hdUpdateCalibration(style.value)
        if library.hdCheckCalibration() != _CALIBRATION_OK:
            raise DeviceError("touch: not calibrated; put the stylus into its inkwell and try again")
        largest_force = _Vector()
        library.hdGetDoublev(_MAX_FORCE, largest_force)
        self._most_n = largest_force[0]
        library.hdEnable(_FORCE_OUTPUT)
        self._servo = library.hdScheduleAsynchronous(self._callback, None, _DEFAULT_PRIORITY)
        library.hdStartScheduler()
        self._check("the servo loop does not start")
        if not self._first.wait(_WAIT_S):
            raise DeviceError(f"touch: no sample within {_WAIT_S:g} s{self._reason_suffix()}")

    def _hand(self) -> HandState:
        state, oldest_s = self._state, self.settings.oldest_s
        if state is None or self._problem or self.clock.now_s() - state.sampled_at_s > oldest_s:
            raise DeviceError(
                f"touch: no sample for {oldest_s:g} s: the device has disappeared{self._reason_suffix()}"
            )
        return state

    def _power(self, *, on: bool) -> None:
        self._force = None

    def _push(self, force_world_n: FloatArray) -> FloatArray:
        size_n = float(np.linalg.norm(force_world_n))
        rendered_n = force_world_n * min(1.0, self._most_n / size_n) if size_n > 0.0 else force_world_n
        self._force = _WORLD_OF_DEVICE.T @ rendered_n, self.clock.now_s()
        return rendered_n

    def _release(self) -> None:
        library, self._library = self._library, None
        if library is None:
            return
        if self._servo:
            library.hdStopScheduler()
            library.hdUnschedule(self._servo)
        if self._handle != _INVALID_DEVICE:
            library.hdDisable(_FORCE_OUTPUT)
            library.hdDisableDevice(self._handle)
        self._handle, self._servo = _INVALID_DEVICE, 0

    def _servo_step(self, _data: object) -> int:
        """Callback of the library, called 1000 times per second in its own thread; must not raise."""
        try:
            self._exchange()
        except Exception as error:  # `read` reports it
            self._problem = str(error)
            return _DONE
        return _CONTINUE

    def _exchange(self) -> None:
        library = self._library
        if library is None:
            return
        position, velocity, force, buttons = _Vector(), _Vector(), _Vector(), ctypes.c_int()
        library.hdBeginFrame(self._handle)
        library.hdGetDoublev(_POSITION, position)
        library.hdGetDoublev(_VELOCITY, velocity)
        library.hdGetIntegerv(_BUTTONS, ctypes.byref(buttons))
        now_s = self.clock.now_s()
        newest = self._force
        if newest is not None and now_s - newest[1] <= self.settings.watchdog_s:
            force[:] = newest[0].tolist()
        library.hdSetDoublev(_FORCE, force)
        library.hdEndFrame(self._handle)
        self._check("the servo loop failed")
        scale = self.settings.scale * _M_OF_MM
        self._state = HandState(
            self._origin + scale * (_WORLD_OF_DEVICE @ np.array(position)),
            scale * (_WORLD_OF_DEVICE @ np.array(velocity)),
            now_s,
            bool(buttons.value & 1 << self.settings.select_button - 1),
        )
        self._first.set()

    def _check(self, problem: str) -> None:
        error = self._library.hdGetError() if self._library else _ErrorInfo()
        if error.code != _SUCCESS:
            raise DeviceError(f"touch: {problem} (HD error 0x{error.code:04x}, internal {error.internal})")

    def _reason_suffix(self) -> str:
        return f" ({self._problem})" if self._problem else ""


def _load(path: str) -> ctypes.CDLL:
    """Load the library and declare its functions; raise `DeviceError` if it is missing or incompatible."""
    try:
        library = ctypes.CDLL(path)
        unsigned, vector = ctypes.c_uint, ctypes.POINTER(ctypes.c_double)
        signatures: dict[str, tuple[object, list[object]]] = {
            "hdInitDevice": (unsigned, [ctypes.c_char_p]),
            "hdDisableDevice": (None, [unsigned]),
            "hdEnable": (None, [unsigned]),
            "hdDisable": (None, [unsigned]),
            "hdStartScheduler": (None, []),
            "hdStopScheduler": (None, []),
            "hdScheduleAsynchronous": (ctypes.c_ulong, [_Callback, ctypes.c_void_p, ctypes.c_ushort]),
            "hdUnschedule": (None, [ctypes.c_ulong]),
            "hdBeginFrame": (None, [unsigned]),
            "hdEndFrame": (None, [unsigned]),
            "hdGetDoublev": (None, [unsigned, vector]),
            "hdGetIntegerv": (None, [unsigned, ctypes.POINTER(ctypes.c_int)]),
            "hdSetDoublev": (None, [unsigned, vector]),
            "hdGetError": (_ErrorInfo, []),
            "hdCheckCalibration": (unsigned, []),
            "hdUpdateCalibration": (None, [unsigned]),
        }
        for name, (result, arguments) in signatures.items():
            call = getattr(library, name)
            call.restype, call.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise DeviceError(f"touch: OpenHaptics cannot be loaded from {path} ({error})") from error
    return library
