"""What an operator's device does: tells where the hand is, and pushes it. All in world axes, SI units.

A device is read and commanded once a step of the haptic loop and blocks it no longer than the device itself
takes to answer. Devices without motors (keyboard, gamepad) push a modelled hand (`modelled_hand`).
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

from robot_io.clock import Clock
from robot_io.errors import LifecycleError
from robot_io.files.file_model import FileModel
from robot_io.lifecycle import Opened
from robot_io.types import FloatArray, frozen_array


class Hand(NamedTuple):
    """The device's tip at one time."""

    position_world_m: FloatArray  # shape (3,) [m]
    velocity_world_m_s: FloatArray  # shape (3,) [m/s]
    sampled_at_s: float  # on the device's clock [s]
    select: bool = False  # whether the operator asks to probe here (button held down)


class OperatorDevice(Opened):
    """A device of an operator, found by its `name`. As a context manager it opens on entry, closes on exit.

    A new device implements `_open` and the four methods after it; lifecycle and checks are the same for all.
    Its settings are of its own `Settings`.
    """

    name: ClassVar[str]  # how files and options call it
    Settings: ClassVar[type[FileModel]]  # what a file may set; every key but the necessary has a default

    def __init__(self, settings: Any, clock: Clock) -> None:  # noqa: ANN401 (each device's own Settings)
        self.settings = settings
        self.clock = clock
        self._is_open = self._is_active = False

    def configure(self) -> None:
        """Open the device; positions can be read, and no force is rendered.

        DeviceError: it is absent or is another one.
        """
        if self._is_open:
            raise LifecycleError(f"{self.name}: configured already")
        try:
            self._open()
        except BaseException:
            self._release()
            raise
        self._is_open = True

    def activate(self) -> None:
        """Make ready for forces. DeviceError: the device refused; LifecycleError: not configured."""
        self._expect(self._is_open, "activate", "configured")
        self._power(on=True)
        self._is_active = True

    def read(self) -> Hand:
        """Where the tip is now. LifecycleError: not configured; DeviceError: the device is gone."""
        self._expect(self._is_open, "read", "configured")
        return self._hand()

    def set_force(self, force_world_n: FloatArray) -> FloatArray:
        """Push the hand with this force, shape (3,) [N], until the next call.

        Returns:
            What is really rendered, within the device's range; shape (3,) [N].

        Raises:
            InputError: not three finite values; the last force holds.
            LifecycleError: not active.
            DeviceError: the device is gone.
        """
        self._expect(self._is_active, "set_force", "active")
        return self._push(frozen_array(force_world_n, (3,), what=f"{self.name}: force"))

    def deactivate(self) -> None:
        """Force off. Works in every state, and can be called again."""
        if self._is_active:
            self._is_active = False
            self._power(on=False)

    def close(self) -> None:
        """Force off, then release the device. Can be called again."""
        try:
            self.deactivate()
        finally:
            if self._is_open:
                self._is_open = False
                self._release()

    def _expect(self, holds: bool, call: str, state: str) -> None:
        if not holds:
            raise LifecycleError(f"{self.name}: {call} needs a device that is {state}")

    @abstractmethod
    def _open(self) -> None:
        """Find and open the device."""

    @abstractmethod
    def _hand(self) -> Hand:
        """Read it."""

    @abstractmethod
    def _power(self, *, on: bool) -> None:
        """Motors on at zero force, or off."""

    @abstractmethod
    def _push(self, force_world_n: FloatArray) -> FloatArray:
        """Render a force of three finite values, and return what is really rendered."""

    @abstractmethod
    def _release(self) -> None:
        """Close what `_open` opened, all or half of it."""
