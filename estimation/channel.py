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


# Encoder steps that a press must span: an error of half a step at each end changes the slope by a quarter.
MIN_STEPS = 4.0
_MIN_EIGENVALUE = 1e-13  # eigenvalue relative to the largest below which columns are linearly dependent
# Arrays already checked, by `id`, because a fit makes thousands of channels from the same arrays.
_checked: WeakValueDictionary[int, NDArray[Any]] = WeakValueDictionary()


@dataclass(frozen=True)
class Surface:
    """A surface along the press direction."""

    position_m: float  # coordinate along the press direction, in the frame of the tip positions [m]
    std_err_m: float  # its standard error [m]; NaN if there is none
    # Smallest coordinate of the surface that is compatible with the contact; -inf if unknown [m].
    highest_m: float = float("-inf")
    deepest_m: float = float("inf")  # largest compatible coordinate; inf if unknown [m]


@dataclass(frozen=True)
class Tare:
    """Effort in free air for each of r runs, to be subtracted (tare).

    A run's tare is a mean of noisy samples. All samples of the run share its error, so more samples do not
    average it out.
    """

    run: IntArray  # run numbers, ascending, shape (r,)
    effort: FloatArray  # mean effort in free air, shape (r,)
    std_err: FloatArray  # standard error of that mean, shape (r,)

    def of(self, run: IntArray) -> FloatArray:
        """Return the tare of each sample: the effort to subtract, shape (n,).

        Args:
            run: number of each sample's run, shape (n,).
        """
        offset: FloatArray = self.effort[self.index(run)]
        return offset

    def index(self, run: IntArray) -> IntArray:
        """Return the index of each sample's run in `self.run`, shape (n,).

        Args:
            run: number of each sample's run, shape (n,).
        """
        return np.searchsorted(self.run, run)


@dataclass(frozen=True)
class Information:
    """Quadratic objective beta' matrix beta / 2 - vector' beta, or a stack of several."""

    matrix: FloatArray  # shape (..., s, s), symmetric
    vector: FloatArray  # shape (..., s)

    def __add__(self, other: "Information") -> "Information":
        return Information(self.matrix + other.matrix, self.vector + other.vector)

    def times(self, factor: float) -> "Information":
        """Multiply by a noise variance, for normal equations that are not divided by it.

        Args:
            factor: variance of the noise [effort^2].
        """
        return Information(factor * self.matrix, factor * self.vector)

    def about(self, chosen: IntArray | BoolArray) -> "Information":
        """Keep the chosen parameters and profile out all others (Schur complement).

        Args:
            chosen: indices or mask of the parameters to keep.
        """
        kept = np.zeros(self.vector.shape[-1], dtype=np.bool_)
        kept[chosen] = True
        cross = self.matrix[..., kept, :][..., ~kept] @ pseudo_inverse(self.matrix[..., ~kept, :][..., ~kept])
        matrix = self.matrix[..., kept, :][..., kept] - cross @ self.matrix[..., ~kept, :][..., kept]
        vector = self.vector[..., kept] - (cross @ self.vector[..., ~kept, None])[..., 0]
        return Information(0.5 * (matrix + np.swapaxes(matrix, -1, -2)), vector)


def pseudo_inverse(matrices: FloatArray) -> FloatArray:
    """Compute pseudo-inverses (..., k, k) of symmetric matrices, whatever the units of their columns.

    Directions whose relative eigenvalue is at most 1e-13 have inverse zero.

    Args:
        matrices: symmetric, shape (..., k, k).
    """
    scale = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    scale = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    scaled = matrices * scale[..., :, None] * scale[..., None, :]
    inverse = np.linalg.pinv(scaled, rcond=_MIN_EIGENVALUE, hermitian=True)
    return np.asarray(inverse * scale[..., :, None] * scale[..., None, :])


class ChannelKind(StrEnum):
    """Kind of a channel; it determines the units and the effects that apply."""

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
    """Information from an arm's other channels on gains that a channel shares with them."""

    names: tuple[str, ...]  # names of the s gains, "effect.parameter"
    # Matrix (1 + folds, s, s) and vector (1 + folds, s): first from all runs, then leaving out each fold, in
    # units of this channel's squared residuals.
    information: Information


@dataclass(frozen=True)
class ChannelData:
    """Samples of one channel; row i of every array (length n, read-only) belongs to sample i."""

    name: str  # "contact", "joint_1" ...
    kind: ChannelKind  # determines the units, see `ChannelKind`
    time_s: FloatArray  # strictly increasing within a run [s]
    position: FloatArray  # see `ChannelKind`
    velocity: FloatArray  # derivative of position, without phase error
    acceleration: FloatArray  # second derivative of position, without phase error
    effort: FloatArray  # measured effort, which models explain
    run: IntArray  # number of the run (one approach, one recording) that each sample belongs to
    phase: IntArray  # numbers of `palpate.control.loop.task.Phase`, or -1 where unknown
    # Other signals that an effect may need, by name, each of shape (n,) or (n, k). An arm has
    # `joint_position`, `joint_velocity` and `joint_acceleration` (n, joints); `load` (n,) is the effort of a
    # joint without friction.
    context: Mapping[str, FloatArray] = field(default_factory=dict)
    # Estimated surface, from which position is measured; None if the recording gives the displacement.
    surface: Surface | None = None
    tare: Tare | None = None  # tare that was subtracted from the measured effort; None if none was
    # Names of the context signals that the user recorded in addition, such as a temperature; shape (n,) each.
    recorded: frozenset[str] = frozenset()
    # Quantization step of the position, such as an encoder step; 0 if there is none.
    position_step: float = 0.0
    # Samples of a contact that are known to be in contact at any depth, shape (n,); None if only the depth
    # decides.
    touching: BoolArray | None = None
    shared: SharedGains | None = None  # information on gains from other channels; None if there is none
    averaged: int = 1  # number of readings averaged in each sample
    # Whether the readings that were averaged are a stepwise command, see `is_stepwise_command`.
    is_command: bool = False
    # Whether an object has recovered when a run begins, so that its relaxation in earlier runs has no effect.
    # None if the data are to decide.
    recovers: bool | None = field(default=None, compare=False)
    # Rate at which an object recovers in free air, relative to its relaxation at constant depth. A free
    # surface moves while the object recovers, which makes the recovery slower; 1 if it does not move.
    recovery_ratio: float = field(default=1.0, compare=False)
    # Damping divided by the stiffness against a sudden press, with which a free surface recovers [s].
    retardation_s: float = field(default=0.0, compare=False)
    # Whether the free surface of a damped object recovers with c / k before the tip touches it again, see
    # `above_free_surface`. Otherwise it recovers at once.
    surface_recovers: bool = field(default=False, compare=False)
    # Units of the columns in the file, by quantity, such as {"displacement": "mm"}, or None if files differ.
    # Empty if unknown. The arrays are in SI units. Messages use these, and they show what was recorded.
    units: Mapping[str, str | None] = field(default_factory=dict, compare=False)
    # SI units of "effort" and "position" where another quantity stands for them, such as {"effort": "A"} for
    # a motor's current.
    proxy_units: Mapping[str, str] = field(default_factory=dict, compare=False)
    # Travel of the tip across the press direction relative to its depth, least of all presses of a probing
    # session; 0 where the tip moves across as much in free air, or where it is unknown.
    lateral_ratio: float = 0.0
    # Doubts about times and motion that arose on reading the file.
    import_warnings: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Check lengths, finiteness, and that the context contains all recorded signals.

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
                    f"channel '{self.name}': recorded signal '{what}' must have one number per sample"
                )

    def __reduce__(self) -> tuple[type["ChannelData"], tuple[object, ...]]:
        """Pickle the context as a dict, because its read-only view cannot be pickled."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return ChannelData, (*(values | {"context": dict(self.context)}).values(),)

    def __len__(self) -> int:
        """Number of samples n."""
        return len(self.time_s)

    @property
    def effort_unit(self) -> str:
        """Unit of the effort."""
        return self.proxy_units.get("effort", self.kind.effort_unit)

    @property
    def position_unit(self) -> str:
        """Unit of the position."""
        return self.proxy_units.get("position", self.kind.position_unit)

    @property
    def inertia_unit(self) -> str:
        """Unit of effort over acceleration."""
        plain = f"{self.effort_unit} s^2/{self.position_unit}"
        return plain if self.proxy_units else self.kind.inertia_unit

    @property
    def has_time(self) -> bool:
        """Whether times were recorded; otherwise rows are assumed to be 1 s apart."""
        return not self.units or "time" in self.units

    @property
    def is_steady(self) -> bool:
        """Whether each sample is taken for a steady state: neither time nor position was recorded."""
        return not self.has_time and "velocity" in self.units

    @property
    def engaged(self) -> BoolArray:
        """Samples with an effort of the object, shape (n,): for contacts those with x > 0, else all."""
        if self.kind is ChannelKind.CONTACT:
            pressed: BoolArray = self.position > 0.0
            return pressed if self.touching is None else pressed | self.touching
        return np.ones(len(self), dtype=np.bool_)

    @property
    def rms_speed(self) -> float:
        """Root mean square of the velocity; 1 for a channel at rest."""
        return float(np.sqrt(np.mean(self.velocity**2))) or 1.0

    @property
    def time_scale(self) -> float:
        """Time scale of the motion within runs [s]: 1/w for a sine of frequency w, 1 for a joint at rest."""
        _, index = np.unique(self.run, return_inverse=True)
        means = np.bincount(index, self.position) / np.bincount(index)
        if not self.velocity.any() or np.ptp(self.position) == 0.0:
            return 1.0
        return float(np.sqrt(np.mean((self.position - means[index]) ** 2))) / self.rms_speed or 1.0

    @property
    def range_of_motion(self) -> float:
        """Range of the position (maximum minus minimum); 1 for a channel at rest."""
        return float(np.ptp(self.position)) or 1.0

    @property
    def deepest(self) -> float:
        """Largest position, at least 1e-9; for a contact the deepest indentation."""
        return max(float(np.max(self.position, initial=0.0)), 1e-9)

    @property
    def largest_effort(self) -> float:
        """Largest absolute effort; 1 if all efforts are zero."""
        return float(np.max(np.abs(self.effort))) or 1.0

    @property
    def runs(self) -> IntArray:
        """Distinct run numbers, ascending."""
        return np.unique(self.run)

    def select(self, rows: BoolArray | IntArray) -> "ChannelData":
        """Return the channel with only the selected samples.

        Args:
            rows: a mask of shape (n,), or indices.
        """
        return replace(
            self,
            **{what: getattr(self, what)[rows] for what in _ARRAYS},
            touching=None if self.touching is None else self.touching[rows],
            shared=None,
            context={name: values[rows] for name, values in self.context.items()},
        )

    def of_runs(self, runs: IntArray) -> "ChannelData":
        """Return the channel with only the samples of some runs.

        Args:
            runs: numbers of the runs to keep.
        """
        return self.select(np.isin(self.run, runs))


def _check(channel: str, name: str, values: FloatArray | IntArray, length: int) -> None:
    if len(values) != length:
        raise InputError(f"channel '{channel}': {name} has {len(values)} samples, time_s has {length}")
    if _checked.get(id(values)) is values:
        return
    if not np.isfinite(values).all():
        bad = np.flatnonzero(~np.isfinite(values.reshape(length, -1)).all(axis=1))
        raise InputError(
            f"channel '{channel}': {name} is not finite at sample {bad[0]} (and {len(bad) - 1} more)"
        )
    _checked[id(values)] = values


def _read_only(values: NDArray[Any] | None) -> NDArray[Any] | None:
    """Return a read-only view of an array; its owner can still write to it. None stays None."""
    if values is None or not (values := np.asarray(values)).flags.writeable:
        return values
    view = values.view()
    view.setflags(write=False)
    return view
