"""One study: data, models, revisions and results, in which each number is computed once."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from threading import RLock
from types import MappingProxyType
from typing import Any

import numpy as np

from palpate.estimation.base_model import Arm
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data_quality import quality_warnings, reject_reason
from palpate.estimation.design.next_experiment import LONGEST_S, NextProbe
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.extension import PackedFit, fit_extended
from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.effect import Effect
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.estimate import DisplayTable, TableDisplay
from palpate.estimation.fit.fit_problem import NOT_HELD
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
    described_by,
    model_to_estimate,
    suited_names,
    unapplicable,
    usual_model,
)
from palpate.estimation.study.comparison import Comparison, Comparisons, compare
from palpate.estimation.study.estimates import (
    USUAL,
    ChannelEstimates,
    choose_estimators,
    estimate_with,
    only_runs,
)
from palpate.estimation.study.results import Change, ChannelResult, RevisionTable, Stage, StudyDiagnosis
from palpate.estimation.study.revisions import KeptParameter, Revision, Revisions
from palpate.estimation.study.saved_diagnosis import RESULT, diagnosis_data, is_other, read_diagnosis
from palpate.estimation.study.source import NO_OPTIONS, limit_length, open_source
from palpate.robot_io.errors import InputError

# Time that an experiment may take, and diagnoses as far as a plan depends on them.
_ProbeKey = tuple[float, tuple[tuple[ChannelKey, Verdict, tuple[str, ...]], ...]]
_FitKey = tuple[ChannelKey, tuple[str, ...]]  # a channel with its base model, and the effects that were added
Planner = Callable[["ModelStudy", Sequence[ChannelDiagnosis], float, fitting.Progress], NextProbe | None]
NO_BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType({})
_MOST_FITS = 90  # in the cache; the least recently used are dropped, and would be computed again


class ModelStudy(TableDisplay):
    """Models of one measurement: fit, compare, diagnose, extend, and go back to an earlier revision.

    A model is fitted once for each combination of data, base model and added effects, and all methods share
    that fit. The noise of a channel is one number too, see `noise`. Methods may be called from
    several threads.

    Args:
        data: see `palpate.estimation.study.source.open_source`.
        model: base model; None for the usual one of each channel.
        options: how to read a file or table.
        arm: the arm that the channels belong to, where the data does not say.
        effects: the user's own, by the name under which to load them again, such as "my_effects.py:Mine".
        folder: where revisions and the diagnosis are saved; None to keep them in memory.
        held_out: runs excluded from fitting and used only for scoring; none to score each run by the others.
        now: clock for the creation time of revisions.
        planner: plans an experiment that the arm of the recording can do; None where no arm is known.

    Raises:
        InputError: the data cannot be used, the model is unknown or does not describe it, or no run is left.
    """

    def __init__(
        self,
        data: Any,  # noqa: ANN401, whatever a user has
        model: str | None = None,
        *,
        options: ImportOptions = NO_OPTIONS,
        arm: Arm | None = None,
        effects: Mapping[str, Effect] | None = None,
        folder: Path | None = None,
        held_out: Sequence[int] = (),
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        planner: "Planner | None" = None,
    ) -> None:
        own = effects or {}
        self.source = limit_length(open_source(data, options, arm), held_out)
        self.held_out = tuple(sorted(set(held_out)))
        self.model = model
        self.folder = folder
        self._library = {effect.name: effect for effect in (*effect_library(), *own.values())}
        self._own = {effect.name: place for place, effect in own.items()}
        self._revisions = Revisions(folder)
        self._now = now
        self._planner = planner
        self._probes: dict[_ProbeKey, NextProbe | None] = {}
        self._lock = RLock()
        self._channels: dict[tuple[str, str], StudyChannel] = {}
        self._fits: dict[_FitKey, FitResult] = {}
        self._comparisons: dict[_FitKey, Comparison] = {}
        self._noise: dict[ChannelKey, MeasurementNoise] = {}
        self._diagnoses: dict[ChannelKey, ChannelDiagnosis] = {}
        measured = self.source.channels if model is None else described_by(self.source, model)
        self.channels = self._with_shared_gains(tuple(self._channel(data, model) for data in measured))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects that are tried: palpate's and the user's own."""
        return tuple(self._library.values())

    @property
    def own_effects(self) -> tuple[Effect, ...]:
        """The user's own effects."""
        return tuple(self._library[name] for name in self._own)

    @cached_property
    def warnings(self) -> dict[str, list[str]]:
        """Sentences on implausible data, by channel; only channels that have any."""
        warnings = {
            channel.name: quality_warnings(channel.measured, channel.model) for channel in self.channels
        }
        return {name: sentences for name, sentences in warnings.items() if sentences}

    # Channels

    def channel(self, name: str | None = None) -> StudyChannel:
        """Select one channel.

        Args:
            name: its name; None for the only channel.

        Raises:
            InputError: there is no such channel, or there are several.
        """
        chosen = self.chosen(name)
        if len(chosen) > 1:
            there = ", ".join(channel.name for channel in chosen)
            raise InputError(f"several channels: {there}; choose one with --channel")
        return chosen[0]

    def chosen(self, name: str | None) -> tuple[StudyChannel, ...]:
        """Select channels.

        Args:
            name: of one channel; None or "all" for all of them.

        Raises:
            InputError: there is no such channel.
        """
        chosen = tuple(channel for channel in self.channels if name in {None, ALL_CHANNELS, channel.name})
        if not chosen:
            there = ", ".join(channel.name for channel in self.channels)
            raise InputError(f"--channel {name}: no such channel. There are: {there}")
        return chosen

    def with_model(self, name: str, model: str) -> StudyChannel:
        """Select a channel with another base model than the study's.

        Args:
            name: of the channel.
            model: base model.

        Raises:
            InputError: there is no such channel, or the model is unknown, or lacks something.
        """
        data = next((channel for channel in self.source.channels if channel.name == name), None)
        if data is None:
            there = ", ".join(channel.name for channel in self.source.channels)
            raise InputError(f"channel '{name}' is not there. There are: {there}")
        return self._channel(data, model)

    def refusal(self, channel: StudyChannel) -> str:
        """Say why a channel cannot be judged; an empty text if it can.

        Args:
            channel: the channel with its base model.
        """
        return reject_reason(channel.to_fit, channel.model) or ""

    # Fits

    def fit(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> FitResult:
        """Fit the base model of a channel with added effects; from the cache if it was fitted before.

        Args:
            channel: the channel, or its name.
            effects: names of the added effects, in order.

        Raises:
            InputError: the channel cannot be judged, or an effect is unknown, there, or does not apply.
        """
        channel = self._resolve(channel)
        key = channel.key, tuple(effects)
        with self._lock:
            fit = self._fits.pop(key, None) or self._fit(channel, effects)
            self._remember(key, fit)
            return fit

    def preview(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> FitResult:
        """Approximate `fit` in a tenth of the time; return `fit` itself where that is in the cache.

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
        """Add a fit to the cache that another process made of the same data.

        Args:
            channel: the channel.
            effects: names of the added effects, in order.
            packed: the fit.
        """
        with self._lock:
            if not self.is_fitted(channel, effects):
                fit = packed.unpack(channel.to_fit, self.fit(channel))
                self._remember((channel.key, tuple(effects)), fit)

    def fit_held(
        self,
        channel: StudyChannel | str,
        effects: Sequence[str] = (),
        held: Mapping[str, float] = NOT_HELD,
        bounds: Mapping[str, tuple[float, float]] = NO_BOUNDS,
    ) -> FitResult:
        """Fit the model of `fit` again with some parameters held.

        Args:
            channel: the channel, or its name.
            effects: names of the added effects, in order.
            held: values by "effect.parameter".
            bounds: lowest and highest value of other parameters; one that would leave its bounds is held at
                the nearer bound.

        Raises:
            InputError: see `fit`; or there is no such parameter, or a value is not finite.
        """
        channel = self._resolve(channel)
        with self._lock:
            free = self.fit(channel, effects)
            given = [*held.items(), *((name, value) for name, pair in bounds.items() for value in pair)]
            for name, value in given:
                if name not in free.values:
                    raise InputError(f"no parameter '{name}'. There are: {', '.join(free.values)}")
                if not math.isfinite(value):
                    raise InputError(f"{name}={value}: give a finite number")
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
        """Return the noise of a channel: the held-out error that a complete model would leave.

        It is found beside the base model, and no added effect changes it; see `measurement_noise`.

        Args:
            channel: the channel, or its name.

        Raises:
            InputError: the channel cannot be judged.
        """
        channel = self._resolve(channel)
        if channel.key not in self._noise:
            self._noise[channel.key] = measurement_noise(self.fit(channel))
        return self._noise[channel.key]

    # Comparison with the measurement

    def compare(self, channel: str | None = None) -> Comparisons:
        """Compare the base models with the measurement.

        Args:
            channel: only this one; None for all.

        Raises:
            InputError: there is no such channel, or none can be judged.
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
                self._comparisons[key] = compare(fit, name, self.noise(channel))
            return self._comparisons[key]

    # Diagnosis

    def diagnose(
        self,
        channel: str | None = None,
        *,
        apply: bool = False,
        plan: bool = True,
        progress: fitting.Progress = lambda what, share: None,
        judge: fitting.Judge = fitting.diagnose,
    ) -> StudyDiagnosis:
        """Find out whether an effect is missing in the base models, and which.

        Args:
            channel: only this one; None for all.
            apply: add the missing effects, as revisions.
            plan: plan the next experiment for the arm that made the recording, if there is one.
            progress: called with the current step and the share of it that is done.
            judge: does the work, such as in another process.

        Raises:
            InputError: there is no such channel.
        """
        chosen = self.chosen(channel)
        if any(member.key not in self._diagnoses for member in chosen):
            data, models = [member.to_fit for member in chosen], [member.model for member in chosen]
            # Stretches of one recording are no runs, each of which might have met another zero or gain.
            excluded = RunVariation if self.source.stretches else ()
            effects = [effect for effect in self.effects if not isinstance(effect, excluded)]
            judged = judge(data, models, effects, progress, self._file)
            for member, entry in zip(chosen, judged.channels, strict=True):
                for added, packed in entry.take_fits().items():
                    self.take_fit(member, added, packed)
            entries = judged.channels
            probe = self.next_probe(entries, progress=progress) if plan else None
            if probe is not None:  # the arm can do more than repeat its motion in another way
                change = {"next_experiment": probe.proposal}
                entries = [
                    entry.model_copy(update=change) if entry.channel in probe.channels else entry
                    for entry in entries
                ]
            averaged, warnings = self.source.averaged, self.warnings
            entries = [
                entry.model_copy(
                    update={
                        "averaged": averaged.get(entry.channel, ""),
                        "warnings": list(warnings.get(entry.channel, ())),
                    }
                )
                for entry in entries
            ]
            with self._lock:
                self._diagnoses |= {member.key: entry for member, entry in zip(chosen, entries, strict=True)}
        entries = [self._diagnoses[member.key] for member in chosen]
        for member, entry in zip(chosen, entries, strict=True):
            if apply and entry.accepted:
                self._keep(member, [accepted.effect for accepted in entry.accepted], None)
        names = "+".join(dict.fromkeys(member.model.name for member in chosen))
        return StudyDiagnosis(file=self._file, model=names, channels=entries)

    def next_probe(
        self,
        diagnosed: Sequence[ChannelDiagnosis],
        longest_s: float = LONGEST_S,
        progress: fitting.Progress = lambda what, share: None,
    ) -> NextProbe | None:
        """Plan the experiment that best tells apart what diagnoses of this study have not decided.

        This is the one place that decides it: `diagnose` puts the plan into its result, and commands, page
        and `palpate resolve` run it. It is planned once for the same verdicts and effects.

        Args:
            diagnosed: diagnoses of channels of this study.
            longest_s: time that the experiment may take [s].
            progress: called with the current step and the share of it that is done.

        Returns:
            The probe; None where the data come from no probing arm, or no probe that it can do tells more.

        Raises:
            InputError: the session's own copies of robot file or plan are not valid.
        """
        if self._planner is None:
            return None
        key = (
            longest_s,
            tuple(
                (
                    self.channel(entry.channel).key,
                    entry.verdict,
                    tuple(effect.effect for effect in entry.accepted),
                )
                for entry in diagnosed
            ),
        )
        if key not in self._probes:
            self._probes[key] = self._planner(self, diagnosed, longest_s, progress)
        return self._probes[key]

    def diagnosis_data(self, diagnosis: StudyDiagnosis) -> dict[str, Any]:
        """Return a diagnosis as plain data, with the data and models that it is about; keys are stable.

        Args:
            diagnosis: of channels of this study.
        """
        return diagnosis_data(diagnosis, self.channels)

    def known_diagnosis(self, channel: StudyChannel) -> ChannelDiagnosis | None:
        """Return the diagnosis of this data and base model, made now or saved earlier; None without one.

        Args:
            channel: the channel with its base model.

        Raises:
            InputError: the file in the folder is damaged, or says other numbers than this study's fits.
        """
        made = self._diagnoses.get(channel.key)
        saved = None if made else read_diagnosis(self.folder).get(channel.key)
        if saved is None or saved.baseline is None or channel.held_out:  # which are scored otherwise
            return made or saved
        with self._lock:
            noise, names = self.noise(channel).value, [entry.effect for entry in saved.accepted]
            if saved.noise_floor is not None and is_other(saved.noise_floor, noise):
                why = f"its noise is {saved.noise_floor:.4g}, and this data give {noise:.4g}"
            else:
                why = self._other_numbers(channel, [], saved.baseline.rmse, saved.baseline.parameters)
            if not why and saved.final is not None:
                why = self._other_numbers(channel, names, saved.final.rmse, saved.final.parameters)
        if why:
            raise InputError(
                f"{self.folder}/{RESULT}: channel {channel.name}: {why}: it was changed, or made by another "
                "version; delete it, or run palpate diagnose again"
            )
        return saved

    def _other_numbers(
        self,
        channel: StudyChannel,
        effects: Sequence[str],
        rmse: float,
        parameters: Mapping[str, ParameterValue],
    ) -> str:
        """Say which saved number of a model is not that of its fit, in a few words; empty if none.

        Nothing can be said of a model with an effect of the user's own whose code was not named.
        """
        if not set(effects) <= set(self._library):
            return ""
        fit = self.fit(channel, effects)
        if is_other(rmse, fit.rmse):
            return f"its error is {rmse:.4g}, and this data give {fit.rmse:.4g}"
        for name, saved in parameters.items():
            fitted = fit.parameters.get(name)
            if fitted is not None and is_other(saved.value, fitted.value, fitted.std_err):
                return f"its {name} is {saved.value:.4g}, and this data give {fitted.value:.4g}"
        return ""

    # Estimates

    def estimate(
        self,
        estimators: str | Sequence[str] = USUAL,
        channel: str | None = None,
        runs: Sequence[int] | None = None,
    ) -> tuple[ChannelEstimates, ...]:
        """Estimate parameters with several methods, with 95 % intervals.

        The force of a probing is tared: its value in free air is subtracted.

        Args:
            estimators: names separated by commas, a list of names, or "all".
            channel: only this one; None for contacts, or for joints where there is no contact.
            runs: only these; None for all.

        Raises:
            InputError: a name or run is unknown, or no estimator can work.
        """
        names, models = choose_estimators(estimators), model_to_estimate(self.source, self.model)
        data: Sequence[ChannelData] = [
            data for data in self.source.tared() if data.name in models and channel in {None, data.name}
        ]
        if self.held_out:
            data = replace(self.source, channels=tuple(data)).without(self.held_out).channels
        if not data:
            raise InputError(f"no channel '{channel}' to estimate. There are: {', '.join(models)}")
        chosen = [channel if runs is None else only_runs(channel, runs, self.source) for channel in data]
        return tuple(
            replace(
                estimate_with(channel, models[channel.name], names, self.source.arm),
                noise=self._noise_if_judged(channel.name),
            )
            for channel in chosen
        )

    def _noise_if_judged(self, name: str) -> MeasurementNoise | None:
        try:
            return self.noise(name)
        except InputError:
            return None

    # Revisions

    @property
    def revisions(self) -> RevisionTable:
        """All revisions, oldest first.

        Raises:
            InputError: a file in the folder is not a revision.
        """
        return RevisionTable(self._revisions.all())

    def add(
        self, *effects: str, channel: str | None = None, start: int | None = None, fresh: bool = False
    ) -> Change:
        """Add effects one by one, refit all parameters at each stage, and save each stage as a revision.

        Args:
            effects: names, in order.
            channel: where; None for the channel that the effects suit.
            start: revision to continue; None for the channel's newest of this data.
            fresh: start from the base model.

        Raises:
            InputError: a name is unknown, an effect is there already or does not apply, or arguments
                contradict.
        """
        if not (effects and all(isinstance(name, str) for name in effects)):
            raise InputError(
                f"add({', '.join(map(repr, effects))}): give names of effects, such as add('dry_friction')"
            )
        chosen = [self._effect(name) for name in effects]
        with self._lock:
            if start is None:
                base = self._suited_channel(chosen, channel, fresh=fresh)
                parent = None if fresh else self.latest(base)
            else:
                parent = self._revisions.get(start)
                given = {"--fresh": fresh, "--model": self.model, "--channel": channel}
                if extra := [option for option, value in given.items() if value]:
                    raise InputError(f"--from {start} sets channel and model: leave out {extra[0]}")
                base = self.channel_of(parent)
                self.check(parent)
            before = [] if parent is None else parent.effects
            if parent is not None:
                self._check_own(parent)
                if there := [name for name in effects if name in before]:
                    raise InputError(
                        f"revision {parent.number} has {', '.join(there)} already: continue from one without "
                        "it (--from, see palpate revisions), or start again (--fresh)"
                    )
            added = [*before, *effects]
            new = self._keep(base, added, parent)
            return Change(self.result(base, added, self.known_diagnosis(base)), new, parent)

    def remove(self, effect: str, channel: str | None = None) -> Change:
        """Remove an effect from the newest model of a channel, as a further revision.

        Args:
            effect: its name.
            channel: where; None for the channel whose newest model has it.

        Raises:
            InputError: that effect was added to no channel's newest model, or to those of several.
        """
        with self._lock:
            newest = [kept for member in self.chosen(channel) if (kept := self.newest(member)) is not None]
            having = [revision for revision in newest if effect in revision.effects]
            if not having:
                added = (f"{kept.channel} has {', '.join(kept.effects)}" for kept in newest if kept.effects)
                known = "; ".join(added) or "Nothing was added yet"
                raise InputError(f"remove {effect!r}: was not added to any model. {known}")
            if len(having) > 1:
                there = ", ".join(revision.channel for revision in having)
                raise InputError(f"remove {effect!r}: was added to {there}; choose one with --channel")
            (parent,) = having
            self._check_own(parent)
            base, left = self.channel_of(parent), [name for name in parent.effects if name != effect]
            revision = self._keep_one(base, left, parent, removed=effect)
            return Change(self.result(base, left, self.known_diagnosis(base)), (revision,), parent)

    def latest(self, channel: StudyChannel) -> Revision | None:
        """Return the newest revision of a channel's data and base model; None without one.

        Args:
            channel: the channel with its base model.
        """
        same = (revision for revision in reversed(self.revisions) if revision.key == channel.key)
        return next(same, None)

    def newest(self, channel: StudyChannel) -> Revision | None:
        """Return the newest revision of a channel's data, with any base model unless the study has one.

        Args:
            channel: the channel.
        """
        if self.model is not None:
            return self.latest(channel)
        same = (
            revision
            for revision in reversed(self.revisions)
            if (revision.channel, revision.data_sha256) == (channel.name, channel.sha256)
        )
        return next(same, None)

    def revision(self, number: int) -> Revision:
        """Return a revision by its number.

        Args:
            number: of the revision.

        Raises:
            InputError: there is none, or it has an effect of the user's own that this study was not given.
        """
        revision = self._revisions.get(number)
        self._check_own(revision)
        return revision

    def channel_of(self, revision: Revision) -> StudyChannel:
        """Return the channel of a revision, with its base model.

        Args:
            revision: of this study's folder.

        Raises:
            InputError: the channel is not there.
        """
        return self.with_model(revision.channel, revision.model)

    def check(self, revision: Revision) -> None:
        """Reject a revision of other data, or with other numbers than this study's fit.

        Args:
            revision: of this study's folder.

        Raises:
            InputError: it is such a one, or its channel is not there.
        """
        channel = self.channel_of(revision)
        if channel.sha256 != revision.data_sha256:
            raise InputError(
                f"revision {revision.number} is from other data (SHA-256 {revision.data_sha256[:12]}...). "
                "Give "
                "the options that it was made with (--where, --unit, --urdf), add to this data first "
                "(palpate diagnose --apply, palpate add --fresh), or name another folder"
            )
        if why := self._other_numbers(channel, revision.effects, revision.rmse, revision.parameters):
            raise InputError(
                f"revision {revision.number}: {why}: it was changed, or made by another version "
                f"({revision.software_version}); add its effects again (palpate add --fresh)"
            )

    # Results

    def results(self) -> tuple[ChannelResult, ...]:
        """Return everything known of each channel, with the newest revision of this data.

        Raises:
            InputError: a file in the folder is damaged.
        """
        return tuple(self._newest_result(self._current(member)) for member in self.channels)

    def result(
        self,
        channel: StudyChannel,
        effects: Sequence[str] = (),
        diagnosis: ChannelDiagnosis | None = None,
        reason: str = "",
    ) -> ChannelResult:
        """Return a channel's base model and each stage of adding effects, compared with the measurement.

        Args:
            channel: with its base model.
            effects: names of the added effects, in order.
            diagnosis: the diagnosis of the base model; None without one.
            reason: why added effects are left out.

        Raises:
            InputError: an effect is unknown, there already, or does not apply.
        """
        try:
            base = self.comparison(channel)
        except InputError as error:
            return ChannelResult(channel, diagnosis, reason=str(error))
        same = [revision for revision in self.revisions if revision.key == channel.key]
        numbers = {tuple(revision.effects): revision.number for revision in same}
        chains = [tuple(effects[:count]) for count in range(len(effects) + 1)]
        stages = [
            Stage(self.fit(channel, chain), "".join(chain[-1:]), numbers.get(chain)) for chain in chains
        ]
        grown = self.comparison(channel, effects) if effects else None
        return ChannelResult(channel, diagnosis, base, tuple(stages), grown, self.noise(channel), reason)

    def _table(self) -> DisplayTable:
        rows = [
            (member.name, member.model.name, len(member.data.runs), len(member.data), member.sha256[:12])
            for member in self.channels
        ]
        return DisplayTable(self.source.name, ("channel", "base model", "runs", "samples", "SHA-256"), rows)

    @property
    def _file(self) -> str:
        return str(self.source.path or self.source.name)

    def _resolve(self, channel: StudyChannel | str) -> StudyChannel:
        return self.channel(channel) if isinstance(channel, str) else channel

    def _channel(self, data: ChannelData, model: str | None) -> StudyChannel:
        name = model or usual_model(data, self.source.arm)
        if (data.name, name) not in self._channels:
            held_out = self.source.runs_of(data, self.held_out)
            self._channels[data.name, name] = channel_of(data, name, self.source.arm, held_out)
        return self._channels[data.name, name]

    def _with_shared_gains(self, channels: tuple[StudyChannel, ...]) -> tuple[StudyChannel, ...]:
        """Add to each joint whose masses are fitted what the other joints say of the same masses."""
        joints = [member for member in channels if member.model.name == FITTED_ARM_MODEL]
        shared = with_shared_gains([member.data for member in joints], [member.model for member in joints])
        prepared = {
            member.name: replace(member, prepared=data) for member, data in zip(joints, shared, strict=True)
        }
        self._channels.update({(member.name, member.model.name): member for member in prepared.values()})
        return tuple(prepared.get(member.name, member) for member in channels)

    def _fit(self, channel: StudyChannel, effects: Sequence[str]) -> FitResult:
        if not effects:
            whole = channel.data if channel.held_out else None
            return fitting.fit_base(channel.to_fit, channel.model, whole)
        parent = self.fit(channel, effects[:-1])
        return fit_extended(channel.to_fit, parent, self._suited_effect(effects[-1], parent))

    def _remember(self, key: _FitKey, fit: FitResult) -> None:
        """Put a fit last in the cache, and drop the least recently used fits."""
        self._fits[key] = fit
        while len(self._fits) > _MOST_FITS:
            oldest = next(iter(self._fits))
            del self._fits[oldest]
            self._comparisons.pop(oldest, None)

    def _effect(self, name: str) -> Effect:
        if name not in self._library:
            known = suited_names(name, self.effects, [member.data for member in self.channels])
            raise InputError(f"no effect is called '{name}'. {known}")
        return self._library[name]

    def _suited_effect(self, name: str, parent: FitResult) -> Effect:
        """Return an effect in the form that suits a channel.

        Raises:
            InputError: it is unknown, there already, or does not apply.
        """
        effect = self._effect(name)
        if why := unapplicable(effect, parent.data):
            raise InputError(why)
        return effect.suited_to(parent.training)

    def _suited_channel(self, effects: Sequence[Effect], name: str | None, *, fresh: bool) -> StudyChannel:
        """Return the one channel to which these effects apply; the contact, if they apply to that too."""
        chosen = self.chosen(name)
        begun = chosen if fresh else tuple(map(self._current, chosen))
        fitting_channels = [
            base for base in begun if not any(unapplicable(effect, self._loaded(base)) for effect in effects)
        ]
        names = " and ".join(effect.name for effect in effects)
        if not fitting_channels:
            there = ", ".join(f"{base.name} ({base.kind})" for base in begun)
            known = suited_names(effects[0].name, self.effects, [base.data for base in begun])
            raise InputError(
                f"{names} {'do' if len(effects) > 1 else 'does'} not apply to any channel: {there}. {known}"
            )
        contacts = [base for base in fitting_channels if base.kind is ChannelKind.CONTACT]
        if len(fitting_channels) > 1 and len(contacts) != 1:
            there = ", ".join(base.name for base in fitting_channels)
            raise InputError(f"{names} can be in {there}: choose one with --channel")
        return (contacts or fitting_channels)[0]

    def _loaded(self, channel: StudyChannel) -> ChannelData:
        """Return the channel with the signals that a fit derives, such as the load of a joint."""
        try:
            return self.fit(channel).data
        except InputError:  # it cannot be judged; whoever chooses it is told why
            return channel.data

    def _current(self, channel: StudyChannel) -> StudyChannel:
        newest = self.newest(channel)
        return channel if newest is None else self.channel_of(newest)

    def _newest_result(self, channel: StudyChannel) -> ChannelResult:
        newest, diagnosis = self.latest(channel), self.known_diagnosis(channel)
        if newest is None:
            return self.result(channel, (), diagnosis)
        try:
            self._check_own(newest)
        except InputError as error:
            left_out = f"{channel.name} is shown without what was added to it: {error}"
            return self.result(channel, (), diagnosis, left_out)
        return self.result(channel, newest.effects, diagnosis)

    def _check_own(self, revision: Revision) -> None:
        """Reject a revision with an effect of the user's own whose code the user did not name now."""
        for place in revision.user_effects:
            if place not in self._own.values():
                raise InputError(
                    f"revision {revision.number} has an effect of your own: add --effect {place}"
                )

    def _keep(
        self, channel: StudyChannel, effects: Sequence[str], parent: Revision | None
    ) -> tuple[Revision, ...]:
        """Save each stage after the parent, or after the base model that is saved already."""
        bases = (
            revision for revision in self.revisions if revision.key == channel.key and not revision.effects
        )
        before = parent or next(bases, None)
        self.fit(channel, effects)  # nothing is saved of what cannot be added
        kept: list[Revision] = []
        try:
            for count in range(0 if before is None else len(before.effects) + 1, len(effects) + 1):
                kept.append(self._keep_one(channel, effects[:count], kept[-1] if kept else before))
        except BaseException:  # a full disk, or Ctrl-C: all stages or none
            self._revisions.drop(kept)
            raise
        return tuple(kept)

    def _keep_one(
        self, channel: StudyChannel, effects: Sequence[str], parent: Revision | None, *, removed: str = ""
    ) -> Revision:
        from importlib.metadata import version  # noqa: PLC0415, slow to import

        fit, created = self.fit(channel, effects), self._now().isoformat(timespec="seconds")
        return self._revisions.keep(
            lambda number: Revision(
                number=number,
                parent=None if parent is None else parent.number,
                channel=channel.name,
                model=channel.model.name,
                added="" if removed else "".join(effects[-1:]),
                removed=removed,
                effects=list(effects),
                user_effects=[self._own[name] for name in effects if name in self._own],
                effort_unit=channel.effort_unit,
                rmse=fit.rmse,
                noise_floor=self.noise(channel).value,
                parameters={name: KeptParameter.of(value) for name, value in fit.parameters.items()},
                data_sha256=channel.sha256,
                created_utc=created,
                software_version=version("palpate"),
            )
        )
