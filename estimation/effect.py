"""What an effect is: one physical cause, stated so that it can be fitted, named and confused with others.

    effort(t) = sensor( sum_i effect_i(motion(t)) )

An `AdditiveEffect` adds effort, a `MotionEffect` changes the motion that the effort comes from, and a
`SensorEffect` changes the effort on its way to the reader.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from robot_io.types import FloatArray

Inner = Mapping[str, float]  # values of inner (nonlinear) parameters by name


@dataclass(frozen=True)
class Parameter:
    """One number that a fit finds.

    Attributes:
        name: unique within its effect.
        unit: SI unit; "{effort}" and "{position}" stand for those of the channel.
        lower: smallest value that makes physical sense.
        upper: largest value that makes physical sense.
        typical: range met in practice; for an inner parameter also where its search begins.
        log: whether an inner search goes by ratio rather than by difference.
    """

    name: str
    unit: str
    lower: float
    upper: float
    typical: tuple[float, float]
    log: bool = False


class Effect(ABC):
    """One physical effect.

    Class attributes state it in the same form for all (a test holds every effect to it):
        name: snake_case, from the vocabulary where it is there.
        physics: one line of what happens.
        equation: its term, in plain text.
        source: where the equation comes from.
        signature: what one sees in the data, in words.
        channels: kinds of channel it can occur in.
        gains: parameters in which the effort is linear, one per column.
        inner: the few others (exponent, speed, time), searched within their bounds.
        confused_with: effects that data often cannot tell from this one, with the experiment that can.
    """

    name: ClassVar[str]
    physics: ClassVar[str]
    equation: ClassVar[str]
    source: ClassVar[str]
    signature: ClassVar[str]
    channels: ClassVar[frozenset[ChannelKind]]
    gains: ClassVar[tuple[Parameter, ...]] = ()
    inner: ClassVar[tuple[Parameter, ...]] = ()
    confused_with: ClassVar[Mapping[str, str]] = {}


class AdditiveEffect(Effect):
    """An effect that adds effort, linear in its gains."""

    @abstractmethod
    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Effort per unit of each gain, shape (n, len(gains))."""

    def known(self, data: ChannelData) -> FloatArray:
        """Effort that this effect adds without any parameter, shape (n,); zero for most."""
        return np.zeros(len(data))


class MotionEffect(Effect):
    """An effect that changes the motion: the object does not see what the encoder saw."""

    @abstractmethod
    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        """The channel with the motion that really acts."""


class SensorEffect(Effect):
    """An effect on the way from the effort to the reader."""

    linear: ClassVar[bool]  # whether sense(a + b) == sense(a) + sense(b), so that it can act on columns

    @abstractmethod
    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """What the sensor makes of `effort`, shape (n,) or (n, p) with p columns, run by run."""
