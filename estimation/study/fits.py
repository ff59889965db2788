"""Models of one measurement, each fitted once."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from threading import RLock
from types import MappingProxyType

import numpy as np

from estimation.channel import ChannelData
from estimation.diagnosis.candidates import effect_library
from estimation.effect import Effect
from estimation.fit.fit_problem import NOT_HELD
from estimation.shared_gains import with_shared_gains
from estimation.study import engine
from estimation.study.channels import (
    ALL_CHANNELS,
    FITTED_ARM_MODEL,
    StudyChannel,
    channel_of,
    described_by,
    suited_names,
    unapplicable,
    usual_model,
)
from estimation.study.comparison import Comparison, Comparisons, compare
from estimation.study.engine import Fitted
from estimation.study.shown import Shown, Table
from estimation.study.source import Source
from robot_io.errors import InputError

About = tuple[str, str, str]  # channel, base model, SHA-256 of the data
_Key = tuple[About, tuple[str, ...]]  # and the effects that were added
NO_BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType({})
_MOST_FITS = 90  # that are kept: those asked for longest ago would be the same again


class Fits(Shown):
    """Models of one measurement, each fitted once and beside the measurement; from any thread.

    Args:
        source: what was measured.
        model: base model; None for what suits each channel.
        effects: of the user's own.
        held_out: runs that no model is fitted to, and which alone judge models; none for each in turn.

    Raises:
        InputError: the model is unknown, does not describe the data, or lacks something; or no run is left.
    """

    def __init__(
        self, source: Source, model: str | None, effects: Sequence[Effect], held_out: Sequence[int] = ()
    ) -> None:
        self.source = source
        self.held_out = tuple(sorted(set(held_out)))
        self.model = model
        self._library = {effect.name: effect for effect in (*effect_library(), *effects)}
        self._lock = RLock()
        self._channels: dict[tuple[str, str], StudyChannel] = {}
        self._fits: dict[_Key, Fitted] = {}
        self._comparisons: dict[tuple[_Key, float], Comparison] = {}
        measured = source.channels if model is None else described_by(source, model)
        self.channels = self._of_one_arm(tuple(self._channel(one, model) for one in measured))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects that are tried: palpate's and the user's own."""
        return tuple(self._library.values())

    def channel(self, name: str | None = None) -> StudyChannel:
        """A channel by its name; the only one without. InputError: there is none, or there are several."""
        chosen = self.chosen(name)
        if len(chosen) > 1:
            there = ", ".join(one.name for one in chosen)
            raise InputError(f"several channels: {there}; choose one with --channel")
        return chosen[0]

    def chosen(self, name: str | None) -> tuple[StudyChannel, ...]:
        """The channel of this name; all of them without one, or for "all". InputError: there is none."""
        chosen = tuple(one for one in self.channels if name in {None, ALL_CHANNELS, one.name})
        if not chosen:
            there = ", ".join(one.name for one in self.channels)
            raise InputError(f"--channel {name}: no such channel. There are: {there}")
        return chosen

    def with_model(self, name: str, model: str) -> StudyChannel:
        """A channel with another base model than the study's own.

        Raises:
            InputError: there is no such channel, or the model is unknown, or lacks something.
        """
        data = next((one for one in self.source.channels if one.name == name), None)
        if data is None:
            there = ", ".join(one.name for one in self.source.channels)
            raise InputError(f"channel '{name}' is not there. There are: {there}")
        return self._channel(data, model)

    def fit(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> Fitted:
        """The base model of a channel with effects added in this order; fitted once.

        Raises:
            InputError: the channel cannot be judged, or an effect is unknown, there, or does not apply.
        """
        one = self.channel(channel) if isinstance(channel, str) else channel
        key = _key(one, effects)
        with self._lock:
            made = self._fits.pop(key, None) or self._fit(one, list(effects))
            self._remember(key, made)
            return made

    def glance(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> Fitted:
        """The model of `fit` roughly, in a tenth of the time; `fit` itself where that was made already.

        Raises:
            InputError: as `fit`.
        """
        one = self.channel(channel) if isinstance(channel, str) else channel
        with self._lock:
            if not effects or self.known(one, effects):
                return self.fit(one, effects)
            parent = self.glance(one, effects[:-1])
            return engine.glance(parent, self._form_of(effects[-1], parent))

    def known(self, channel: StudyChannel, effects: Sequence[str]) -> bool:
        """Whether this was fitted already."""
        with self._lock:
            return _key(channel, effects) in self._fits

    def take(self, channel: StudyChannel, effects: Sequence[str], packed: engine.Packed) -> None:
        """Take over a fit that another process made of the same data by the same engine."""
        with self._lock:
            if not self.known(channel, effects):
                self._remember(_key(channel, effects), packed.unpacked(channel.to_fit, self.fit(channel)))

    def fit_held(
        self,
        channel: StudyChannel | str,
        effects: Sequence[str] = (),
        held: Mapping[str, float] = NOT_HELD,
        bounds: Mapping[str, tuple[float, float]] = NO_BOUNDS,
    ) -> Fitted:
        """The model of `fit`, with some parameters held and the others fitted again.

        Args:
            channel: where.
            effects: added to its base model.
            held: values by "effect.parameter".
            bounds: lowest and highest value of others; one that would leave its bounds is held at the nearer.

        Raises:
            InputError: as `fit`; or there is no such parameter, or a value is not finite.
        """
        one = self.channel(channel) if isinstance(channel, str) else channel
        with self._lock:
            fitted = self.fit(one, effects)
            _check_values(
                fitted, [*held.items(), *((name, v) for name, pair in bounds.items() for v in pair)]
            )
            fixed = dict(held)
            while True:
                now = engine.fit_held(one.to_fit, fitted, fixed) if fixed else fitted
                outside = {
                    name: float(np.clip(now.values[name], *pair))
                    for name, pair in bounds.items()
                    if name not in fixed and not pair[0] <= now.values[name] <= pair[1]
                }
                if not outside:
                    return now
                fixed |= outside

    def noise_floor(self, channel: StudyChannel | str, *reached: float) -> float:
        """The error that a complete model would leave, in the unit of the effort.

        Args:
            channel: or its name.
            reached: errors of models that stand beside it; what one of them reaches is no more than noise.

        Raises:
            InputError: the channel cannot be judged.
        """
        return min([self.fit(channel).noise_floor, *reached])

    def compare(self, channel: str | None = None) -> Comparisons:
        """Put the base models beside the measurement.

        Raises:
            InputError: there is no such channel, or none can be judged.
        """
        found, failures = [], {}
        for one in self.chosen(channel):
            try:
                found.append(self.comparison(one))
            except InputError as error:
                failures[one.name] = str(error)
        if not found:
            raise InputError(next(iter(failures.values())))
        return Comparisons(tuple(found), failures)

    def comparison(self, channel: StudyChannel, effects: Sequence[str] = ()) -> Comparison:
        """One model beside the measurement; see `fit`."""
        with self._lock:
            fitted = self.fit(channel, effects)
            floor = self.noise_floor(channel, fitted.rmse)
            key = _key(channel, effects), floor
            if key not in self._comparisons:
                name = " + ".join([channel.model.name, *effects])
                self._comparisons[key] = compare(fitted, name, floor)
            return self._comparisons[key]

    def _remember(self, key: _Key, made: Fitted) -> None:
        """Keep a fit as the one asked for last, and forget those asked for longest ago."""
        self._fits[key] = made
        while len(self._fits) > _MOST_FITS:
            first = next(iter(self._fits))
            del self._fits[first]
            for compared in [one for one in self._comparisons if one[0] == first]:
                del self._comparisons[compared]

    def _loaded(self, one: StudyChannel) -> ChannelData:
        """The channel with the signals that a fit derives, such as the load of a joint."""
        try:
            return self.fit(one).data
        except InputError:  # it cannot be judged, which is said where it is chosen
            return one.data

    def _table(self) -> Table:
        rows = [
            (one.name, one.model.name, len(one.data.runs), len(one.data), one.sha256[:12])
            for one in self.channels
        ]
        return Table(self.source.name, ("channel", "base model", "runs", "samples", "SHA-256"), rows)

    @property
    def _file(self) -> str:
        return str(self.source.path or self.source.name)

    def _channel(self, data: ChannelData, model: str | None) -> StudyChannel:
        name = model or usual_model(data, self.source.arm)
        if (data.name, name) not in self._channels:
            held_out = self.source.runs_of(data, self.held_out)
            self._channels[data.name, name] = channel_of(data, name, self.source.arm, held_out)
        return self._channels[data.name, name]

    def _of_one_arm(self, channels: tuple[StudyChannel, ...]) -> tuple[StudyChannel, ...]:
        """The channels, with what joints whose masses are fitted say of the masses that they share."""
        fitted = [one for one in channels if one.model.name == FITTED_ARM_MODEL]
        shared = with_shared_gains([one.data for one in fitted], [one.model for one in fitted])
        found = {one.name: replace(one, prepared=data) for one, data in zip(fitted, shared, strict=True)}
        self._channels.update({(one.name, one.model.name): one for one in found.values()})
        return tuple(found.get(one.name, one) for one in channels)

    def _fit(self, one: StudyChannel, effects: list[str]) -> Fitted:
        if not effects:
            return engine.fit(one.to_fit, one.model, whole=one.data if one.held_out else None)
        parent = self.fit(one, effects[:-1])
        model = parent.model.with_effect(self._form_of(effects[-1], parent))
        return engine.fit(one.to_fit, model, parent, parent.whole)

    def _form_of(self, name: str, parent: Fitted) -> Effect:
        """An effect in the form that suits a channel. InputError: it is unknown, there, or does not apply."""
        effect = self._effect(name)
        if why := unapplicable(effect, parent.data):
            raise InputError(why)
        return effect.suited_to(parent.result.data)

    def _effect(self, name: str) -> Effect:
        if name not in self._library:
            known = suited_names(name, self.effects, [one.data for one in self.channels])
            raise InputError(f"no effect is called '{name}'. {known}")
        return self._library[name]


def about(channel: StudyChannel) -> About:
    """What a fit is about but for the effects that were added."""
    return channel.name, channel.model.name, channel.sha256


def _check_values(fitted: Fitted, values: Sequence[tuple[str, float]]) -> None:
    for name, value in values:
        if name not in fitted.values:
            raise InputError(f"no parameter '{name}'. There are: {', '.join(fitted.values)}")
        if not math.isfinite(value):
            raise InputError(f"{name}={value}: give a finite number")


def _key(channel: StudyChannel, effects: Sequence[str]) -> _Key:
    return about(channel), tuple(effects)
