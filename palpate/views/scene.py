"""Everything a picture of a session may need, worked out once."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from control.loop.phases import Phase
from estimation.estimate import Estimate, ParameterEstimate
from palpate.views.columns import Columns
from robot_io.session import Event
from robot_io.types import BoolArray, FloatArray

IN_CONTACT = (Phase.LOADING, Phase.HOLD, Phase.UNLOADING)


@dataclass(frozen=True)
class Scene:
    """A probing session as the views see it.

    Attributes:
        name: what to call it.
        ticks: columns of the "tick" stream, n rows.
        urdf: text of the arm's URDF, empty if there is none.
        events: what happened.
        estimate: outcome of the best offline estimator, if one was run.
        surface_m: coordinate of the surface along the press direction [m], None if nothing was touched.
        truth: true parameters by name (as in `estimate`), where the session is simulated.
        summary: markdown for people.
    """

    name: str
    ticks: Columns
    urdf: str
    events: tuple[Event, ...] = ()
    estimate: Estimate | None = None
    surface_m: float | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    summary: str = ""

    @property
    def time_s(self) -> FloatArray:
        """Time of each tick from the first one, shape (n,) [s]."""
        since_start: FloatArray = self.ticks["time_s"] - self.ticks["time_s"][0]
        return since_start

    def found(self, parameter: str) -> ParameterEstimate | None:
        """The offline estimate of a parameter, None where there is none."""
        parameters = self.estimate.parameters if self.estimate is not None else ()
        return next((found for found in parameters if found.name == parameter), None)

    @property
    def depth_m(self) -> FloatArray | None:
        """Displacement into the object, shape (n,), negative above it [m]; None where nothing was touched."""
        if self.surface_m is None:
            return None
        along: FloatArray = np.einsum(
            "ij,ij->i", self.ticks["tip_position_world_m"], self.press_direction_world
        )
        return along - self.surface_m

    @property
    def press_direction_world(self) -> FloatArray:
        """Unit vector into the object, shape (n, 3)."""
        direction: FloatArray = self.ticks["press_direction_world"]
        return direction

    @property
    def main_press_direction_world(self) -> FloatArray:
        """Mean direction into the object, shape (3,), NaN where it was never known."""
        known = np.isfinite(self.press_direction_world).all(axis=1)
        mean: FloatArray = self.press_direction_world[known].sum(axis=0)
        return mean / np.linalg.norm(mean) if known.any() else np.full(3, np.nan)

    @property
    def known_tip(self) -> BoolArray:
        """Ticks at which place and direction of the tip are known: not while the guard stops the arm."""
        places = np.hstack([self.ticks["tip_position_world_m"], self.press_direction_world])
        known: BoolArray = np.isfinite(places).all(axis=1)
        return known

    @property
    def touch_point_world_m(self) -> FloatArray | None:
        """Middle of the touched places on the surface, shape (3,) [m]; None where nothing was touched."""
        touching = np.isin(self.ticks["phase"], IN_CONTACT)
        if self.surface_m is None or not touching.any():
            return None
        press = self.main_press_direction_world
        point = np.asarray(self.ticks["tip_position_world_m"])[touching].mean(axis=0)
        on_surface: FloatArray = point + (self.surface_m - point @ press) * press
        return on_surface
