"""One study: data, models, revisions and results, in which each number is computed once."""

import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from threading import RLock
from typing import Any

from estimation.channel import ChannelData, ChannelKind
from estimation.data.import_options import ImportOptions
from estimation.diagnosis import ChannelDiagnosis
from estimation.diagnosis.search.library import library
from estimation.effect import Effect
from estimation.effects import EFFECTS
from estimation.study import engine
from estimation.study.channels import (
    ALL_CHANNELS,
    StudyChannel,
    channel_of,
    described_by,
    model_to_estimate,
    unapplicable,
    usual_model,
)
from estimation.study.comparison import Comparison, Comparisons, compare
from estimation.study.engine import Fitted
from estimation.study.estimates import ALL, ChannelEstimates, choose_estimators, estimate_with, only_runs
from estimation.study.html import html_table
from estimation.study.kept_diagnosis import diagnosis_data, read_diagnosis
from estimation.study.reconcile import reconcile
from estimation.study.results import Change, ChannelResult, RevisionTable, Stage, StudyDiagnosis
from estimation.study.revisions import KeptParameter, Revision, Revisions
from estimation.study.source import NO_OPTIONS, Arm, open_source
from robot_io.errors import InputError

_Key = tuple[str, str, str, tuple[str, ...]]  # channel, base model, SHA-256 of the data, effects added


class Study:
    """Models of one measurement, compared, diagnosed, extended and gone back to.

    A model is fitted once for each combination of data, base model and added effects. What `compare` shows of
    the base model, revision 0, and the baseline of a diagnosis are that one fit. The noise floor of a channel
    is one number too: the one that is estimated beside its base model. It may be used from several threads.

    Args:
        data: see `estimation.study.source.open_source`.
        model: base model; None for what suits each channel.
        options: how to read a file or table.
        arm: what the channels belong to, where the data does not say.
        effects: of the user's own, by the name under which to load them again, such as "my_effects.py:Mine".
        folder: where revisions and the diagnosis are kept; None to keep them in memory.
        now: the time at which a revision is made.

    Raises:
        InputError: the data cannot be used, or the model does not describe it.
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
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self.source = open_source(data, options, arm)
        self.folder = folder
        self._model = model
        self._own = {effect.name: place for place, effect in (effects or {}).items()}
        self._library = {effect.name: effect for effect in (*library(), *(effects or {}).values())}
        self._revisions = Revisions(folder)
        self._now = now
        self._lock = RLock()
        self._channels: dict[tuple[str, str], StudyChannel] = {}
        self._fits: dict[_Key, Fitted] = {}
        self._comparisons: dict[_Key, Comparison] = {}
        self._diagnoses: dict[tuple[str, str, str], ChannelDiagnosis] = {}
        measured = self.source.channels if model is None else described_by(self.source, model)
        self.channels = tuple(self._channel(one, model) for one in measured)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects that are tried: palpate's and the user's own."""
        return tuple(self._library.values())

    @property
    def revisions(self) -> RevisionTable:
        """All stages that were ever kept, oldest first.

        Raises:
            InputError: a file in the folder is not a revision.
        """
        return RevisionTable(self._revisions.all())

    def channel(self, name: str | None = None) -> StudyChannel:
        """A channel by its name; the only one without.

        Raises:
            InputError: there is none, or there are several.
        """
        chosen = self.chosen(name)
        if len(chosen) > 1:
            there = ", ".join(one.name for one in chosen)
            raise InputError(f"several channels: {there}; choose one with --channel")
        return chosen[0]

    def chosen(self, name: str | None) -> tuple[StudyChannel, ...]:
        """The channel of this name; all of them without one, or for "all".

        Raises:
            InputError: there is none.
        """
        chosen = tuple(one for one in self.channels if name in {None, ALL_CHANNELS, one.name})
        if not chosen:
            there = ", ".join(one.name for one in self.channels)
            raise InputError(f"--channel {name}: no such channel. There are: {there}")
        return chosen

    def fit(self, channel: StudyChannel | str, effects: Sequence[str] = ()) -> Fitted:
        """The base model of a channel with effects added in this order; fitted once.

        Raises:
            InputError: the channel cannot be judged, or an effect is unknown, there, or does not apply.
        """
        one = self.channel(channel) if isinstance(channel, str) else channel
        key = _key(one, effects)
        with self._lock:
            if key not in self._fits:
                self._fits[key] = self._fit(one, list(effects))
            return self._fits[key]

    def noise_floor(self, channel: StudyChannel | str) -> float:
        """The error that a complete model would leave, in the unit of the effort: one number for a channel.

        Raises:
            InputError: the channel cannot be judged.
        """
        return self.fit(channel).noise_floor

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
        key = _key(channel, effects)
        with self._lock:
            if key not in self._comparisons:
                name = " + ".join([channel.model.name, *effects])
                fitted = self.fit(channel, effects)
                self._comparisons[key] = compare(fitted, name, self.noise_floor(channel))
            return self._comparisons[key]

    def diagnose(
        self,
        channel: str | None = None,
        *,
        apply: bool = False,
        progress: engine.Progress = lambda what, share: None,
    ) -> StudyDiagnosis:
        """Say whether anything is missing in the base models, and which effect it is.

        Args:
            channel: only this one; None for all.
            apply: add what is missing, as revisions.
            progress: called with what is being done, and which share of that is done.

        Raises:
            InputError: there is no such channel.
        """
        chosen = self.chosen(channel)
        unknown = [one for one in chosen if _about(one) not in self._diagnoses]
        if unknown:
            data, models = [one.data for one in chosen], [one.model for one in chosen]
            judged = engine.diagnose(data, models, self.effects, progress, self._file)
            found = [reconcile(self, *pair) for pair in zip(chosen, judged.channels, strict=True)]
            with self._lock:
                self._diagnoses |= dict(zip(map(_about, chosen), found, strict=True))
        answers = [self._diagnoses[_about(one)] for one in chosen]
        for one, answer in zip(chosen, answers, strict=True):
            if apply and answer.accepted:
                self._keep(one, [entry.effect for entry in answer.accepted], None)
        names = "+".join(dict.fromkeys(one.model.name for one in chosen))
        return StudyDiagnosis(file=self._file, model=names, channels=answers)

    def diagnosis_data(self, diagnosis: StudyDiagnosis) -> dict[str, Any]:
        """A diagnosis as plain data, with what it is about; the keys are stable."""
        return diagnosis_data(diagnosis, self.channels)

    def known_diagnosis(self, channel: StudyChannel) -> ChannelDiagnosis | None:
        """What was found in this data and base model, in this study or earlier; None if nobody asked.

        Raises:
            InputError: the file in the folder is damaged.
        """
        about = _about(channel)
        return self._diagnoses.get(about) or read_diagnosis(self.folder).get(about)

    def add(
        self, *effects: str, channel: str | None = None, start: int | None = None, fresh: bool = False
    ) -> Change:
        """Add effects, refitting everything at each stage, and keep each stage as a revision.

        Args:
            effects: names, in order.
            channel: where; None for the one that the effects suit.
            start: revision to continue; None for the channel's newest of this data.
            fresh: begin with the base model again.

        Raises:
            InputError: a name is unknown, an effect is there already or does not apply, or arguments
                contradict.
        """
        chosen = [self._effect(name) for name in effects]
        with self._lock:
            if start is None:
                one = self._suited(chosen, channel, fresh=fresh)
                parent = None if fresh else self.latest(one)
            else:
                parent = self._revisions.get(start)
                given = {"--fresh": fresh, "--model": self._model, "--channel": channel}
                if extra := [option for option, value in given.items() if value]:
                    raise InputError(f"--from {start} says channel and model already: leave out {extra[0]}")
                one = self.channel_of(parent)
                self.check(parent)
            before = [] if parent is None else parent.effects
            if parent is not None:
                self._check_own(parent)
                if there := [name for name in effects if name in before]:
                    raise InputError(
                        f"revision {parent.number} has {', '.join(there)} already: go on from one without it "
                        "(--from, see palpate revisions), or begin anew (--fresh)"
                    )
            added = [*before, *effects]
            new = self._keep(one, added, parent)
            return Change(self.result(one, added, self.known_diagnosis(one)), new, parent)

    def remove(self, effect: str, channel: str | None = None) -> Change:
        """Take an effect out of the newest model of a channel again; what was before is kept.

        Raises:
            InputError: no newest model has that effect, or those of several channels have.
        """
        with self._lock:
            newest = [self.newest(one) for one in self.chosen(channel)]
            having = [kept for kept in newest if kept is not None and effect in kept.effects]
            if len(having) != 1:
                there = ", ".join(kept.channel for kept in having) or "none"
                raise InputError(
                    f"remove {effect}: the newest model of {there} has it; name one such channel"
                )
            (parent,) = having
            self._check_own(parent)
            one, left = self.channel_of(parent), [name for name in parent.effects if name != effect]
            revision = self._kept(one, left, parent, removed=effect)
            return Change(self.result(one, left, self.known_diagnosis(one)), (revision,), parent)

    def estimate(
        self, estimators: str = ALL, channel: str | None = None, runs: Sequence[int] | None = None
    ) -> tuple[ChannelEstimates, ...]:
        """Parameters by every method, with 95 % intervals; the force in free air is taken off a probing's.

        Args:
            estimators: "all", or names with commas between them.
            channel: only this one; None for contacts, or joints where there is no contact.
            runs: only these; None for all.

        Raises:
            InputError: a name or run is unknown, or no estimator can work.
        """
        names, models = choose_estimators(estimators), model_to_estimate(self.source, self._model)
        wanted = [one for one in self.source.tared() if one.name in models and channel in {None, one.name}]
        if not wanted:
            raise InputError(f"no channel '{channel}' to estimate. There are: {', '.join(models)}")
        arm = self.source.arm
        return tuple(estimate_with(only_runs(one, runs), models[one.name], names, arm) for one in wanted)

    def results(self) -> tuple[ChannelResult, ...]:
        """All that is known of each channel, with the newest revision of this data.

        Raises:
            InputError: something in the folder is damaged.
        """
        return tuple(self._newest_result(self._current(one)) for one in self.channels)

    def result(
        self,
        channel: StudyChannel,
        effects: Sequence[str] = (),
        diagnosis: ChannelDiagnosis | None = None,
        reason: str = "",
    ) -> ChannelResult:
        """The base model of a channel and each stage of adding effects, beside the measurement.

        Args:
            channel: with its base model.
            effects: that were added, in order.
            diagnosis: what is missing, if anybody asked.
            reason: why what was added is left out.

        Raises:
            InputError: an effect is unknown, there already, or does not apply.
        """
        try:
            base = self.comparison(channel)
        except InputError as error:
            return ChannelResult(channel, diagnosis, reason=str(error))
        same = [kept for kept in self.revisions if _about_revision(kept) == _about(channel)]
        numbers = {tuple(kept.effects): kept.number for kept in same}
        chains = [tuple(effects[:count]) for count in range(len(effects) + 1)]
        stages = [Stage(self.fit(channel, one), "".join(one[-1:]), numbers.get(one)) for one in chains]
        grown = self.comparison(channel, effects) if effects else None
        return ChannelResult(
            channel, diagnosis, base, tuple(stages), grown, self.noise_floor(channel), reason
        )

    def latest(self, channel: StudyChannel) -> Revision | None:
        """The newest revision of this channel, data and base model."""
        about = _about(channel)
        return next((kept for kept in reversed(self.revisions) if _about_revision(kept) == about), None)

    def newest(self, channel: StudyChannel) -> Revision | None:
        """The newest revision of a channel's data, whatever its base model unless one was asked for."""
        if self._model is not None:
            return self.latest(channel)
        same = (channel.name, channel.sha256)
        kept = (one for one in reversed(self.revisions) if (one.channel, one.data_sha256) == same)
        return next(kept, None)

    def revision(self, number: int) -> Revision:
        """A revision by its number.

        Raises:
            InputError: there is none, or it has an effect of the user's own that this study was not given.
        """
        found = self._revisions.get(number)
        self._check_own(found)
        return found

    def channel_of(self, revision: Revision) -> StudyChannel:
        """The channel that a revision is of, with its base model.

        Raises:
            InputError: it is not there.
        """
        data = next((one for one in self.source.channels if one.name == revision.channel), None)
        if data is None:
            raise InputError(
                f"revision {revision.number} is of channel '{revision.channel}', which is not there"
            )
        return self._channel(data, revision.model)

    def is_of_this_data(self, revision: Revision) -> bool:
        """Whether a revision was fitted to the very data of this study."""
        return any(
            one.sha256 == revision.data_sha256 for one in self.channels if one.name == revision.channel
        )

    def check(self, revision: Revision) -> None:
        """Refuse a revision of other data.

        Raises:
            InputError: it is, or its channel is not there.
        """
        if self.channel_of(revision).sha256 != revision.data_sha256:
            raise InputError(
                f"revision {revision.number} is of other data (SHA-256 {revision.data_sha256[:12]}...). Give "
                "the options that it was made with (--where, --unit, --urdf), add to this data first "
                "(palpate diagnose --apply, palpate add --fresh), or name another folder"
            )

    def with_model(self, channel: StudyChannel, model: str) -> StudyChannel:
        """The same channel with another base model.

        Raises:
            InputError: the model is unknown, or lacks something.
        """
        return self._channel(next(one for one in self.source.channels if one.name == channel.name), model)

    def _repr_html_(self) -> str:
        rows = [
            (one.name, one.model.name, len(one.data.runs), len(one.data), one.sha256[:12])
            for one in self.channels
        ]
        return html_table(self.source.name, ("channel", "base model", "runs", "samples", "SHA-256"), rows)

    @property
    def _file(self) -> str:
        return str(self.source.path or self.source.name)

    def _channel(self, data: ChannelData, model: str | None) -> StudyChannel:
        name = model or usual_model(data, self.source.arm)
        if (data.name, name) not in self._channels:
            self._channels[data.name, name] = channel_of(data, name, self.source.arm)
        return self._channels[data.name, name]

    def _fit(self, one: StudyChannel, effects: list[str]) -> Fitted:
        if not effects:
            return engine.fit(one.data, one.model)
        parent, effect = self.fit(one, effects[:-1]), self._effect(effects[-1])
        if why := unapplicable(effect, parent.data):
            raise InputError(why)
        return engine.fit(one.data, parent.model.with_effect(effect.suited_to(parent.data)), parent)

    def _effect(self, name: str) -> Effect:
        if name not in self._library:
            raise InputError(EFFECTS.unknown(name))
        return self._library[name]

    def _check_own(self, revision: Revision) -> None:
        """A revision names the user's effects, but their code is run only when the user says so now."""
        for place in revision.user_effects:
            if place not in self._own.values():
                raise InputError(
                    f"revision {revision.number} has an effect of your own: add --effect {place}"
                )

    def _newest_result(self, channel: StudyChannel) -> ChannelResult:
        newest, found = self.latest(channel), self.known_diagnosis(channel)
        if newest is None:
            return self.result(channel, (), found)
        try:
            self._check_own(newest)
        except InputError as error:
            left_out = f"{channel.name} is shown without what was added to it: {error}"
            return self.result(channel, (), found, left_out)
        return self.result(channel, newest.effects, found)

    def _current(self, one: StudyChannel) -> StudyChannel:
        newest = self.newest(one)
        return one if newest is None else self.channel_of(newest)

    def _suited(self, effects: Sequence[Effect], name: str | None, *, fresh: bool) -> StudyChannel:
        """The one channel in which these effects can be; the contact, where they can be there too."""
        chosen = self.chosen(name)
        begun = chosen if fresh else tuple(map(self._current, chosen))
        fitting = [one for one in begun if not any(unapplicable(e, self._loaded(one)) for e in effects)]
        names = " and ".join(effect.name for effect in effects)
        if not fitting:
            there = ", ".join(f"{one.name} ({one.data.kind})" for one in begun)
            raise InputError(f"{names} can be in none of the channels: {there}")
        contacts = [one for one in fitting if one.data.kind is ChannelKind.CONTACT]
        if len(fitting) > 1 and len(contacts) != 1:
            there = ", ".join(one.name for one in fitting)
            raise InputError(f"{names} can be in {there}: choose one with --channel")
        return (contacts or fitting)[0]

    def _loaded(self, one: StudyChannel) -> ChannelData:
        """The channel with the signals that a fit derives, such as the load of a joint."""
        try:
            return self.fit(one).data
        except InputError:  # it cannot be judged, which the user is told where it is chosen
            return one.data

    def _keep(
        self, one: StudyChannel, effects: Sequence[str], parent: Revision | None
    ) -> tuple[Revision, ...]:
        """Keep each stage after the parent, or after the base model that is kept already."""
        bases = (r for r in self.revisions if _about_revision(r) == _about(one) and not r.effects)
        before = parent or next(bases, None)
        self.fit(one, effects)  # nothing is kept of what cannot be added
        kept: list[Revision] = []
        for count in range(0 if before is None else len(before.effects) + 1, len(effects) + 1):
            kept.append(self._kept(one, effects[:count], kept[-1] if kept else before))
        return tuple(kept)

    def _kept(
        self, one: StudyChannel, effects: Sequence[str], parent: Revision | None, *, removed: str = ""
    ) -> Revision:
        fitted, made = self.fit(one, effects), self._now().isoformat(timespec="seconds")
        parameters = {
            name: KeptParameter(
                value=p.value, std_err=p.std_err if math.isfinite(p.std_err) else None, unit=p.unit
            )
            for name, p in fitted.parameters.items()
        }
        return self._revisions.keep(
            lambda number: Revision(
                number=number,
                parent=None if parent is None else parent.number,
                channel=one.name,
                model=one.model.name,
                added="" if removed else "".join(effects[-1:]),
                removed=removed,
                effects=list(effects),
                user_effects=[self._own[name] for name in effects if name in self._own],
                effort_unit=one.effort_unit,
                rmse=fitted.rmse,
                noise_floor=self.noise_floor(one),
                parameters=parameters,
                data_sha256=one.sha256,
                created_utc=made,
                software_version=version("palpate"),
            )
        )


def _about(channel: StudyChannel) -> tuple[str, str, str]:
    return channel.name, channel.model.name, channel.sha256


def _about_revision(revision: Revision) -> tuple[str, str, str]:
    return revision.channel, revision.model, revision.data_sha256


def _key(channel: StudyChannel, effects: Sequence[str]) -> _Key:
    return *_about(channel), tuple(effects)
