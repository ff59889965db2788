"""One study: data, models, revisions and results, in which each number is computed once."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from estimation.channel import ChannelData, ChannelKind
from estimation.data.import_options import ImportOptions
from estimation.data_quality import quality_warnings, reject_reason
from estimation.diagnosis import ChannelDiagnosis
from estimation.effect import Effect
from estimation.effects.run_variation import RunVariation
from estimation.study import engine
from estimation.study.channels import StudyChannel, model_to_estimate, suited_names, unapplicable
from estimation.study.estimates import ALL, ChannelEstimates, choose_estimators, estimate_with, only_runs
from estimation.study.fits import About, Fits, about
from estimation.study.kept_diagnosis import diagnosis_data, read_diagnosis
from estimation.study.reconcile import reconcile
from estimation.study.results import Change, ChannelResult, RevisionTable, Stage, StudyDiagnosis
from estimation.study.revisions import KeptParameter, Revision, Revisions
from estimation.study.source import NO_OPTIONS, Arm, of_bearable_length, open_source
from robot_io.errors import InputError


class Study(Fits):
    """Models of one measurement, compared, diagnosed, extended and gone back to.

    A model is fitted once for each combination of data, base model and added effects. What `compare` shows of
    the base model, revision 0, and the baseline of a diagnosis are that one fit. The noise floor of a channel
    is one number too, see `noise_floor`. It may be used from several threads.

    Args:
        data: see `estimation.study.source.open_source`.
        model: base model; None for what suits each channel.
        options: how to read a file or table.
        arm: what the channels belong to, where the data does not say.
        effects: of the user's own, by the name under which to load them again, such as "my_effects.py:Mine".
        folder: where revisions and the diagnosis are kept; None to keep them in memory.
        held_out: see `Fits`.
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
        held_out: Sequence[int] = (),
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        own = effects or {}
        source = of_bearable_length(open_source(data, options, arm), held_out)
        super().__init__(source, model, list(own.values()), held_out)
        self.folder = folder
        self._own = {effect.name: place for place, effect in own.items()}
        self._revisions = Revisions(folder)
        self._now = now
        self._diagnoses: dict[About, ChannelDiagnosis] = {}

    @property
    def own_effects(self) -> tuple[Effect, ...]:
        """Those of the user's own."""
        return tuple(self._library[name] for name in self._own)

    @property
    def revisions(self) -> RevisionTable:
        """All stages that were ever kept, oldest first.

        Raises:
            InputError: a file in the folder is not a revision.
        """
        return RevisionTable(self._revisions.all())

    def diagnose(
        self,
        channel: str | None = None,
        *,
        apply: bool = False,
        progress: engine.Progress = lambda what, share: None,
        judge: engine.Judge = engine.diagnose,
    ) -> StudyDiagnosis:
        """Say whether anything is missing in the base models, and which effect it is.

        Args:
            channel: only this one; None for all.
            apply: add what is missing, as revisions.
            progress: called with what is being done, and which share of that is done.
            judge: does the work, such as in another process.

        Raises:
            InputError: there is no such channel.
        """
        chosen = self.chosen(channel)
        unknown = [one for one in chosen if about(one) not in self._diagnoses]
        if unknown:
            data, models = [one.to_fit for one in chosen], [one.model for one in chosen]
            # Stretches of one recording are no runs, each of which might have met another zero or gain.
            of_runs = RunVariation if self.source.stretches else ()
            effects = [one for one in self.effects if not isinstance(one, of_runs)]
            judged = judge(data, models, effects, progress, self._file)
            found = [reconcile(self, *pair) for pair in zip(chosen, judged.channels, strict=True)]
            said, warnings = self.source.averaged, self.warnings
            found = [
                one.model_copy(
                    update={
                        "averaged": said.get(one.channel, ""),
                        "warnings": list(warnings.get(one.channel, ())),
                    }
                )
                for one in found
            ]
            with self._lock:
                self._diagnoses |= dict(zip(map(about, chosen), found, strict=True))
        answers = [self._diagnoses[about(one)] for one in chosen]
        for one, answer in zip(chosen, answers, strict=True):
            if apply and answer.accepted:
                self._keep(one, [entry.effect for entry in answer.accepted], None)
        names = "+".join(dict.fromkeys(one.model.name for one in chosen))
        return StudyDiagnosis(file=self._file, model=names, channels=answers)

    def refusal(self, channel: StudyChannel) -> str:
        """Why a channel cannot be judged; empty where it can."""
        return reject_reason(channel.to_fit, channel.model) or ""

    @property
    def warnings(self) -> dict[str, list[str]]:
        """What is implausible in the data, in sentences with figures, by channel; none where nothing is."""
        found = {one.name: quality_warnings(one.measured, one.model) for one in self.channels}
        return {name: sentences for name, sentences in found.items() if sentences}

    def noise_floor(self, channel: StudyChannel | str, *reached: float) -> float:
        """The error that a complete model would leave: one number for a channel, in the unit of the effort.

        What a diagnosis found, which is the error of the final model where that is complete; before there is
        one, or where runs are held out by choice, an estimate beside the base model, or the least error of
        models that stand beside it, where one of these reaches less.

        Args:
            channel: or its name.
            reached: errors of those models.

        Raises:
            InputError: the channel cannot be judged.
        """
        one = self.channel(channel) if isinstance(channel, str) else channel
        found = self.known_diagnosis(one)
        if found is not None and found.noise_floor is not None and not one.held_out:
            return min([found.noise_floor, *reached])
        return super().noise_floor(one, *reached)

    def diagnosis_data(self, diagnosis: StudyDiagnosis) -> dict[str, Any]:
        """A diagnosis as plain data, with what it is about; the keys are stable."""
        return diagnosis_data(diagnosis, self.channels)

    def known_diagnosis(self, channel: StudyChannel) -> ChannelDiagnosis | None:
        """What was found in this data and base model, in this study or earlier; None if nobody asked.

        Raises:
            InputError: the file in the folder is damaged.
        """
        key = about(channel)
        return self._diagnoses.get(key) or read_diagnosis(self.folder).get(key)

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
        if not (effects and all(isinstance(name, str) for name in effects)):
            raise InputError(
                f"add({', '.join(map(repr, effects))}): give names of effects, such as add('dry_friction')"
            )
        chosen = [self._effect(name) for name in effects]
        with self._lock:
            if start is None:
                one = self._suited(chosen, channel, fresh=fresh)
                parent = None if fresh else self.latest(one)
            else:
                parent = self._revisions.get(start)
                given = {"--fresh": fresh, "--model": self.model, "--channel": channel}
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
            InputError: that effect was added to no channel's newest model, or to those of several.
        """
        with self._lock:
            newest = [kept for one in self.chosen(channel) if (kept := self.newest(one)) is not None]
            having = [kept for kept in newest if effect in kept.effects]
            if not having:
                raise InputError(f"remove {effect!r}: was not added to any model. {_added_to(newest)}")
            if len(having) > 1:
                there = ", ".join(kept.channel for kept in having)
                raise InputError(f"remove {effect!r}: was added to {there}; choose one with --channel")
            (parent,) = having
            self._check_own(parent)
            one, left = self.channel_of(parent), [name for name in parent.effects if name != effect]
            revision = self._kept(one, left, parent, removed=effect)
            return Change(self.result(one, left, self.known_diagnosis(one)), (revision,), parent)

    def estimate(
        self,
        estimators: str | Sequence[str] = ALL,
        channel: str | None = None,
        runs: Sequence[int] | None = None,
    ) -> tuple[ChannelEstimates, ...]:
        """Parameters by every method, with 95 % intervals; the force in free air is taken off a probing's.

        Args:
            estimators: "all", names with commas between them, or a list of names.
            channel: only this one; None for contacts, or joints where there is no contact.
            runs: only these; None for all.

        Raises:
            InputError: a name or run is unknown, or no estimator can work.
        """
        names, models = choose_estimators(estimators), model_to_estimate(self.source, self.model)
        wanted: Sequence[ChannelData] = [
            one for one in self.source.tared() if one.name in models and channel in {None, one.name}
        ]
        if self.held_out:
            wanted = replace(self.source, channels=tuple(wanted)).without(self.held_out).channels
        if not wanted:
            raise InputError(f"no channel '{channel}' to estimate. There are: {', '.join(models)}")
        chosen = [one if runs is None else only_runs(one, runs, self.source) for one in wanted]
        return tuple(estimate_with(one, models[one.name], names, self.source.arm) for one in chosen)

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
        same = [kept for kept in self.revisions if _about_revision(kept) == about(channel)]
        numbers = {tuple(kept.effects): kept.number for kept in same}
        chains = [tuple(effects[:count]) for count in range(len(effects) + 1)]
        stages = [Stage(self.fit(channel, one), "".join(one[-1:]), numbers.get(one)) for one in chains]
        grown = self.comparison(channel, effects) if effects else None
        floor = self.noise_floor(channel, *(stage.fitted.rmse for stage in stages))
        return ChannelResult(channel, diagnosis, base, tuple(stages), grown, floor, reason)

    def latest(self, channel: StudyChannel) -> Revision | None:
        """The newest revision of this channel, data and base model."""
        same = (one for one in reversed(self.revisions) if _about_revision(one) == about(channel))
        return next(same, None)

    def newest(self, channel: StudyChannel) -> Revision | None:
        """The newest revision of a channel's data, whatever its base model unless one was asked for."""
        if self.model is not None:
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
        """The channel that a revision is of, with its base model. InputError: it is not there."""
        return self.with_model(revision.channel, revision.model)

    def check(self, revision: Revision) -> None:
        """Refuse a revision of other data. InputError: it is, or its channel is not there."""
        if self.channel_of(revision).sha256 != revision.data_sha256:
            raise InputError(
                f"revision {revision.number} is of other data (SHA-256 {revision.data_sha256[:12]}...). Give "
                "the options that it was made with (--where, --unit, --urdf), add to this data first "
                "(palpate diagnose --apply, palpate add --fresh), or name another folder"
            )

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
            there = ", ".join(f"{one.name} ({one.kind})" for one in begun)
            known = suited_names(effects[0].name, self.effects, [one.data for one in begun])
            raise InputError(f"{names} can be in none of the channels: {there}. {known}")
        contacts = [one for one in fitting if one.kind is ChannelKind.CONTACT]
        if len(fitting) > 1 and len(contacts) != 1:
            there = ", ".join(one.name for one in fitting)
            raise InputError(f"{names} can be in {there}: choose one with --channel")
        return (contacts or fitting)[0]

    def _keep(
        self, one: StudyChannel, effects: Sequence[str], parent: Revision | None
    ) -> tuple[Revision, ...]:
        """Keep each stage after the parent, or after the base model that is kept already."""
        bases = (r for r in self.revisions if _about_revision(r) == about(one) and not r.effects)
        before = parent or next(bases, None)
        self.fit(one, effects)  # nothing is kept of what cannot be added
        kept: list[Revision] = []
        try:
            for count in range(0 if before is None else len(before.effects) + 1, len(effects) + 1):
                kept.append(self._kept(one, effects[:count], kept[-1] if kept else before))
        except BaseException:  # a full disk, or Ctrl-C: all stages or none
            self._revisions.drop(kept)
            raise
        return tuple(kept)

    def _kept(
        self, one: StudyChannel, effects: Sequence[str], parent: Revision | None, *, removed: str = ""
    ) -> Revision:
        fitted, made = self.fit(one, effects), self._now().isoformat(timespec="seconds")
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
                parameters={name: KeptParameter.of(one) for name, one in fitted.parameters.items()},
                data_sha256=one.sha256,
                created_utc=made,
                software_version=version("palpate"),
            )
        )


def _added_to(newest: Sequence[Revision]) -> str:
    added = (f"{one.channel} has {', '.join(one.effects)}" for one in newest if one.effects)
    return "; ".join(added) or "Nothing was added yet"


def _about_revision(revision: Revision) -> About:
    return revision.channel, revision.model, revision.data_sha256
