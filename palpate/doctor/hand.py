"""Who moves the arm while its signs are looked at: a person, or what stands behind emulated devices."""

import numpy as np

from palpate.common import console
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray
from sim_backend.emulators.bench import Plant

_TURN_S, _TURN_RAD = 0.4, 0.25  # of the emulated hand
_PRESS_S, _PRESS_N = 0.3, 5.0
_AWAY_M = 0.05


class Hand:
    """A person at the arm, which has no torque, who reads what to do."""

    patience_s = 30.0

    def turn(self, joint: int, words: str) -> None:
        """Begin to turn a joint (from 0) forwards; `words` say what that looks like."""
        console.stderr().print(f"[bold]Turn joint {joint + 1} by hand[/bold], by about 15 degrees: {words}")

    def press(self, words: str) -> None:
        """Begin to press against the tool."""
        console.stderr().print(f"[bold]Press gently with a finger[/bold] {words}")

    def go_on(self, elapsed_s: float) -> None:
        """Time has passed since what was begun last [s]. A person needs no telling."""

    def rest(self) -> None:
        """Let the arm go back, and hold still."""
        console.stderr().print("Let it go back, and hold still.")

    def leave(self) -> None:
        """Take every hand off the arm."""
        console.stderr().print("[bold]Hands away from the arm[/bold]")

    def count(self, left_s: int) -> None:
        """So many seconds are left until the arm gets power."""
        console.stderr().print(f"[bold]Hands away:[/bold] power in {left_s} s")


class EmulatedHand(Hand):
    """Moves the simulated arm behind emulated devices, by its true angles; says nothing."""

    patience_s = 1.0

    def __init__(self, plant: Plant, robot_file: RobotFile) -> None:
        self._world = plant.world
        self._home_rad: FloatArray = np.array(robot_file.home_rad)
        self._joint: int | None = None
        self._pressing = False
        self._away_m = self._world.truth().tip_position_world_m[2] - _AWAY_M

    def turn(self, joint: int, words: str) -> None:
        self._joint, self._pressing = joint, False

    def press(self, words: str) -> None:
        """See `Hand.press`: the surface is brought up to the tool, which points down at home."""
        self._joint, self._pressing = None, True

    def go_on(self, elapsed_s: float) -> None:
        world = self._world
        world.held = True
        if self._joint is not None:
            angles_rad = self._home_rad.copy()
            angles_rad[self._joint] += _TURN_RAD * min(1.0, elapsed_s / _TURN_S)
            world.place(angles_rad)
        if self._pressing:
            stiffness_n_m = getattr(world.object.law, "stiffness_n_m", 1e3)
            depth_m = _PRESS_N / stiffness_n_m * min(1.0, elapsed_s / _PRESS_S)
            world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)

    def rest(self) -> None:
        self._joint, self._pressing = None, False
        self._world.object.move_surface(self._away_m)
        self._world.place(self._home_rad)

    def leave(self) -> None:
        """See `Hand.leave`."""

    def count(self, left_s: int) -> None:
        """See `Hand.count`."""
