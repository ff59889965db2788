"""A hand that follows a goal and yields to forces as a hand does: the base of devices without motors.

    m a = K (x_goal - x) + B (v_goal - v) + force

So a key or a stick presses with a bounded force, and how deep it goes depends on the object.
"""

from abc import abstractmethod

import numpy as np

from robot_io.clock import Clock
from robot_io.files.file_model import FileModel, NotNegative, Positive
from robot_io.operator.device import Hand, OperatorDevice
from robot_io.types import FloatArray

_STEP_S = 1e-3  # of the integration, at most


class HandSettings(FileModel):
    """The hand."""

    mass_kg: Positive = 0.15  # of the device and what of the hand moves with it
    stiffness_n_m: Positive = 600.0
    damping_n_s_m: NotNegative = 15.0


class ModelledHand(OperatorDevice):
    """A device that says where the operator wants to be; the hand is modelled."""

    settings: HandSettings

    def __init__(self, settings: HandSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._force = np.zeros(3)
        self._position: FloatArray | None = None  # (3,) [m], from the first reading on

    @abstractmethod
    def _goal(self, now_s: float) -> tuple[FloatArray, FloatArray, bool]:
        """Goal (3,) [m], its velocity (3,) [m/s], and whether the button is held; called in order of time."""

    def _hand(self) -> Hand:
        now_s = self.clock.now_s()
        if self._position is None:
            self._position, self._velocity, self._time_s = self._goal(now_s)[0].copy(), np.zeros(3), now_s
        steps = max(1, int(np.ceil((now_s - self._time_s) / _STEP_S - 1e-6)))
        dt_s = (now_s - self._time_s) / steps
        for _ in range(steps):
            self._time_s += dt_s
            goal, velocity, select = self._goal(self._time_s)
            self._position = self._advance(self._position, goal, velocity, dt_s)
        return Hand(self._position.copy(), self._velocity.copy(), now_s, select)

    def _advance(
        self, position: FloatArray, goal: FloatArray, velocity: FloatArray, dt_s: float
    ) -> FloatArray:
        """Implicit Euler: stable for any hand. The new position (3,) [m]."""
        hand = self.settings
        push = hand.stiffness_n_m * (goal - position) + hand.damping_n_s_m * velocity + self._force
        inertia_kg = hand.mass_kg + dt_s * (hand.damping_n_s_m + dt_s * hand.stiffness_n_m)
        self._velocity = (hand.mass_kg * self._velocity + dt_s * push) / inertia_kg
        return position + dt_s * self._velocity

    def _power(self, *, on: bool) -> None:
        self._force = np.zeros(3)

    def _push(self, force_world_n: FloatArray) -> FloatArray:
        self._force = force_world_n
        return force_world_n

    def _release(self) -> None:
        self._position = None
