"""Everything a picture of a probing session may need, worked out once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from control.loop.task import Phase
from control.loop.tick_record import STREAM_NAME
from estimation.data.tick_check import checked_ticks
from estimation.estimate import Estimate, ParameterEstimate
from robot_io.errors import InputError
from robot_io.session import Event, Session
from robot_io.types import BoolArray, FloatArray, IntArray

Columns = Mapping[str, NDArray[Any]]
IN_CONTACT = (Phase.LOADING, Phase.HOLD, Phase.UNLOADING)
PICTURES_HZ = 60.0  # in 3D; the curves keep every tick
_VECTORS = (  # with one joint a session reads them back as scalars
    *("joint_position_rad", "joint_velocity_rad_s", "reference_position_rad", "reference_velocity_rad_s"),
    *("torque_measured_nm", "torque_commanded_nm", "torque_sent_nm"),
)


@dataclass(frozen=True)
class Scene:
    """A probing session as the recording shows it."""

    name: str  # what to call it
    ticks: Columns  # columns of the "tick" stream, n rows
    urdf: str  # text of the arm's URDF, empty if there is none
    events: tuple[Event, ...] = ()  # what happened
    estimate: Estimate | None = None  # outcome of the best offline estimator, if one was run
    # Coordinate of the surface along the press direction [m], None if nothing was touched.
    surface_m: float | None = None
    # True parameters by name (as in `estimate`), where the session is simulated.
    truth: Mapping[str, float] = field(default_factory=dict)
    summary: str = ""  # markdown for people

    @property
    def time_s(self) -> FloatArray:
        """Time of each tick from the first one, shape (n,) [s]."""
        since_start: FloatArray = self.ticks["time_s"] - self.ticks["time_s"][0]
        return since_start

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.ticks["joint_position_rad"].shape[1])

    def found(self, parameter: str) -> ParameterEstimate | None:
        """The offline estimate of a parameter, None where there is none."""
        parameters = self.estimate.parameters if self.estimate is not None else ()
        return next((found for found in parameters if found.name == parameter), None)

    @property
    def press_direction_world(self) -> FloatArray:
        """Unit vector into the object, shape (n, 3)."""
        direction: FloatArray = self.ticks["press_direction_world"]
        return direction

    @property
    def depth_m(self) -> FloatArray | None:
        """Displacement into the object, shape (n,), negative above it [m]; None where nothing was touched."""
        if self.surface_m is None:
            return None
        tips = self.ticks["tip_position_world_m"]
        along: FloatArray = np.einsum("ij,ij->i", tips, self.press_direction_world)
        return along - self.surface_m

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

    @property
    def picture_rows(self) -> IntArray:
        """Indices of the ticks that are drawn in 3D."""
        return picture_rows(self.time_s)

    @property
    def picture_moment_s(self) -> float:
        """While the force is held for the last time, or the middle of the session [s]."""
        holding = np.flatnonzero(self.ticks["phase"] == Phase.HOLD)
        if not len(holding):
            return float(self.time_s[len(self.time_s) // 2])
        of_last = holding[self.ticks["run"][holding] == self.ticks["run"][holding[-1]]]
        return float(self.time_s[of_last[len(of_last) // 2]])


def picture_rows(time_s: FloatArray) -> IntArray:
    """Indices of times (n,) [s] that are drawn in 3D, `PICTURES_HZ` of them a second, and the last."""
    grid = np.arange(time_s[0], time_s[-1], 1.0 / PICTURES_HZ)
    return np.unique(np.append(np.searchsorted(time_s, grid), len(time_s) - 1))


def has_ticks(session: Session) -> bool:
    """Whether the session was made by an arm, rather than imported."""
    return STREAM_NAME in session.stream_names and len(session.samples(STREAM_NAME)) > 1


def tick_columns(session: Session) -> Columns:
    """Columns of the "tick" stream; one value a joint even where the arm has a single joint.

    Raises:
        InputError: there are none.
    """
    if not has_ticks(session):
        streams = ", ".join(session.stream_names)
        raise InputError(f"{session.path}: holds no ticks of an arm (streams: {streams})")
    samples = checked_ticks(session)
    return {name: samples.vector(name) if name in _VECTORS else samples[name] for name in samples}


def last_known(values: FloatArray) -> float | None:
    """The last finite value, None where there is none."""
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else None
