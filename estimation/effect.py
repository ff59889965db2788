"""Effects: physical causes of effort that can be fitted and named.

    effort(t) = sensor( sum_i effect_i(motion(t)) )

An `AdditiveEffect` adds effort. A `MotionEffect` changes the motion that causes the effort. A `MemoryEffect`
relaxes elastic effort over time. A `SensorEffect` changes the effort between the object and the reading.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import reading_error
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.cache_by_array import IdentityKey
from palpate.robot_io.types import FloatArray

Parameters = Mapping[str, float]  # values of all parameters by "effect.parameter"
Errors = Callable[[], Parameters]
Inner = Mapping[str, float]  # values of inner (nonlinear) parameters by name


# Signals that an effort can depend on; see `Effect.signals`.
SIGNALS = (
    "offset",  # constant, independent of the motion
    "time",
    "position",
    "velocity",
    "direction",  # of the motion, mainly at reversals
    "acceleration",
    "past motion",
    "effort",
    "past effort",
    "load",  # effort of a joint without friction
    "other joints",
    "recorded",  # an additional column that a user recorded, or the number of the run
)


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect, determined by the fit."""

    name: str  # unique within its effect
    unit: str  # SI unit; "{effort}", "{position}" and "{inertia}" stand for the channel's units
    lower: float  # smallest physical value
    upper: float  # largest physical value
    typical: tuple[float, float]  # usual range in practice; for an inner parameter also its search grid
    log: bool = False  # whether the search of an inner parameter uses a logarithmic scale

    @property
    def beginning(self) -> float:
        """Start value without prior knowledge: zero if allowed, otherwise the middle of the typical range."""
        return 0.0 if self.lower <= 0.0 <= self.upper else float(self.spread(3)[1])

    def unit_of(self, channel: ChannelKind | ChannelData) -> str:
        """Return the unit in a channel, such as "N m/rad".

        Args:
            channel: a channel, or its kind if its quantities are those of the kind.
        """
        return self.unit.format(
            effort=channel.effort_unit, position=channel.position_unit, inertia=channel.inertia_unit
        )

    def at_bound(self, value: float) -> bool:
        """Return whether a value is at a search bound, so that the data do not determine it.

        Args:
            value: value of the parameter, in its unit.
        """
        margin = 1e-3 * abs(value) if self.log else 1e-6 * (self.upper - self.lower)
        return not self.lower + margin < value < self.upper - margin

    def spread(self, count: int) -> FloatArray:
        """Return ascending values (count,) over the typical range, spaced evenly, or by ratio with `log`.

        They are in the parameter's unit.

        Args:
            count: number of values.
        """
        low, high = self.typical
        return np.geomspace(low, high, count) if self.log else np.linspace(low, high, count)


def start_grid(**values: Iterable[float]) -> tuple[Inner, ...]:
    """Return all combinations of start values by name, for `Effect.starts`; the last name varies fastest.

    Args:
        values: start values of each inner parameter, in its unit.
    """
    return tuple(dict(zip(values, map(float, row), strict=True)) for row in product(*values.values()))


class Effect(ABC):
    """One physical effect; class attributes describe it, in the same form for all effects."""

    name: ClassVar[str]  # snake_case
    kind: ClassVar[Kind] = Kind.OTHER  # category of physics, see `palpate.estimation.kinds`
    also: ClassVar[frozenset[Kind]] = frozenset()  # further kinds, if the law is a product of several
    physics: ClassVar[str]  # one-line description of the physics
    equation: ClassVar[str]  # equation of its term, in plain text
    source: ClassVar[str]  # reference for the equation
    signature: ClassVar[str]  # how the effect appears in the data, in words
    # The `SIGNALS` on which its effort depends; a wrong effect in its place leaves structure in them.
    signals: ClassVar[tuple[str, ...]] = SIGNALS
    # Kinds of channel in which it can occur, by default all.
    channels: ClassVar[frozenset[ChannelKind]] = frozenset(ChannelKind)
    gains: ClassVar[tuple[Parameter, ...]] = ()  # parameters in which the effort is linear, one per column
    # Nonlinear parameters (exponent, speed, time), searched within their bounds.
    inner: ClassVar[tuple[Parameter, ...]] = ()
    essential: ClassVar[tuple[str, ...]] = ()  # gains whose absence would leave another, simpler effect
    # Start values of inner parameters, as multiples of a scale of the motion or the effort: the name of a
    # property of `ChannelData`, and the multiples. By default they are spread over the typical range.
    start_multiples: ClassVar[Mapping[str, tuple[str, ArrayLike]]] = {}
    path: ClassVar[str] = ""  # inner parameter, a path length; at zero another, simpler effect remains
    # Signals of `ChannelData.context` that the effect requires.
    needs: ClassVar[tuple[str, ...]] = ()
    # Effects that data often cannot distinguish from this one, each with an experiment that can.
    confused_with: ClassVar[Mapping[str, str]] = {}
    parts: ClassVar[tuple[str, ...]] = ()  # effects that together may describe the same curve
    form: int = 0  # index of this form, see `forms`

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """Return start values of the inner parameters, at least one; see `start_multiples`.

        Args:
            data: the channel.
        """
        if self.start_multiples:
            lower = {p.name: p.lower for p in self.inner}
            scaled = (
                (name, getattr(data, scale) * np.array(m))
                for name, (scale, m) in self.start_multiples.items()
            )
            return start_grid(**{name: np.maximum(values, lower[name]) for name, values in scaled})
        count = 9 if len(self.inner) == 1 else 5
        return start_grid(**{p.name: p.spread(count) for p in self.inner})

    def simpler(self, columns: FloatArray) -> FloatArray:
        """Return the columns (n, k) of the simpler effect that remains without the essential gains.

        Args:
            columns: columns of all gains, shape (n, len(gains)).
        """
        return columns[:, [p.name not in self.essential for p in self.gains]]

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """Return whether the effect imitates another effect at these parameters.

        A model with such an effect may fit well without being evidence for the effect.

        Args:
            data: the channel, with the motion that acts on the object.
            parameters: parameters of the whole model, by "effect.parameter".
            errors: returns their standard errors by the same names, NaN if unknown; called only if needed.
            noise: root mean square residual of the model [effort].
        """
        return False

    def describe_physics(self, parameters: Mapping[str, float]) -> str:
        """Describe the physics at fitted parameters; `physics`, unless their signs mean something else.

        Args:
            parameters: parameters of the effect by name.
        """
        return self.physics

    def suited_to(self, data: ChannelData) -> "Effect":
        """Return the form of the effect that suits the signals of a channel; most effects have one form.

        The lower bound of a path length becomes the shortest path that the position readings resolve.

        Args:
            data: the channel.
        """
        if not self.path:
            return self
        half_step = float(np.sqrt(3.0 * np.mean(reading_error(data) ** 2)))  # if the readings are quantized
        inner = tuple(
            replace(p, lower=min(max(p.lower, half_step), p.upper)) if p.name == self.path else p
            for p in self.inner
        )
        suited: Effect = variant(IdentityKey(self), inner=inner)
        return suited

    def in_order(self, inner: Inner) -> Inner:
        """Return equivalent inner parameters in the order of their names, if two are interchangeable.

        Args:
            inner: values of the inner parameters by name.
        """
        return inner

    def forms(self) -> tuple["Effect", ...]:
        """Return the forms of this effect, between which the data decide; most effects have one."""
        return (self,)

    def applies_to(self, data: ChannelData) -> bool:
        """Return whether a channel is of the right kind and has the signals that the effect needs.

        Args:
            data: the channel; its `context` must have all signals in `needs`.
        """
        return data.kind in self.channels and all(name in data.context for name in self.needs)


@lru_cache(maxsize=256)
def variant(effect: IdentityKey, **attributes: Any) -> Any:  # noqa: ANN401, the effect's own type
    """Return a copy of an effect with other attributes, always the same one, since its columns are cached.

    Args:
        effect: the effect.
        attributes: values that replace those of the effect.
    """
    changed = copy(effect.wrapped)
    for name, value in attributes.items():
        setattr(changed, name, value)
    return changed


@lru_cache(maxsize=256)
def forms_of(effect: IdentityKey) -> tuple[Effect, ...]:
    """Return the forms of an effect, always the same ones; see `variant`.

    Args:
        effect: the effect.
    """
    forms: tuple[Effect, ...] = effect.wrapped.forms()
    return forms


class AdditiveEffect(Effect):
    """An effect that adds effort, linear in its gains."""

    # Whether it is a force of the object in a contact, which can only push. Adhesion and sensor errors can
    # also pull.
    one_sided: ClassVar[bool] = True
    # Gains with elastic effort, which a `MemoryEffect` relaxes.
    elastic: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the effort per unit of each gain, shape (n, len(gains)), positive in compression.

        Args:
            data: the channel, with the motion that acts on the object; positive into the object or along the
                joint.
            inner: values of the inner parameters by name.
        """

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the effort (n,) that this effect adds independently of its gains; zero for most effects.

        Args:
            data: the channel, with the motion that acts on the object.
            inner: values of the inner parameters by name.
        """
        return np.zeros(len(data))


class MotionEffect(Effect):
    """An effect by which the motion of the object differs from the measured motion."""

    @abstractmethod
    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        """Return the channel with the motion that acts on the object.

        Args:
            data: the channel with the measured motion.
            inner: values of the inner parameters by name.
        """


class MemoryEffect(Effect):
    """An effect that relaxes elastic effort over time; it is linear in that effort."""

    @abstractmethod
    def fade(self, elastic: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the remaining elastic efforts (n, k) after relaxation, computed run by run.

        Args:
            elastic: elastic efforts, one per column, shape (n, k).
            data: the channel.
            inner: values of the inner parameters by name.
        """


class SensorEffect(Effect):
    """An effect of the sensor, between the true and the measured effort."""

    linear: ClassVar[bool]  # whether sense(a + b) == sense(a) + sense(b), so that it can act on columns
    # Whether it is linear, memoryless and time-invariant, so that it can act on means over samples.
    pointwise: ClassVar[bool] = False

    @abstractmethod
    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the reading of the sensor, in the shape of the effort, computed run by run.

        Args:
            effort: true effort, shape (n,), or (n, p) with p columns.
            data: the channel.
            inner: values of the inner parameters by name.
        """

    def initial_response(self, data: ChannelData, inner: Inner) -> FloatArray | None:
        """Return the part of the readings that the effort before each run causes, shape (n,).

        It is added to the result of `sense`, which starts each run from zero state. A sensor without such a
        state returns None.

        Args:
            data: the channel; the first reading of each run shows the state of the sensor.
            inner: values of the inner parameters by name.
        """
        return None

    def run_deviations(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the changes of the reading by one standard deviation of what differs between runs, (n, k).

        There are none (k = 0) unless the effect is a random effect, with k values for each run.

        Args:
            effort: true effort, shape (n,).
            data: the channel.
            inner: values of the inner parameters by name.
        """
        return np.empty((len(data), 0))

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """Return the results of `slope`, and of `sense` with the initial response, which share computations.

        Args:
            effort: true effort, shape (n,).
            columns: changes of the effort, shape (n, p).
            data: the channel.
            inner: values of the inner parameters by name.
        """
        if self.linear:
            sensed = self.sense(np.column_stack([columns, effort]), data, inner)
            initial = self.initial_response(data, inner)
            return sensed[:, :-1], sensed[:, -1] if initial is None else sensed[:, -1] + initial
        return self.slope(effort, columns, data, inner), self.sense(effort, data, inner)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the change (n, p) of the reading along each column: a secant over 1 % of the effort.

        Args:
            effort: true effort, shape (n,).
            columns: changes of the effort, shape (n, p).
            data: the channel.
            inner: values of the inner parameters by name.
        """
        if self.linear:
            return self.sense(columns, data, inner)
        lengths = np.sqrt(np.mean(columns**2, axis=0))
        step = 0.01 * np.sqrt(np.mean(effort**2)) / np.where(lengths > 0, lengths, 1.0)
        step = np.where(step > 0, step, 1.0)
        reading = self.sense(effort, data, inner)[:, None]
        return (self.sense(effort[:, None] + step * columns, data, inner) - reading) / step
