"""Who moves the arm while its signs are looked at: a person, or what stands behind emulated devices."""

from abc import ABC, abstractmethod

import numpy as np

from palpate import console
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray
from sim_backend.emulators.plant import Plant

_TURN_S, _TURN_RAD = 0.4, 0.25  # of the emulated hand
_PRESS_S, _PRESS_N = 0.3, 5.0
_AWAY_M = 0.05


class Hand(ABC):
    """Does what it is told, while the arm has no torque."""

    patience_s: float

    @abstractmethod
    def turn(self, joint: int, words: str) -> None:
        """Begin to turn a joint (from 0) forwards; `words` say what that looks like."""

    @abstractmethod
    def press(self, words: str) -> None:
        """Begin to press against the tool."""

    def go_on(self, elapsed_s: float) -> None:
        """Time has passed since what was begun last [s]. A person needs no telling."""
        return

    def rest(self) -> None:
        """Let the arm go back, and hold still."""
        return

    def leave(self) -> None:
        """Take every hand off the arm."""
        return

    def count(self, left_s: int) -> None:
        """So many seconds are left until the arm gets power."""
        return


class Person(Hand):
    """Somebody at the arm, who reads what to do."""

    patience_s = 30.0

    def turn(self, joint: int, words: str) -> None:
        """See `Hand.turn`."""
        console.stderr().print(f"[bold]Turn joint {joint + 1} by hand[/bold], by about 15 degrees: {words}")

    def press(self, words: str) -> None:
        """See `Hand.press`."""
        console.stderr().print(f"[bold]Press gently with a finger[/bold] {words}")

    def rest(self) -> None:
        """See `Hand.rest`."""
        console.stderr().print("Let it go back, and hold still.")

    def leave(self) -> None:
        """See `Hand.leave`."""
        console.stderr().print("[bold]Hands away from the arm[/bold]")

    def count(self, left_s: int) -> None:
        """See `Hand.count`."""
        console.stderr().print(f"[bold]Hands away:[/bold] power in {left_s} s")


class EmulatedHand(Hand):
    """Moves the simulated arm behind emulated devices, by its true angles.

    Args:
        plant: what stands behind the devices.
        robot_file: the arm.
    """

    patience_s = 1.0

    def __init__(self, plant: Plant, robot_file: RobotFile) -> None:
        self._world = plant.world
        self._home_rad: FloatArray = np.array(robot_file.home_rad)
        self._joint: int | None = None
        self._pressing = False
        self._away_m = self._world.truth().tip_position_world_m[2] - _AWAY_M

    def turn(self, joint: int, words: str) -> None:
        """See `Hand.turn`."""
        self._joint, self._pressing = joint, False

    def press(self, words: str) -> None:
        """See `Hand.press`: the surface is brought up to the tool, which points down at home."""
        self._joint, self._pressing = None, True

    def go_on(self, elapsed_s: float) -> None:
        """See `Hand.go_on`."""
        self._world.held = True
        angles_rad = self._home_rad.copy()
        if self._joint is not None:
            angles_rad[self._joint] += _TURN_RAD * min(1.0, elapsed_s / _TURN_S)
            self._world.place(angles_rad)
        if self._pressing:
            self._press(elapsed_s)

    def _press(self, elapsed_s: float) -> None:
        law = self._world.object.law
        depth_m = _PRESS_N / getattr(law, "stiffness_n_m", 1e3) * min(1.0, elapsed_s / _PRESS_S)
        tip_m = self._world.truth().tip_position_world_m[2]
        self._world.object.move_surface(tip_m + depth_m)

    def rest(self) -> None:
        """See `Hand.rest`."""
        self._joint, self._pressing = None, False
        self._world.object.move_surface(self._away_m)
        self._world.place(self._home_rad)
