"""A model: named effects in a fixed order, and what they predict together."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import (
    AdditiveEffect,
    Effect,
    MemoryEffect,
    MotionEffect,
    Parameter,
    Parameters,
    SensorEffect,
)
from palpate.estimation.signals.cache_by_array import IdentityKey
from palpate.estimation.signals.contact_memory import above_free_surface
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

Parts = tuple[FloatArray, FloatArray]  # columns (n, p) and known effort (n,), before any sensor


@dataclass(frozen=True)
class Regression:
    """effort = columns @ gains + noise."""

    columns: FloatArray  # shape (n, p)
    effort: FloatArray  # shape (n,)
    names: tuple[str, ...]  # the p gains' names
    units: tuple[str, ...]  # the p gains' units
    # Run number of each sample, shape (n,), in order of time within a run; None for a single run. Noise may
    # be correlated within a run, but not between runs.
    run: IntArray | None = None

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            InputError: the shapes do not match, or there are fewer samples than the gains need.
        """
        samples, gains = self.columns.shape
        if self.effort.shape != (samples,) or len(self.names) != gains or len(self.units) != gains:
            raise InputError(
                f"regression: columns {self.columns.shape}, effort {self.effort.shape}, names {self.names}"
            )
        if self.run is not None and self.run.shape != (samples,):
            raise InputError(f"regression: run has shape {self.run.shape}, expected ({samples},)")
        if samples <= gains:
            raise InputError(f"regression: {samples} samples cannot determine {gains} parameters")

    def select(self, rows: BoolArray | IntArray) -> "Regression":
        """Return the problem with only the selected samples.

        Args:
            rows: mask or indices of samples.
        """
        run = None if self.run is None else self.run[rows]
        return replace(self, columns=self.columns[rows], effort=self.effort[rows], run=run)


@dataclass(frozen=True)
class Model:
    """Model of a channel: the sensor effects act on the sum of the additive effects.

    Motion effects change the motion on which additive effects act; memory effects relax their elastic part.
    """

    name: str  # such as "kelvin_voigt"
    effects: tuple[Effect, ...]  # in the order in which they were added
    held: Parameters = field(default_factory=dict)  # parameters that a fit holds at these values
    # Bounds of inner parameters that are narrower than the physical bounds; absent parameters are ignored.
    within: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the effects.

        Raises:
            InputError: an effect occurs twice.
        """
        names = [effect.name for effect in self.effects]
        duplicates = {name for name in names if names.count(name) > 1}
        if duplicates:
            raise InputError(
                f"model '{self.name}' would contain {', '.join(sorted(duplicates))} twice; an effect that "
                "the base model or an earlier revision contains cannot be added again"
            )

    def with_effect(self, effect: Effect, *, first: bool = False) -> "Model":
        """Return the model with an effect appended.

        Args:
            effect: effect in the form that suits the channel.
            first: whether to prepend it, such as a sensor's fault before its filter.

        Raises:
            InputError: the model already has this effect.
        """
        return Model(self.name, (effect, *self.effects) if first else (*self.effects, effect), self.held)

    def effect(self, name: str) -> Effect:
        """Return the effect with this name.

        Args:
            name: name of an effect of the model.
        """
        return next(effect for effect in self.effects if effect.name == name)

    def without(self, *names: str) -> "Model":
        """Return the model without the effects of these names."""
        kept = tuple(effect for effect in self.effects if effect.name not in names)
        return Model(self.name, kept, {n: v for n, v in self.held.items() if n.split(".")[0] not in names})

    @cached_property
    def gains(self) -> dict[str, Parameter]:
        """Linear parameters by "effect.parameter", in column order."""
        return {f"{e.name}.{p.name}": p for e in self.additive for p in e.gains}

    @cached_property
    def gain_bounds(self) -> dict[str, tuple[float, float]]:
        """Physical bounds of the gains by "effect.parameter"."""
        return {name: (parameter.lower, parameter.upper) for name, parameter in self.gains.items()}

    @cached_property
    def inner(self) -> dict[str, Parameter]:
        """Nonlinear parameters by "effect.parameter"."""
        parameters_by_name = {f"{e.name}.{p.name}": p for e in self.effects for p in e.inner}
        for name in parameters_by_name.keys() & self.within.keys():
            (low, high), p = self.within[name], parameters_by_name[name]
            parameters_by_name[name] = replace(p, lower=max(low, p.lower), upper=min(high, p.upper))
        return parameters_by_name

    def at_bound(self, name: str, value: float) -> bool:
        """Return whether an inner parameter is at a search bound; False for gains.

        Args:
            name: "effect.parameter".
            value: value in the parameter's unit.
        """
        return name in self.inner and self.inner[name].at_bound(value)

    @cached_property
    def is_linear_in_gains(self) -> bool:
        """Whether the effort is linear in the gains at fixed inner parameters."""
        return all(effect.linear for effect in self.sensors)

    def regression(self, data: ChannelData, inner: Parameters) -> Regression:
        """Return the linear problem at fixed inner parameters, with the known effort subtracted.

        Args:
            data: the channel.
            inner: a value for each of `self.inner`.

        Raises:
            InputError: a sensor effect of the model is not linear.
        """
        if not self.is_linear_in_gains:
            raise InputError(f"model '{self.name}' is not linear in its gains: use predict()")
        columns, known = self.parts(data, inner)
        for sensor in self.sensors:
            columns, known = sensor.follow(known, columns, data, own_parameters(sensor, inner))
        units = self.units(data)[: len(self.gains)]
        return Regression(columns, data.effort - known, tuple(self.gains), units, data.run)

    def in_order(self, parameters: Parameters) -> dict[str, float]:
        """Return equivalent parameters in the order of their names, see `Effect.in_order`.

        Args:
            parameters: a value for every gain and inner parameter.
        """
        ordered_parameters, fixed = dict(parameters), self.held.keys() | self.within.keys()
        for effect in self.effects:
            ordered = effect.in_order(own_parameters(effect, parameters))
            named = {f"{effect.name}.{name}": value for name, value in ordered.items()}
            ordered_parameters |= named if not named.keys() & fixed else {}
        return ordered_parameters

    def units(self, data: ChannelData) -> tuple[str, ...]:
        """Return the units of the gains, then of the inner parameters.

        Args:
            data: the channel.
        """
        return tuple(p.unit_of(data) for p in (*self.gains.values(), *self.inner.values()))

    def predict(self, data: ChannelData, parameters: Parameters) -> FloatArray:
        """Return the effort predicted by the model, shape (n,).

        Args:
            data: the channel; its effort is used only by effects that need it (tool compliance).
            parameters: a value for every gain and inner parameter.
        """
        return self.predict_from(self.parts(data, parameters), data, parameters)

    def predict_from(self, parts: Parts, data: ChannelData, parameters: Parameters) -> FloatArray:
        """Return the predicted effort, shape (n,), for known columns.

        Args:
            parts: result of `parts` for the same data and inner parameters.
            data: the channel; its effort is used only by effects that need it.
            parameters: a value for every gain and inner parameter.
        """
        _, effort = self._object_effort(parts, parameters, self.lift_off_rows(data, parameters, parts))
        for sensor in self.sensors:
            inner = own_parameters(sensor, parameters)
            effort, initial = sensor.sense(effort, data, inner), sensor.initial_response(data, inner)
            effort = effort if initial is None else effort + initial
        return effort

    def inner_slopes(
        self, data: ChannelData, parameters: Parameters, step: float, columns_of: "Columns | None" = None
    ) -> list[FloatArray]:
        """Compute the derivative of the prediction by each inner parameter at fixed gains, each (n,).

        Args:
            data: the channel.
            parameters: a value for every gain and inner parameter.
            step: step of the difference quotient, relative to the value (logarithmic parameters) or to the
                typical range (others).
            columns_of: function that looks up `columns`; None to compute them.
        """
        if not self.inner:
            return []
        slopes, parts = [], self.parts(data, parameters, columns_of)
        for name, parameter in self.inner.items():
            value, (low, high) = parameters[name], parameter.typical
            half_step = step * (abs(value) if parameter.log and value else high - low)
            upper, lower = min(value + half_step, parameter.upper), max(value - half_step, parameter.lower)
            efforts = []
            for changed in ({**parameters, name: upper}, {**parameters, name: lower}):
                effect = self.effect(name.partition(".")[0])
                after = self.parts_after(effect, data, changed, parts, columns_of)
                efforts.append(self.predict_from(after, data, changed))
            slopes.append((efforts[0] - efforts[1]) / (upper - lower))
        return slopes

    def lift_off_rows(self, data: ChannelData, parameters: Parameters, parts: Parts) -> IntArray:
        """Return the rows (k,) of a contact below the undeformed surface where the tip does not touch.

        The object would have to pull there, or its surface has not yet recovered from an earlier contact, see
        `above_free_surface`. In these samples, the sum of the one-sided effects is set to zero. Samples that
        are known to be in contact are not among them. A joint has no such rows.

        Args:
            data: the channel.
            parameters: a value for every gain and inner parameter.
            parts: result of `parts` for the same data and inner parameters.
        """
        if data.kind is not ChannelKind.CONTACT:
            return np.empty(0, dtype=np.int64)
        pushing = self._pushing(parameters, parts)
        lifts = (pushing < 0.0) | self.recovering(data, parameters, parts)
        return np.flatnonzero(lifts if data.touching is None else lifts & ~data.touching)

    def recovering(self, data: ChannelData, parameters: Parameters, parts: Parts) -> BoolArray:
        """Return the samples (n,) of a contact in which the tip has not yet reached a surface that recovers.

        Args:
            data: the channel.
            parameters: a value for every gain and inner parameter.
            parts: result of `parts` for the same data and inner parameters.
        """
        damping = parameters.get("damping.c", 0.0)
        if not data.surface_recovers or damping <= 0.0:
            return np.zeros(len(data), dtype=np.bool_)
        pushing = self._pushing(parameters, parts)
        elastic = pushing - damping * parts[0][:, list(self.gains).index("damping.c")]
        return above_free_surface(pushing, elastic, damping, self.moved(data, parameters))

    def _pushing(self, parameters: Parameters, parts: Parts) -> FloatArray:
        """Return the sum of the one-sided effects, shape (n,)."""
        gains = np.array([parameters[name] for name in self.gains])
        return np.asarray(parts[0] @ (gains * self.one_sided))

    def linearize(
        self,
        data: ChannelData,
        parameters: Parameters,
        parts: Parts | None = None,
        lift_off_rows: IntArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives (n, p) of the prediction by the gains, and the prediction (n,).

        Args:
            data: the channel; its effort is used only by effects that need it (tool compliance).
            parameters: a value for every gain and inner parameter.
            parts: result of `parts` for the same data and inner parameters, if known.
            lift_off_rows: result of `lift_off_rows` for the same arguments, if known.
        """
        parts = parts or self.parts(data, parameters)
        rows = self.lift_off_rows(data, parameters, parts) if lift_off_rows is None else lift_off_rows
        slopes, effort = self._object_effort(parts, parameters, rows)
        for sensor in self.sensors:
            slopes, effort = sensor.follow(effort, slopes, data, own_parameters(sensor, parameters))
        return slopes, effort

    def _object_effort(self, parts: Parts, parameters: Parameters, lift_off_rows: IntArray) -> Parts:
        """Return the derivatives by the gains (n, p) and the effort (n,) before any sensor effect."""
        slopes, known = parts
        if len(lift_off_rows):
            slopes = slopes.copy("K")
            for column in np.flatnonzero(self.one_sided):
                slopes[lift_off_rows, column] = 0.0
        return slopes, known + slopes @ np.array([parameters[name] for name in self.gains])

    @cached_property
    def coupled_effects(self) -> list[Effect]:
        """The effects that act on the columns of others: motion, memory and non-pointwise sensor effects."""
        added = (*self.additive, *(sensor for sensor in self.sensors if sensor.pointwise))
        return [effect for effect in self.effects if effect not in added]

    @cached_property
    def additive(self) -> list[AdditiveEffect]:
        """The effects that add effort, in order."""
        return [e for e in self.effects if isinstance(e, AdditiveEffect)]

    @cached_property
    def one_sided(self) -> BoolArray:
        """Whether each gain belongs to an effect that can only push, shape (q,)."""
        return np.array([effect.one_sided for effect in self.additive for _ in effect.gains], dtype=np.bool_)

    @cached_property
    def sensors(self) -> list[SensorEffect]:
        """The sensor effects, in order."""
        return [e for e in self.effects if isinstance(e, SensorEffect)]

    def moved(self, data: ChannelData, parameters: Parameters) -> ChannelData:
        """Return the channel with the motion that acts on the object; unchanged without motion effects.

        Args:
            data: the channel with the measured motion.
            parameters: a value for every inner parameter.
        """
        for effect in self.effects:
            if isinstance(effect, MotionEffect):
                data = _moved(
                    IdentityKey(effect), IdentityKey(data), tuple(own_parameters(effect, parameters).items())
                )
        return data

    def parts(self, data: ChannelData, parameters: Parameters, columns_of: "Columns | None" = None) -> Parts:
        """Return the columns (n, p) and the known effort (n,) before any sensor effect.

        Args:
            data: the channel with the measured motion.
            parameters: a value for every inner parameter; gains are ignored.
            columns_of: function that looks up `columns`; None to compute them.
        """
        data, columns_of = self.moved(data, parameters), columns_of or Model.columns
        blocks = [np.zeros((0, len(data)))]
        known = np.zeros(len(data))
        for effect in self.additive:
            blocks.append(columns_of(self, effect, data, parameters).T)
            known = known + effect.known(data, own_parameters(effect, parameters))
        return np.concatenate(blocks).T, known  # contiguous columns: later steps work column by column

    def parts_after(
        self,
        effect: Effect,
        data: ChannelData,
        parameters: Parameters,
        parts: Parts,
        columns_of: "Columns | None" = None,
    ) -> Parts:
        """Return `parts` after a change of one effect's inner parameters; other columns are kept if possible.

        Args:
            effect: effect of the model whose parameters changed.
            data: the channel with the measured motion.
            parameters: a value for every inner parameter, after the change.
            parts: result of `parts` before the change.
            columns_of: function that looks up `columns`; None to compute them.
        """
        if isinstance(effect, SensorEffect):
            return parts
        if not isinstance(effect, AdditiveEffect) or type(effect).known is not AdditiveEffect.known:
            return self.parts(data, parameters, columns_of)
        moved, columns = self.moved(data, parameters), parts[0].copy("K")
        is_own = [gain.startswith(f"{effect.name}.") for gain in self.gains]
        columns[:, is_own] = (columns_of or Model.columns)(self, effect, moved, parameters)
        return columns, parts[1]

    def columns(self, effect: AdditiveEffect, data: ChannelData, parameters: Parameters) -> FloatArray:
        """Return the effort per unit of each of an effect's k gains, after the memory effects, (n, k).

        Args:
            effect: an effect of the model.
            data: the channel with the motion that acts on the object.
            parameters: a value for every inner parameter.
        """
        columns = effect.columns(data, own_parameters(effect, parameters))
        return self.relaxed_columns(effect, columns, data, parameters)

    def memories_of(self, effect: AdditiveEffect) -> list[MemoryEffect]:
        """Return the memory effects of the model that relax an effect, in order.

        Args:
            effect: an effect of the model.
        """
        if not any(gain.name in effect.elastic for gain in effect.gains):
            return []
        return [memory for memory in self.effects if isinstance(memory, MemoryEffect)]

    def relaxed_columns(
        self, effect: AdditiveEffect, columns: FloatArray, data: ChannelData, parameters: Parameters
    ) -> FloatArray:
        """Return an effect's columns (n, k) after the model's memory effects relaxed the elastic ones.

        Args:
            effect: effect to which the columns belong.
            columns: effort per unit of each of its gains, shape (n, k).
            data: the channel.
            parameters: a value for every inner parameter.
        """
        elastic = np.array([gain.name in effect.elastic for gain in effect.gains], dtype=np.bool_)
        if not (memories := self.memories_of(effect)):
            return columns
        fading = columns if elastic.all() else columns[:, elastic]  # results are cached by the same array
        for memory in memories:
            fading = memory.fade(fading, data, own_parameters(memory, parameters))
        columns = columns.copy()
        columns[:, elastic] = fading
        return columns


# Function that returns `Model.columns` of a model, or looks them up.
Columns = Callable[[Model, AdditiveEffect, ChannelData, Parameters], FloatArray]


def own_parameters(effect: Effect, parameters: Parameters) -> dict[str, float]:
    """Return the inner parameters of one effect, without the effect's name in their keys.

    Args:
        effect: the effect.
        parameters: values by "effect.parameter".
    """
    return {p.name: parameters[f"{effect.name}.{p.name}"] for p in effect.inner}


@lru_cache(maxsize=8)
def _moved(effect: IdentityKey, data: IdentityKey, inner: tuple[tuple[str, float], ...]) -> ChannelData:
    """Return the channel moved by an effect; cached because searches of other effects need it repeatedly."""
    moved: ChannelData = effect.wrapped.move(data.wrapped, dict(inner))
    return moved
