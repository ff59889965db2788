"""An operator by script: a hand that follows waypoints."""

from itertools import pairwise
from math import inf
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from robot_io.clock import Clock
from robot_io.files.file_model import FileModel, NotNegative, Number, problem_at
from robot_io.operator.device import HandSettings, ModelledHand
from robot_io.types import FloatArray


class Waypoint(FileModel):
    """Goal of the hand at a time, and whether it holds the button from there on."""

    time_s: NotNegative  # since the device was activated [s]
    position_world_m: tuple[Number, Number, Number]
    select: bool = False


class ScriptedSettings(HandSettings):
    """Waypoints of the script."""

    path: Annotated[tuple[Waypoint, ...], Field(min_length=1, max_length=10_000)]

    @model_validator(mode="after")
    def _times_rise(self) -> "ScriptedSettings":
        times_s = [waypoint.time_s for waypoint in self.path]
        if any(later <= earlier for earlier, later in pairwise(times_s)):
            raise problem_at("path", "the times of the waypoints must rise")
        return self


class ScriptedOperator(ModelledHand):
    """Moves between waypoints with the least jerk, as hands do (Flash and Hogan, J. Neurosci. 5, 1985).

    The script's time begins when the device is opened, and anew when it is activated.
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
