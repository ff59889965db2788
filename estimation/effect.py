"""Effects: physical causes that can be fitted, named, and confused with others.

    effort(t) = sensor( sum_i effect_i(motion(t)) )

An `AdditiveEffect` adds effort, a `MotionEffect` changes the motion that the effort comes from, a
`MemoryEffect` lets elastic effort fade, and a `SensorEffect` changes the effort on its way to the reader.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import least_path
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray

Errors = Callable[[], Mapping[str, float]]
Inner = Mapping[str, float]  # values of inner (nonlinear) parameters by name


# What an effort can depend on; see `Effect.signals`.
SIGNALS = (
    "offset",  # always there, whatever moves
    "time",
    "position",
    "velocity",
    "direction",  # of the motion, at a reversal above all
    "acceleration",
    "past motion",
    "effort",
    "past effort",
    "load",  # of a joint, apart from friction
    "other joints",
    "recorded",  # a column that a user recorded beside, or the number of the run
)


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect, determined by the fit."""

    name: str  # unique within its effect
    unit: str  # SI unit; "{effort}", "{position}" and "{inertia}" stand for those of the channel
    lower: float  # smallest value that makes physical sense
    upper: float  # largest value that makes physical sense
    typical: tuple[float, float]  # range met in practice; for an inner parameter also where its search begins
    log: bool = False  # whether an inner search goes by ratio rather than by difference

    @property
    def beginning(self) -> float:
        """Start value without prior knowledge: zero if possible, otherwise the middle of the range."""
        return 0.0 if self.lower <= 0.0 <= self.upper else float(self.spread(3)[1])

    def unit_of(self, kind: ChannelKind) -> str:
        """Return the unit in a channel of one kind, such as "N m/rad".

        Args:
            kind: kind of the channel; it sets the units of effort, position and inertia.
        """
        return self.unit.format(
            effort=kind.effort_unit, position=kind.position_unit, inertia=kind.inertia_unit
        )

    def at_bound(self, value: float) -> bool:
        """Return whether a search ended at a bound: then the data determine no value.

        Args:
            value: value of the parameter, in its unit.
        """
        near = 1e-3 * abs(value) if self.log else 1e-6 * (self.upper - self.lower)
        return not self.lower + near < value < self.upper - near

    def spread(self, count: int) -> FloatArray:
        """Return values over the typical range, spaced evenly, or by a constant ratio where `log`.

        Args:
            count: number of values.

        Returns:
            Shape (count,), in the parameter's unit, ascending.
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

    name: ClassVar[str]  # snake_case, from the vocabulary where it is there
    kind: ClassVar[Kind] = Kind.OTHER  # of physics that it belongs to, see `palpate.estimation.kinds`
    also: ClassVar[frozenset[Kind]] = frozenset()  # further kinds, of a law that is a product
    physics: ClassVar[str]  # one line of what happens
    equation: ClassVar[str]  # its term, in plain text
    source: ClassVar[str]  # where the equation comes from
    signature: ClassVar[str]  # what one sees in the data, in words
    # Those of `SIGNALS` on which its effort depends: where an impostor of it leaves structure.
    signals: ClassVar[tuple[str, ...]] = SIGNALS
    channels: ClassVar[frozenset[ChannelKind]]  # kinds of channel it can occur in
    gains: ClassVar[tuple[Parameter, ...]] = ()  # parameters in which the effort is linear, one per column
    # The few others (exponent, speed, time), searched within their bounds.
    inner: ClassVar[tuple[Parameter, ...]] = ()
    essential: ClassVar[tuple[str, ...]] = ()  # gains without which it would be another, simpler effect
    path: ClassVar[str] = ""  # inner parameter, a way without which it would be another, simpler effect
    # Signals of `ChannelData.context` without which the effect cannot be tried.
    needs: ClassVar[tuple[str, ...]] = ()
    # Effects that data often cannot tell from this one, with the experiment that can.
    confused_with: ClassVar[Mapping[str, str]] = {}
    parts: ClassVar[tuple[str, ...]] = ()  # effects that together may describe the same curve
    form: int = 0  # which of its forms it is, see `forms`

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """Return inner values from which a search begins; overridden where their scale depends on the data.

        Args:
            data: the channel.

        Returns:
            At least one; `({},)` for an effect without inner parameters.
        """
        count = 9 if len(self.inner) == 1 else 5
        return start_grid(**{p.name: p.spread(count) for p in self.inner})

    def simpler(self, columns: FloatArray) -> FloatArray:
        """Return the columns of the simpler effect that remains without the essential gains.

        Args:
            columns: columns of all gains, shape (n, len(gains)).

        Returns:
            Shape (n, k), k below len(gains), or equal where nothing is essential.
        """
        return columns[:, [p.name not in self.essential for p in self.gains]]

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """Return whether the effect imitates something else with these parameters within their bounds.

        A model with such an effect may fit well without being evidence for the effect.

        Args:
            data: the channel, with the motion that acts.
            parameters: parameters of the whole model, by "effect.parameter".
            errors: gives their standard errors by the same names, NaN where unknown; asked only if needed.
            noise: root mean square of what the model leaves, in the unit of the effort.
        """
        return False

    def suited_to(self, data: ChannelData) -> "Effect":
        """Return the form of the effect that suits the signals of a channel; most effects have one form.

        A path is bounded by the shortest one that the readings of the position resolve.

        Args:
            data: the channel.
        """
        if not self.path:
            return self
        least, suited = least_path(data), copy(self)
        suited.inner = tuple(  # type: ignore[misc]  # the bound depends on the data
            replace(p, lower=min(max(p.lower, least), p.upper)) if p.name == self.path else p
            for p in self.inner
        )
        return suited

    def in_order(self, inner: Inner) -> Inner:
        """Return equivalent inner parameters in the order that their names state, if two may change places.

        Args:
            inner: values by name.
        """
        return inner

    def forms(self) -> tuple["Effect", ...]:
        """Forms of the same name between which the data choose; for most effects there is one."""
        return (self,)

    def applies_to(self, data: ChannelData) -> bool:
        """Return whether a channel is of the right kind and has the signals that the effect needs.

        Args:
            data: the channel.
        """
        return data.kind in self.channels and all(name in data.context for name in self.needs)


class AdditiveEffect(Effect):
    """An effect that adds effort, linear in its gains."""

    # In a contact, whether it belongs to what can only push, the object; what sticks to the tool, and errors
    # of the reader, can pull as well.
    one_sided: ClassVar[bool] = True
    # Gains whose effort is that of a spring, which a `MemoryEffect` lets fade.
    elastic: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the effort per unit of each gain.

        Args:
            data: the channel, with the motion that acts: positive into the object, or along the joint.
            inner: values of the inner parameters by name.

        Returns:
            Shape (n, len(gains)), in the effort's unit over the gain's; effort in compression is positive.
        """

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the effort that this effect adds without any gain; zero for most.

        Args:
            data: the channel, with the motion that acts.
            inner: values of the inner parameters by name.

        Returns:
            Shape (n,), in the unit of the effort.
        """
        return np.zeros(len(data))


class MotionEffect(Effect):
    """An effect that changes the motion: the object moves differently from what the encoder measured."""

    @abstractmethod
    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        """Return the channel with the motion that acts on the object.

        Args:
            data: the channel with the measured motion.
            inner: values of the inner parameters by name.
        """


class MemoryEffect(Effect):
    """An effect that lets the effort of springs relax over time; linear in that effort."""

    @abstractmethod
    def fade(self, elastic: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return what remains of elastic efforts, computed run by run.

        Args:
            elastic: efforts of springs, shape (n, k), one column each.
            data: the channel.
            inner: values of the inner parameters by name.

        Returns:
            Shape (n, k), in the unit of `elastic`.
        """


class SensorEffect(Effect):
    """An effect of the sensor, between the true and the measured effort."""

    linear: ClassVar[bool]  # whether sense(a + b) == sense(a) + sense(b), so that it can act on columns
    # Whether it is linear and each reading is of that moment's effort
    # alone, the same at any time, so that it can act on means over samples.
    pointwise: ClassVar[bool] = False

    @abstractmethod
    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the reading of the sensor, computed run by run.

        Args:
            effort: true effort, shape (n,), or (n, p) with p columns.
            data: the channel.
            inner: values of the inner parameters by name.

        Returns:
            Same shape and unit as `effort`.
        """

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        """Return the results of `slope` and `sense` together, since they often share their work.

        Args:
            effort: true effort, shape (n,).
            columns: changes of the effort, shape (n, p).
            data: the channel.
            inner: values of the inner parameters by name.

        Returns:
            Changes of the reading, shape (n, p), and the reading, shape (n,).
        """
        if self.linear:
            sensed = self.sense(np.column_stack([columns, effort]), data, inner)
            return sensed[:, :-1], sensed[:, -1]
        return self.slope(effort, columns, data, inner), self.sense(effort, data, inner)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """Return how the reading changes along each column: a secant over 1 % of the effort.

        Args:
            effort: true effort, shape (n,).
            columns: changes of the effort, shape (n, p).
            data: the channel.
            inner: values of the inner parameters by name.

        Returns:
            Shape (n, p), in the unit of `columns`.
        """
        if self.linear:
            return self.sense(columns, data, inner)
        lengths = np.sqrt(np.mean(columns**2, axis=0))
        step = 0.01 * np.sqrt(np.mean(effort**2)) / np.where(lengths > 0, lengths, 1.0)
        step = np.where(step > 0, step, 1.0)
        reading = self.sense(effort, data, inner)[:, None]
        return (self.sense(effort[:, None] + step * columns, data, inner) - reading) / step
