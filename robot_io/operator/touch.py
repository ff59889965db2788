"""Touch and other devices of 3D Systems, through their OpenHaptics library (libHD) if it is installed.

Calls, constants and units (mm, mm/s, N; x to the right, y up, z towards the operator) are those of the
"OpenHaptics Toolkit API Reference Guide", HDAPI. The library runs a servo loop of 1 kHz of its own, in which
a callback exchanges motion and force with ours; without a new force for `watchdog_s` it renders none.
"""

import ctypes
import threading
from typing import Annotated

import numpy as np
from pydantic import Field

from robot_io.clock import Clock
from robot_io.errors import DeviceError
from robot_io.files.file_model import FileModel, Number, Positive
from robot_io.operator.device import HandState, OperatorDevice
from robot_io.types import FloatArray

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

    device: str | None = None  # its name in the vendor's setup program; None: the default one
    library: str = "libHD.so"
    origin_world_m: tuple[Number, Number, Number] = (0.4, 0.0, 0.15)  # of the device's own origin
    scale: Positive = 1.0  # world metres for each metre of the stylus
    watchdog_s: Positive = 0.02
    oldest_s: Positive = 0.1  # no sample for so long: the device is gone
    select_button: Annotated[int, Field(ge=1, le=4)] = 1


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
        _calibrate(library)
        most = _Vector()
        library.hdGetDoublev(_MAX_FORCE, most)
        self._most_n = most[0]
        library.hdEnable(_FORCE_OUTPUT)
        self._servo = library.hdScheduleAsynchronous(self._callback, None, _DEFAULT_PRIORITY)
        library.hdStartScheduler()
        self._check("the servo loop does not start")
        if not self._first.wait(_WAIT_S):
            raise DeviceError(f"touch: no sample within {_WAIT_S:g} s{self._because()}")

    def _hand(self) -> HandState:
        state, oldest_s = self._state, self.settings.oldest_s
        if state is None or self._problem or self.clock.now_s() - state.sampled_at_s > oldest_s:
            raise DeviceError(f"touch: no sample for {oldest_s:g} s, the device is gone{self._because()}")
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
        """Callback of the library, 1000 times a second in its own thread; must not raise."""
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

    def _because(self) -> str:
        return f" ({self._problem})" if self._problem else ""


def _calibrate(library: ctypes.CDLL) -> None:
    if library.hdCheckCalibration() == _CALIBRATION_NEEDS_UPDATE:
        style = ctypes.c_int()
        library.hdGetIntegerv(_CALIBRATION_STYLE, ctypes.byref(style))
        library.hdUpdateCalibration(style.value)
    if library.hdCheckCalibration() != _CALIBRATION_OK:
        raise DeviceError("touch: not calibrated; put the stylus into its inkwell and try again")


def _load(path: str) -> ctypes.CDLL:
    """The library with the types of its calls. DeviceError: it is not installed, or is another one."""
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
