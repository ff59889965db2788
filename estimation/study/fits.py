"""Fits of one measurement: base models, added effects, noise and comparisons, each computed once."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from threading import RLock
from typing import Any

import numpy as np

from palpate.estimation.base_model import Arm
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.import_options import NO_OPTIONS, ImportOptions
from palpate.estimation.data_quality import quality_warnings, reject_reason
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.extension import PackedFit, fit_extended
from palpate.estimation.effect import Effect
from palpate.estimation.estimate import TableDisplay
from palpate.estimation.fit.fit_problem import NO_BOUNDS, NOT_HELD
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise, measurement_noise
from palpate.estimation.shared_gains import with_shared_gains
from palpate.estimation.study import fitting
from palpate.estimation.study.channels import (
    ALL_CHANNELS,
    FITTED_ARM_MODEL,
    ChannelKey,
    StudyChannel,
    channel_of,
    channels_for_model,
    default_model,
    inapplicable_reason,
    suited_names,
)
from palpate.estimation.study.comparison import Comparison, Comparisons, compare
from palpate.estimation.study.source import limit_length, open_source, without_unreadable_joints
from palpate.estimation.workers import release_freed_memory
from palpate.robot_io.errors import InputError

_FitKey = tuple[ChannelKey, tuple[str, ...]]  # a channel with its base model, and the added effects
_RECOVERS = "the object is assumed to have recovered when each run begins, because the data then fit better"
_SURFACE_RECOVERS = (
    "the damped surface is assumed to recover before it is touched again, with the time constant c / k, "
    "because the data then fit better"
)
_RECOVERS_SLOWLY = (
    "the object's surface moves freely between contacts, and is assumed to recover at {0:.2g} times the rate "
    "of relaxation in contact, because the data then fit better"
)
_MAX_FITS = 90  # size of the cache; the least recently used fits are dropped and computed again


class StudyFits(TableDisplay):
    """Models of one measurement, each fitted once; see `ModelStudy` for the arguments."""

    def __init__(
        self,
        data: Any,  # noqa: ANN401, whatever a user has
        model: str | None = None,
        *,
        options: ImportOptions = NO_OPTIONS,
        arm: Arm | None = None,
        effects: Mapping[str, Effect] | None = None,
        held_out: Sequence[int] = (),
    ) -> None:
        user_effects = effects or {}
        source = open_source(data, options, arm)
        if model is None:
            source = without_unreadable_joints(source)
        self.source = limit_length(source, held_out)
        del source  # otherwise its samples could not be released
        if self.source.averaged:
            release_freed_memory()
        self.held_out = tuple(sorted(set(held_out)))
        self.model = model
        self._library = {effect.name: effect for effect in (*effect_library(), *user_effects.values())}
        self._user_places = {effect.name: place for place, effect in user_effects.items()}
        self._lock = RLock()
        self._channels: dict[tuple[str, str], StudyChannel] = {}
        self._fits: dict[_FitKey, FitResult] = {}
        self._comparisons: dict[_FitKey, Comparison] = {}
        self._noise: dict[ChannelKey, MeasurementNoise] = {}
        measured = self.source.channels if model is None else channels_for_model(self.source, model)
        channels = [self._channel(data, model) for data in measured]
        # Add to each joint with fitted base parameters the information from the other joints.
        joints = [member for member in channels if member.model.name == FITTED_ARM_MODEL]
        shared = with_shared_gains([member.data for member in joints], [member.model for member in joints])
        for member, prepared in zip(joints, shared, strict=True):
            self._channels[member.name, member.model.name] = replace(member, prepared=prepared)
        self.channels = tuple(self._channels[member.name, member.model.name] for member in channels)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All candidate effects: those of palpate and those of the user."""
        return tuple(self._library.values())

    @property
    def user_effects(self) -> tuple[Effect, ...]:
        """Effects defined by the user."""
        return tuple(self._library[name] for name in self._user_places)

    @cached_property
    def warnings(self) -> dict[str, list[str]]:
        """Warnings about implausible data, for the channels that have any."""
        warnings = ((c.name, quality_warnings(c.measured, c.model)) for c in self.channels)
        return {name: sentences for name, sentences in warnings if sentences}

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """How the measurement was read and is treated, in sentences."""
        notes = [*self.source.notes]
        for contact in (each for each in self.channels if each.kind is ChannelKind.CONTACT):
            if contact.data.surface_recovers:
                notes.append(f"{contact.name}: {_SURFACE_RECOVERS}")
            if contact.data.recovers:
                notes.append(f"{contact.name}: {_RECOVERS}")
            elif contact.data.recovery_ratio != 1.0:
                notes.append(f"{contact.name}: {_RECOVERS_SLOWLY.format(contact.data.recovery_ratio)}")
        return tuple(notes)

    @property
    def reading(self) -> tuple[str, ...]:
        """What the columns of the data file were read as, and `notes`."""
        return *([f"read: {self.source.read}"] if self.source.read else []), *self.notes

    def channel(self, name: str | None = None) -> StudyChannel:
        """Return one channel.

        Args:
            name: name of the channel; None for the only channel.

        Raises:
            InputError: there is no such channel, or there are several.
        """
        chosen = self.chosen(name)
        if len(chosen) > 1:
            raise InputError(f"several channels: {_listed(chosen)}; choose one with --channel")
        return chosen[0]

    def chosen(self, name: str | None) -> tuple[StudyChannel, ...]:
        """Return one channel or all channels.

        Args:
            name: name of one channel; None or "all" for all of them.

        Raises:
            InputError: there is no such channel.
        """
        chosen = tuple(channel for channel in self.channels if name in {None, ALL_CHANNELS, channel.name})
        if not chosen:
            raise InputError(f"--channel {name}: no such channel. Available: {_listed(self.channels)}")
        return chosen

    def with_model(self, name: str, model: str) -> StudyChannel:
        """Return a channel with another base model.

        Args:
            name: name of the channel.
            model: name of the base model.

        Raises:
            InputError: there is no such channel, or the model is unknown or lacks required information.
        """
        data = next((channel for channel in self.source.channels if channel.name == name), None)
        if data is None:
            raise InputError(f"no channel '{name}'. Available: {_listed(self.source.channels)}")
        return self._channel(data, model)

    def refusal(self, channel: StudyChannel) -> str:
        """Return the reason why a channel cannot be fitted; empty if it can.

        Args:
            channel: the channel with its base model.
        """
        return reject_reason(channel.to_fit) or ""

    def fit(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> FitResult:
        """Fit the base model of a channel with added effects, or return the cached fit.

        Args:
            channel: the channel, or its name.
            effects: names of the added effects, in order.

        Raises:
            InputError: the channel cannot be fitted, or an effect is unknown, already present, or does not
                apply.
        """
        channel = self._resolve(channel)
        key = channel.key, tuple(effects)
        with self._lock:
            fit = self._fits.pop(key, None)
            if fit is None and effects:
                parent = self.fit(channel, effects[:-1])
                fit = fit_extended(channel.to_fit, parent, self._suited_effect(effects[-1], parent))
            elif fit is None:
                full_data = channel.data if channel.held_out else None
                fit = fitting.fit_base(channel.to_fit, channel.model, full_data)
            self._add_to_cache(key, fit)
            return fit

    def preview(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> FitResult:
        """Approximate `fit` in a tenth of the time; return the exact fit if it is in the cache.

        Args:
            channel: the channel, or its name.
            effects: names of the added effects, in order.

        Raises:
            InputError: see `fit`.
        """
        channel = self._resolve(channel)
        with self._lock:
            if not effects or self.is_fitted(channel, effects):
                return self.fit(channel, effects)
            parent = self.preview(channel, effects[:-1])
            return fitting.preview_extended(parent, self._suited_effect(effects[-1], parent))

    def is_fitted(self, channel: StudyChannel, effects: Sequence[str]) -> bool:
        """Return whether a fit is in the cache.

        Args:
            channel: the channel with its base model.
            effects: names of the added effects, in order.
        """
        with self._lock:
            return (channel.key, tuple(effects)) in self._fits

    def take_fit(self, channel: StudyChannel, effects: Sequence[str], packed: PackedFit) -> None:
        """Add a fit of the same data from another process to the cache.

        Args:
            channel: the channel.
            effects: names of the added effects, in order.
            packed: the fit.
        """
        with self._lock:
            if not self.is_fitted(channel, effects):
                fit = packed.unpack(channel.to_fit, self.fit(channel))
                self._add_to_cache((channel.key, tuple(effects)), fit)

    def fit_held(
        self,
        channel: StudyChannel | str,
        effects: Sequence[str] = (),
        held: Mapping[str, float] = NOT_HELD,
        bounds: Mapping[str, tuple[float, float]] = NO_BOUNDS,
    ) -> FitResult:
        """Refit the model of `fit` with some parameters held.

        Args:
            channel: the channel, or its name.
            effects: names of the added effects, in order.
            held: values of held parameters by "effect.parameter".
            bounds: bounds of other parameters; a parameter that would leave its bounds is held at the nearer
                bound.

        Raises:
            InputError: see `fit`; or a parameter does not exist, a value is not finite, or a lower bound
                exceeds the upper one.
        """
        channel = self._resolve(channel)
        with self._lock:
            free = self.fit(channel, effects)
            settings = [*held.items(), *((name, value) for name, pair in bounds.items() for value in pair)]
            for name, value in settings:
                if name not in free.values:
                    raise InputError(f"no parameter '{name}'. Available: {', '.join(free.values)}")
                try:
                    is_finite = math.isfinite(value)
                except TypeError:  # such as a text
                    is_finite = False
                if not is_finite:
                    raise InputError(f"{name}={value!r}: give a finite number")
            for name, (low, high) in bounds.items():
                if low > high:
                    raise InputError(
                        f"{name}: the bounds are {low:g} and {high:g}; give the lower bound first"
                    )
            fixed = dict(held)
            while True:
                fit = fitting.fit_held(channel.to_fit, free, fixed) if fixed else free
                outside = {
                    name: float(np.clip(fit.values[name], *pair))
                    for name, pair in bounds.items()
                    if name not in fixed and not pair[0] <= fit.values[name] <= pair[1]
                }
                if not outside:
                    return fit
                fixed |= outside

    def noise(self, channel: StudyChannel | str) -> MeasurementNoise:
        """Return the noise of a channel: the held-out error of a complete model.

        It is estimated with the base model, so that added effects do not change it; see `measurement_noise`.

        Args:
            channel: the channel, or its name.

        Raises:
            InputError: the channel cannot be fitted.
        """
        channel = self._resolve(channel)
        if channel.key not in self._noise:
            self._noise[channel.key] = measurement_noise(self.fit(channel))
        return self._noise[channel.key]

    def compare(self, channel: str | None = None) -> Comparisons:
        """Compare the base models with the measurement.

        Args:
            channel: name of one channel; None for all.

        Raises:
            InputError: there is no such channel, or none can be fitted.
        """
        compared, failures = [], {}
        for chosen in self.chosen(channel):
            try:
                compared.append(self.comparison(chosen))
            except InputError as error:
                failures[chosen.name] = str(error)
        if not compared:
            raise InputError(next(iter(failures.values())))
        return Comparisons(tuple(compared), failures)

    def comparison(self, channel: StudyChannel, effects: Sequence[str] = ()) -> Comparison:
        """Compare one model with the measurement.

        Args:
            channel: the channel.
            effects: names of the added effects, in order.

        Raises:
            InputError: see `fit`.
        """
        with self._lock:
            fit = self.fit(channel, effects)
            key = channel.key, tuple(effects)
            if key not in self._comparisons:
                name = " + ".join([channel.model.name, *effects])
                self._comparisons[key] = compare(fit, self.fit(channel), name, self.noise(channel))
            return self._comparisons[key]

    @property
    def _file(self) -> str:
        return str(self.source.path or self.source.name)

    def _resolve(self, channel: StudyChannel | str) -> StudyChannel:
        return self.channel(channel) if isinstance(channel, str) else channel

    def _channel(self, data: ChannelData, model: str | None) -> StudyChannel:
        name = model or default_model(data, self.source.arm)
        if (data.name, name) not in self._channels:
            held_out = self.source.runs_of(data, self.held_out)
            self._channels[data.name, name] = channel_of(data, name, self.source.arm, held_out)
        return self._channels[data.name, name]

    def _add_to_cache(self, key: _FitKey, fit: FitResult) -> None:
        """Add a fit to the cache as the most recently used one, and drop the least recently used fits."""
        self._fits[key] = fit
        while len(self._fits) > _MAX_FITS:
            oldest = next(iter(self._fits))
            del self._fits[oldest]
            self._comparisons.pop(oldest, None)

    def _effect(self, name: str) -> Effect:
        if name not in self._library:
            suggestion = suited_names(name, self.effects, [member.data for member in self.channels])
            raise InputError(f"no effect is called '{name}'. {suggestion}")
        return self._library[name]

    def _suited_effect(self, name: str, parent: FitResult) -> Effect:
        """Return an effect in the form that suits a channel; raise an error if it does not apply."""
        effect = self._effect(name)
        if reason := inapplicable_reason(effect, parent.data):
            raise InputError(reason)
        return effect.suited_to(parent.training)


def _listed(channels: Sequence[StudyChannel | ChannelData]) -> str:
    return ", ".join(channel.name for channel in channels)
