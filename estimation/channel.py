"""A channel: one measured effort with the corresponding motion."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_ARRAYS = ("time_s", "position", "velocity", "acceleration", "effort", "run", "phase")


# encoder steps that a press must cover: half a step at either end changes the slope by a quarter
FEWEST_STEPS = 4.0
_NO_DIRECTION = 1e-13  # eigenvalue relative to the largest below which columns are linearly dependent
# Arrays that were checked, by what they are: a fit makes thousands of channels of the same ones.
_checked: WeakValueDictionary[int, NDArray[Any]] = WeakValueDictionary()


@dataclass(frozen=True)
class Surface:
    """A surface along the press direction."""

    position_m: float  # coordinate along the press direction, in the frame of the tip positions [m]
    std_err_m: float  # its standard error [m]; NaN if there is none
    # The least coordinate at which the touch still allows it; -inf if nothing is known [m].
    highest_m: float = float("-inf")
    deepest_m: float = float("inf")  # the greatest; inf if nothing is known [m]


@dataclass(frozen=True)
class Tare:
    """Effort in free air for each of r runs, to be subtracted (tare).

    A run's tare is a mean of noisy samples. Its error is the same in all samples of the run, so that more of
    them do not average it out.
    """

    run: IntArray  # their numbers, ascending, shape (r,)
    effort: FloatArray  # mean in free air, shape (r,)
    std_err: FloatArray  # its standard error, shape (r,)

    def of(self, run: IntArray) -> FloatArray:
        """Effort to subtract from each sample of these runs, shape (n,).

        Args:
            run: number of each sample's run, shape (n,).
        """
        offset: FloatArray = self.effort[self.index(run)]
        return offset

    def index(self, run: IntArray) -> IntArray:
        """Place of each sample's run among the runs with a tare, shape (n,).

        Args:
            run: number of each sample's run, shape (n,).
        """
        return np.searchsorted(self.run, run)


@dataclass(frozen=True)
class Information:
    """A quadratic objective beta' matrix beta / 2 - vector' beta, of one fit or several."""

    matrix: FloatArray  # shape (..., s, s), symmetric
    vector: FloatArray  # shape (..., s)

    def __add__(self, other: "Information") -> "Information":
        return Information(self.matrix + other.matrix, self.vector + other.vector)

    def times(self, factor: float) -> "Information":
        """Scale by a noise variance, for normal equations that are not divided by it.

        Args:
            factor: variance of the noise, in the unit of the effort squared.
        """
        return Information(factor * self.matrix, factor * self.vector)

    def about(self, chosen: IntArray | BoolArray) -> "Information":
        """Profile out all other parameters (Schur complement).

        Args:
            chosen: indices or mask of the parameters that are kept.
        """
        kept = np.zeros(self.vector.shape[-1], dtype=np.bool_)
        kept[chosen] = True
        cross = self.matrix[..., kept, :][..., ~kept] @ pseudo_inverse(self.matrix[..., ~kept, :][..., ~kept])
        matrix = self.matrix[..., kept, :][..., kept] - cross @ self.matrix[..., ~kept, :][..., kept]
        vector = self.vector[..., kept] - (cross @ self.vector[..., ~kept, None])[..., 0]
        return Information(0.5 * (matrix + np.swapaxes(matrix, -1, -2)), vector)


def pseudo_inverse(matrices: FloatArray) -> FloatArray:
    """Invert symmetric matrices (..., k, k), whatever the columns' units.

    Args:
        matrices: symmetric, shape (..., k, k).
    """
    scale = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    scale = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    scaled = matrices * scale[..., :, None] * scale[..., None, :]
    inverse = np.linalg.pinv(scaled, rcond=_NO_DIRECTION, hermitian=True)
    return np.asarray(inverse * scale[..., :, None] * scale[..., None, :])


class ChannelKind(StrEnum):
    """Kind of a channel, which determines the effects that apply."""

    CONTACT = "contact"  # position: depth into the object [m]; effort: force, positive in compression [N]
    REVOLUTE = "revolute"  # position: joint angle [rad]; effort: joint torque [N m]
    PRISMATIC = "prismatic"  # position: joint displacement [m]; effort: joint force [N]
    # Position: angle of a servo's output [rad]; effort: goal minus position [rad], torque over position gain.
    SERVO = "servo"

    @property
    def effort_unit(self) -> str:
        """Unit of the effort."""
        return {ChannelKind.REVOLUTE: "N m", ChannelKind.SERVO: "rad"}.get(self, "N")

    @property
    def position_unit(self) -> str:
        """Unit of the position."""
        return "rad" if self.is_angle else "m"

    @property
    def inertia_unit(self) -> str:
        """Unit of effort over acceleration."""
        return {ChannelKind.REVOLUTE: "kg m^2", ChannelKind.SERVO: "s^2"}.get(self, "kg")

    @property
    def is_angle(self) -> bool:
        """Whether the position is an angle."""
        return self in (ChannelKind.REVOLUTE, ChannelKind.SERVO)


JOINTS = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC, ChannelKind.SERVO})


@dataclass(frozen=True)
class SharedGains:
    """Information of an arm's other channels on gains that a channel shares with them."""

    names: tuple[str, ...]  # of the s gains, "effect.parameter"
    # Matrix (1 + folds, s, s) and vector (1 + folds, s), from all runs and from all but each fold of runs, in
    # units of this channel's squared residuals.
    information: Information


@dataclass(frozen=True)
class ChannelData:
    """One channel's samples; all arrays have length n, belong together row by row, and are read-only."""

    name: str  # "contact", "joint_1" ...
    kind: ChannelKind  # decides the units, see `ChannelKind`
    time_s: FloatArray  # strictly increasing within a run [s]
    position: FloatArray  # see `ChannelKind`
    velocity: FloatArray  # derivative of position, without phase error
    acceleration: FloatArray  # second derivative of position, without phase error
    effort: FloatArray  # what was measured and is to be explained
    run: IntArray  # number of the run (one approach, one recording) that each sample belongs to
    phase: IntArray  # numbers of `palpate.control.loop.task.Phase`, or -1 where unknown
    # Other signals that an effect may need, by name, each of shape (n,) or (n, k); the face shows which are
    # there. `joint_position`, `joint_velocity`, `joint_acceleration` (n, joints) for an arm; `load` (n,), the
    # effort a joint carries apart from friction.
    context: Mapping[str, FloatArray] = field(default_factory=dict)
    # Where the surface was found from which position counts; None where displacement was given.
    surface: Surface | None = None
    tare: Tare | None = None  # what was subtracted from the measured effort; None if nothing
    # Names of those signals of the context that a user recorded beside,
    # such as a temperature; each of shape (n,).
    recorded: frozenset[str] = frozenset()
    # Of the grid on which the position was read, such as an encoder's steps; 0 where there is none.
    position_step: float = 0.0
    # Samples of a contact that are known to press, however deep they seem,
    # shape (n,); None where the depth alone says so.
    touching: BoolArray | None = None
    shared: SharedGains | None = None  # what other channels say of gains; None where nothing is shared
    averaged: int = 1  # readings that each sample is the mean of

    def __post_init__(self) -> None:
        """Check lengths, finiteness, and that what was recorded is there.

        Raises:
            InputError: an array has the wrong length or shape, is missing, or is not finite.
        """
        for what in (*_ARRAYS, "touching"):
            object.__setattr__(self, what, _read_only(getattr(self, what)))
        context = {what: _read_only(values) for what, values in self.context.items()}
        object.__setattr__(self, "context", MappingProxyType(context))
        length = len(self.time_s)
        touching = {} if self.touching is None else {"touching": self.touching}
        arrays = {what: getattr(self, what) for what in _ARRAYS} | touching | context
        for what, values in arrays.items():
            _check(self.name, what, values, length)
        for what in sorted(self.recorded):
            if what not in self.context or self.context[what].ndim != 1:
                raise InputError(
                    f"channel '{self.name}': recorded signal '{what}' is not one number a sample"
                )

    def __reduce__(self) -> tuple[type["ChannelData"], tuple[object, ...]]:
        """Pickle the context as a dict, since a read-only view of it cannot be pickled."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return ChannelData, (*(values | {"context": dict(self.context)}).values(),)

    def __len__(self) -> int:
        """Number of samples n."""
        return len(self.time_s)

    @property
    def engaged(self) -> BoolArray:
        """Samples in which the object acts, shape (n,): contacts only while x > 0, other channels always."""
        if self.kind is ChannelKind.CONTACT:
            pressed: BoolArray = self.position > 0.0
            return pressed if self.touching is None else pressed | self.touching
        return np.ones(len(self), dtype=np.bool_)

    @property
    def rms_speed(self) -> float:
        """Root mean square of the velocity; 1 for a channel at rest."""
        return float(np.sqrt(np.mean(self.velocity**2))) or 1.0

    @property
    def range_of_motion(self) -> float:
        """Largest less smallest position; 1 for a channel at rest."""
        return float(np.ptp(self.position)) or 1.0

    @property
    def deepest(self) -> float:
        """Largest position, at least 1e-9: the deepest indentation of a contact."""
        return max(float(np.max(self.position, initial=0.0)), 1e-9)

    @property
    def largest_effort(self) -> float:
        """Largest absolute effort; 1 where there is none."""
        return float(np.max(np.abs(self.effort))) or 1.0

    @property
    def runs(self) -> IntArray:
        """Distinct run numbers, ascending."""
        return np.unique(self.run)

    def select(self, rows: BoolArray | IntArray) -> "ChannelData":
        """Return the channel with only some rows.

        Args:
            rows: a mask of shape (n,), or indices.
        """
        arrays = {what: getattr(self, what)[rows] for what in _ARRAYS}
        touching = None if self.touching is None else self.touching[rows]
        return replace(
            self,
            **arrays,
            touching=touching,
            shared=None,
            context={name: values[rows] for name, values in self.context.items()},
        )

    def of_runs(self, runs: IntArray) -> "ChannelData":
        """Return the channel with only the samples of some runs.

        Args:
            runs: numbers of the runs to keep.
        """
        return self.select(np.isin(self.run, runs))


def _check(channel: str, what: str, values: FloatArray | IntArray, length: int) -> None:
    if len(values) != length:
        raise InputError(f"channel '{channel}': {what} has {len(values)} samples, time_s has {length}")
    if _checked.get(id(values)) is values:
        return
    if not np.isfinite(values).all():
        bad = np.flatnonzero(~np.isfinite(values.reshape(length, -1)).all(axis=1))
        raise InputError(
            f"channel '{channel}': {what} is not finite at sample {bad[0]} (and {len(bad) - 1} more)"
        )
    _checked[id(values)] = values


def _read_only(values: NDArray[Any] | None) -> NDArray[Any] | None:
    """A read-only view of an array that its owner can still write to; None stays None."""
    if values is None or not values.flags.writeable:
        return values
    view = values.view()
    view.setflags(write=False)
    return view
