"""Interface of operator devices, which read the hand and push it; world axes, SI units.

A device is read and commanded once a step of the haptic loop, and blocks it no longer than the device itself
takes to answer. Devices without motors (keyboard, gamepad) push a modeled hand that follows a goal and
yields to forces:

    m a = K (x_goal - x) + B (v_goal - v) + force

So a key or a stick presses with a bounded force, and the depth depends on the object.
"""

from abc import abstractmethod
from itertools import pairwise
from math import inf
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import LifecycleError
from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive, problem_at
from palpate.robot_io.interfaces import ManagedDevice
from palpate.robot_io.types import FloatArray, frozen_array


class HandState(NamedTuple):
    """State of the device's tip at one time."""

    position_world_m: FloatArray  # shape (3,) [m]
    velocity_world_m_s: FloatArray  # shape (3,) [m/s]
    sampled_at_s: float  # on the device's clock [s]
    select: bool = False  # whether the operator asks to probe here (button held down)


class OperatorDevice(ManagedDevice):
    """A device of an operator, found by its `name`. As a context manager, it opens and closes itself.

    A new device implements `_open` and the four methods after it; lifecycle and checks are the same for all.
    """

    name: ClassVar[str]  # how files and options call it
    Settings: ClassVar[type[FileModel]]  # settings of a file; all optional keys have a default

    def __init__(self, settings: Any, clock: Clock) -> None:  # noqa: ANN401 (each device's own Settings)
        self.settings = settings
        self.clock = clock
        self._is_open = self._is_active = False

    def configure(self) -> None:
        """Open the device, without a force; raise `DeviceError` if it is absent or a different model."""
        if self._is_open:
            raise LifecycleError(f"{self.name}: already configured")
        try:
            self._open()
        except BaseException:
            self._release()
            raise
        self._is_open = True

    def activate(self) -> None:
        """Prepare for forces; raise `DeviceError` if refused, `LifecycleError` if not configured."""
        self._expect(self._is_open, "activate", "configured")
        self._power(on=True)
        self._is_active = True

    def read(self) -> HandState:
        """Read the tip's state; raise `DeviceError` if it is gone, `LifecycleError` if not configured."""
        self._expect(self._is_open, "read", "configured")
        return self._hand()

    def set_force(self, force_world_n: FloatArray) -> FloatArray:
        """Push the hand until the next call; return the force within the device's range, shape (3,) [N].

        Args:
            force_world_n: shape (3,) [N].

        Raises:
            InputError: not three finite values; the last force holds.
            LifecycleError: not active.
            DeviceError: the device has disappeared.
        """
        self._expect(self._is_active, "set_force", "active")
        return self._push(frozen_array(force_world_n, (3,), what=f"{self.name}: force"))

    def deactivate(self) -> None:
        """Switch the force off. Works in every state, and can be called repeatedly."""
        if self._is_active:
            self._is_active = False
            self._power(on=False)

    def close(self) -> None:
        """Switch the force off and release the device; can be called repeatedly."""
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
    def _hand(self) -> HandState:
        """Read the state of the tip."""

    @abstractmethod
    def _power(self, *, on: bool) -> None:
        """Switch the motors on at zero force, or off."""

    @abstractmethod
    def _push(self, force_world_n: FloatArray) -> FloatArray:
        """Render a force of three finite values, and return the rendered force."""

    @abstractmethod
    def _release(self) -> None:
        """Close everything that `_open` opened, even if it failed halfway."""


_STEP_S = 1e-3  # of the integration, at most


class HandSettings(FileModel):
    """Mass, stiffness and damping of the modeled hand."""

    mass_kg: Positive = 0.15  # of the device and the part of the hand that moves with it [kg]
    stiffness_n_m: Positive = 600.0  # K, between hand and goal [N/m]
    damping_n_s_m: NotNegative = 15.0  # B, between hand and goal [N s/m]


class ModeledHand(OperatorDevice):
    """A device that reports the goal of an operator whose hand is simulated."""

    settings: HandSettings

    def __init__(self, settings: HandSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._force = np.zeros(3)
        self._position: FloatArray | None = None  # (3,) [m], from the first reading on

    @abstractmethod
    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        """Compute the goal's position, velocity (3,) [m, m/s] and button; called in the order of time."""

    def _hand(self) -> HandState:
        now_s = self.clock.now_s()
        if self._position is None:
            self._position, self._velocity, self._time_s = self._goal(now_s)[0].copy(), np.zeros(3), now_s
        steps = max(1, int(np.ceil((now_s - self._time_s) / _STEP_S - 1e-6)))
        dt_s = (now_s - self._time_s) / steps
        for _ in range(steps):
            self._time_s += dt_s
            goal, velocity, select = self._goal(self._time_s)
            hand = self.settings  # implicit Euler is stable for any hand
            push = hand.stiffness_n_m * (goal - self._position) + hand.damping_n_s_m * velocity + self._force
            inertia_kg = hand.mass_kg + dt_s * (hand.damping_n_s_m + dt_s * hand.stiffness_n_m)
            self._velocity = (hand.mass_kg * self._velocity + dt_s * push) / inertia_kg
            self._position = self._position + dt_s * self._velocity
        return HandState(self._position.copy(), self._velocity.copy(), now_s, select)

    def _power(self, *, on: bool) -> None:
        self._force = np.zeros(3)

    def _push(self, force_world_n: FloatArray) -> FloatArray:
        self._force = force_world_n
        return force_world_n

    def _release(self) -> None:
        self._position = None


class Waypoint(FileModel):
    """Goal of the hand at a time, and whether it holds the button from there on."""

    time_s: NotNegative  # since the device was activated [s]
    position_world_m: tuple[Number, Number, Number]  # [m]
    select: bool = False  # whether the button is held from this time on


class ScriptedSettings(HandSettings):
    """Waypoints of the script."""

    path: Annotated[tuple[Waypoint, ...], Field(min_length=1, max_length=10_000)]

    @model_validator(mode="after")
    def _check_times_increase(self) -> "ScriptedSettings":
        times_s = [waypoint.time_s for waypoint in self.path]
        if any(later <= earlier for earlier, later in pairwise(times_s)):
            raise problem_at("path", "the times of the waypoints must increase")
        return self


class ScriptedOperator(ModeledHand):
    """Moves between waypoints with the least jerk, as hands do (Flash and Hogan, J. Neurosci. 5, 1985).

    The script's time begins when the device is opened, and restarts when it is activated.
    """

    name = "scripted"
    Settings = ScriptedSettings

    def __init__(self, settings: ScriptedSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._begun_s = inf
        self._path = [(w.time_s, np.array(w.position_world_m), w.select) for w in settings.path]

    @property
    def finished(self) -> bool:
        """Whether the last waypoint's time has passed."""
        return self.clock.now_s() - self._begun_s >= self._path[-1][0]

    def _open(self) -> None:
        self._begun_s = self.clock.now_s()

    def _power(self, *, on: bool) -> None:
        super()._power(on=on)
        if on:
            self._begun_s = self.clock.now_s()

    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        time_s = now_s - self._begun_s
        passed = sum(time_s >= waypoint_s for waypoint_s, _, _ in self._path)
        if passed in (0, len(self._path)):
            _, position, select = self._path[max(passed - 1, 0)]
            return position, np.zeros(3), select and passed > 0
        (start_s, start, select), (end_s, end, _) = self._path[passed - 1], self._path[passed]
        share = (time_s - start_s) / (end_s - start_s)
        moved = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        speed = 30.0 * share**2 * (1.0 - share) ** 2 / (end_s - start_s)
        return start + moved * (end - start), speed * (end - start), select
