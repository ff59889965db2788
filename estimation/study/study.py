"""A study: data, models, revisions and results of one measurement, each computed once."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from palpate.estimation.base_model import Arm
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.import_options import NO_OPTIONS, ImportOptions
from palpate.estimation.design.next_experiment import LONGEST_S, NextProbe
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.agreement import with_cautions
from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.effect import Effect
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.estimate import DisplayTable, TableTuple
from palpate.estimation.study import fitting
from palpate.estimation.study.channels import (
    ChannelKey,
    StudyChannel,
    inapplicable_reason,
    model_to_estimate,
    suited_names,
)
from palpate.estimation.study.estimates import (
    DEFAULT_ESTIMATORS,
    ChannelEstimates,
    choose_estimators,
    estimate_with,
    only_runs,
)
from palpate.estimation.study.fits import StudyFits
from palpate.estimation.study.other_models import drop_inseparable, is_undecided, state_inseparable
from palpate.estimation.study.results import (
    ChannelResult,
    ModelStage,
    RevisionChange,
    RevisionTable,
    StudyDiagnosis,
)
from palpate.estimation.study.revisions import Revision, Revisions, SavedParameter
from palpate.estimation.study.saved_diagnosis import (
    IDENTITY,
    RESULT,
    differs_from_fit,
    read_saved_diagnoses,
    with_checksum,
    with_saved_channels,
)
from palpate.estimation.workers import release_freed_memory
from palpate.robot_io.errors import InputError

# Longest duration of the experiment, and the parts of the diagnoses on which a plan depends.
_ProbeKey = tuple[float, tuple[tuple[ChannelKey, Verdict, tuple[str, ...]], ...]]


class ModelStudy(StudyFits):
    """Study of one measurement: fit, compare, diagnose and extend models, with revisions.

    A model is fitted once for each combination of data, base model and added effects, and all methods share
    this fit. The noise of a channel is also estimated only once, see `noise`. Methods may be called from
    several threads.

    Args:
        data: see `palpate.estimation.study.source.open_source`.
        model: name of the base model; None for the usual one of each channel.
        options: options for reading a file or table.
        arm: the arm to which the channels belong; None to use the arm of the data.
        effects: user-defined effects by the name under which they can be loaded, such as
            "my_effects.py:Mine".
        folder: folder in which revisions and the diagnosis are saved; None to keep them in memory.
        held_out: runs excluded from fitting and used only for scoring; empty for cross-validation.
        now: clock for the creation time of revisions.

    Raises:
        InputError: the data cannot be used, the model is unknown or does not apply, or no run is left.
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
        super().__init__(data, model, options=options, arm=arm, effects=effects, held_out=held_out)
        self.folder = folder
        self._revisions = Revisions(folder)
        self._now = now
        self._probes: dict[_ProbeKey, NextProbe | None] = {}
        self._diagnoses: dict[ChannelKey, ChannelDiagnosis] = {}

    def diagnose(
        self,
        channel: str | None = None,
        *,
        apply: bool = False,
        plan: bool = True,
        progress: fitting.Progress = lambda what, share: None,
        judge: fitting.Judge = fitting.diagnose,
    ) -> StudyDiagnosis:
        """Diagnose which effects the base models lack.

        Args:
            channel: name of one channel; None for all.
            apply: whether to add the missing effects as revisions.
            plan: whether to plan the next experiment for the arm of the recording, if it is known.
            progress: callback that receives the current step and its completed share, from 0 to 1.
            judge: function that computes the diagnosis, for example in another process.

        Raises:
            InputError: there is no such channel.
        """
        chosen = self.chosen(channel)
        if any(member.key not in self._diagnoses for member in chosen):
            data, models = [member.to_fit for member in chosen], [member.model for member in chosen]
            # Stretches of one recording cannot differ in zero or gain as separate runs can.
            excluded = RunVariation if self.source.stretches else ()
            effects = [effect for effect in self.effects if not isinstance(effect, excluded)]
            judged = judge(data, models, effects, progress, self._file)
            if self.source.averaged:
                release_freed_memory()
            for member, entry in zip(chosen, judged.channels, strict=True):
                noise = entry.take_noise()
                if noise is not None and not member.held_out:  # otherwise other runs are scored
                    self._noise.setdefault(member.key, noise)
                for added, packed in entry.take_fits().items():
                    self.take_fit(member, added, packed)
            entries = judged.channels
            probe = self.next_probe(entries, progress=progress) if plan else None
            entries = with_cautions(self.settle(entries, probe) if plan else entries)
            averaged, warnings = self.source.averaged, self.warnings
            with self._lock:
                for member, entry in zip(chosen, entries, strict=True):
                    about = {
                        "averaged": averaged.get(member.name, ""),
                        "recovers": bool(member.data.recovers),
                        "recovery_ratio": member.data.recovery_ratio,
                        "warnings": [*member.measured.import_warnings, *warnings.get(member.name, ())],
                    }
                    self._diagnoses[member.key] = entry.model_copy(update=about)
        entries = [self._diagnoses[member.key] for member in chosen]
        for member, entry in zip(chosen, entries, strict=True):
            if apply and entry.accepted:
                self._save_stages(member, [accepted.effect for accepted in entry.accepted], None)
        names = "+".join(dict.fromkeys(member.model.name for member in chosen))
        return StudyDiagnosis(file=self._file, model=names, channels=entries)

    def settle(
        self, diagnosed: Sequence[ChannelDiagnosis], probe: NextProbe | None
    ) -> list[ChannelDiagnosis]:
        """Add to each channel its next experiment, or a note that none should separate its explanations.

        Args:
            diagnosed: diagnoses of channels of this study.
            probe: the next probe of the arm; None if none helps, or without an arm.
        """
        settled = []
        can_plan = any(map(is_undecided, diagnosed)) and self._can_plan()
        for entry in diagnosed:
            channel = self.channel(entry.channel)
            is_inseparable = probe is None if can_plan else bool(entry.no_experiment)
            if probe is not None and entry.channel in probe.channels:
                planned = {"next_experiment": probe.proposal, "no_experiment": ""}
                settled.append(entry.model_copy(update=planned))
                if probe.separated is not None:
                    settled[-1] = drop_inseparable(self, channel, settled[-1], probe.separated)
            elif is_undecided(entry) and is_inseparable:
                settled.append(state_inseparable(self, channel, entry, is_arm=can_plan))
            elif not can_plan and any(accepted.confused_with for accepted in entry.accepted):
                settled.append(drop_inseparable(self, channel, entry))
            else:
                settled.append(entry)
        return settled

    def next_probe(
        self,
        diagnosed: Sequence[ChannelDiagnosis],
        longest_s: float = LONGEST_S,
        progress: fitting.Progress = lambda what, share: None,
    ) -> NextProbe | None:
        """Plan the experiment that best separates the undecided models; None if none can, or without an arm.

        `diagnose` adds the plan to its result. Plans are cached by verdicts and effects.

        Args:
            diagnosed: diagnoses of channels of this study.
            longest_s: longest duration of the experiment [s].
            progress: callback that receives the current step and its completed share, from 0 to 1.

        Raises:
            InputError: the robot file or plan stored in the session is not valid.
        """
        known = (
            (self.channel(entry.channel).key, entry.verdict, tuple(each.effect for each in entry.accepted))
            for entry in diagnosed
        )
        key = longest_s, tuple(known)
        if key not in self._probes:
            self._probes[key] = self._plan_probe(diagnosed, longest_s, progress)
        return self._probes[key]

    def _plan_probe(
        self, diagnosed: Sequence[ChannelDiagnosis], longest_s: float, progress: fitting.Progress
    ) -> NextProbe | None:
        """Plan an experiment for the arm of the recording; here no arm is known."""
        return None

    def _can_plan(self) -> bool:
        """Return whether probes can be planned for the arm of the recording; here no arm is known."""
        return False

    def diagnosis_data(self, diagnosis: StudyDiagnosis) -> dict[str, Any]:
        """Return a diagnosis as plain data with the identity of data and models; the keys are stable.

        Args:
            diagnosis: diagnosis of channels of this study.
        """
        identities = {c.name: {"model": c.model.name, "data_sha256": c.sha256} for c in self.channels}
        return with_checksum(diagnosis.model_dump(mode="json") | {IDENTITY: identities})

    def diagnosis_to_save(self, diagnosis: StudyDiagnosis) -> dict[str, Any]:
        """Return the content of the file of a diagnosis, with the saved verdicts on other channels.

        Args:
            diagnosis: diagnosis of channels of this study.

        Raises:
            InputError: the saved file is damaged.
        """
        return with_saved_channels(self.diagnosis_data(diagnosis), self.folder)

    def known_diagnosis(self, channel: StudyChannel) -> ChannelDiagnosis | None:
        """Return the computed or saved diagnosis of these data and base model; None if there is none.

        Args:
            channel: the channel with its base model.

        Raises:
            InputError: the saved file is damaged, or its numbers differ from this study's fits.
        """
        made = self._diagnoses.get(channel.key)
        all_saved = {} if made else read_saved_diagnoses(self.folder)
        saved = all_saved.get(channel.saved_key) if all_saved else None
        if saved is None or saved.baseline is None or channel.held_out:  # their scores are not comparable
            return made or saved
        with self._lock:
            final = saved.final or saved.baseline
            noise = self.noise(channel).below(final.rmse).value
            names = [entry.effect for entry in saved.accepted]
            if saved.noise_floor is not None and differs_from_fit(saved.noise_floor, noise):
                why = f"its noise is {saved.noise_floor:.4g}, but these data give {noise:.4g}"
            else:
                why = self._difference_from_fit(channel, [], saved.baseline.rmse, saved.baseline.parameters)
            if not why and saved.final is not None:
                why = self._difference_from_fit(channel, names, saved.final.rmse, saved.final.parameters)
        if why:
            raise InputError(
                f"{self.folder}/{RESULT}: channel {channel.name}: {why}; the file was changed, or another "
                "version made it; delete the file, or run palpate diagnose again"
            )
        return saved

    def estimate(
        self,
        estimators: str | Sequence[str] = DEFAULT_ESTIMATORS,
        channel: str | None = None,
        runs: Sequence[int] | None = None,
    ) -> tuple[ChannelEstimates, ...]:
        """Estimate parameters with several methods, with 95 % intervals.

        The force of a probing session is tared: its value in free air is subtracted.

        Args:
            estimators: names separated by commas, a list of names, or "all".
            channel: name of one channel; None for all contacts, or for all joints without a contact.
            runs: numbers of the runs to use; None for all.

        Raises:
            InputError: a name or run is unknown, or all estimators fail.
        """
        names, models = choose_estimators(estimators), model_to_estimate(self.source, self.model)
        selected = [name for name in models if channel in {None, name}]
        data: Sequence[ChannelData] = self.source.tared(selected)
        if self.source.averaged:
            release_freed_memory()
        if self.held_out:
            data = replace(self.source, channels=tuple(data)).without(self.held_out).channels
        if not data:
            raise InputError(f"no channel '{channel}' to estimate. Available: {', '.join(models)}")
        if runs is not None:
            data = [only_runs(channel_data, runs, self.source) for channel_data in data]
        estimates = []
        for channel_data in data:
            try:
                noise = self.noise(channel_data.name)
            except InputError:  # the channel cannot be fitted
                noise = None
            made = estimate_with(channel_data, models[channel_data.name], names, self.source.arm)
            estimates.append(replace(made, noise=noise))
        return TableTuple(estimates)

    def add(
        self, *effects: str, channel: str | None = None, start: int | None = None, fresh: bool = False
    ) -> RevisionChange:
        """Add effects one by one, refit all parameters at each stage, and save each stage as a revision.

        Args:
            effects: names of the effects, in order.
            channel: name of the channel; None for the one in which the diagnosis named the effects, or to
                which they apply.
            start: number of the revision to continue; None for the channel's newest revision of these data.
            fresh: whether to start from the base model.

        Raises:
            InputError: a name is unknown, an effect is already present or does not apply, or arguments
                contradict each other.
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
                if fresh:
                    raise InputError(f"--fresh and --from {start}: give only one of them")
                given = {"--model": self.model, "--channel": channel}
                if extra := [option for option, value in given.items() if value]:
                    raise InputError(
                        f"leave out {extra[0]}: revision {start} (--from) states the channel and the model"
                    )
                base = self.channel_of(parent)
                self.check(parent)
            before = [] if parent is None else parent.effects
            if parent is not None:
                self._check_user_effects(parent)
                if repeated := [name for name in effects if name in before]:
                    raise InputError(
                        f"revision {parent.number} already contains {', '.join(repeated)}: continue from "
                        "another revision with --from (palpate revisions lists them), or start again with "
                        "--fresh"
                    )
            added = [*before, *effects]
            new = self._save_stages(base, added, parent)
            return RevisionChange(self.result(base, added, self.known_diagnosis(base)), new, parent)

    def remove(self, effect: str, channel: str | None = None) -> RevisionChange:
        """Remove an effect from the newest model of a channel, and save the result as a new revision.

        Args:
            effect: name of the effect.
            channel: name of the channel; None for the channel whose newest model has the effect.

        Raises:
            InputError: no channel's newest model has the effect, or several have it.
        """
        with self._lock:
            newest = [kept for member in self.chosen(channel) if (kept := self.newest(member)) is not None]
            having = [revision for revision in newest if effect in revision.effects]
            if not having:
                added = (f"{kept.channel} has {', '.join(kept.effects)}" for kept in newest if kept.effects)
                known = "; ".join(added) or "they have no added effects"
                raise InputError(f"remove {effect!r}: the newest models do not have this effect; {known}")
            if len(having) > 1:
                listed = ", ".join(revision.channel for revision in having)
                raise InputError(f"remove {effect!r}: {listed} have this effect; choose one with --channel")
            (parent,) = having
            self._check_user_effects(parent)
            base, remaining = self.channel_of(parent), [name for name in parent.effects if name != effect]
            revision = self._save_stage(base, remaining, parent, removed=effect)
            return RevisionChange(
                self.result(base, remaining, self.known_diagnosis(base)), (revision,), parent
            )

    @property
    def revisions(self) -> RevisionTable:
        """All revisions, oldest first.

        Raises:
            InputError: a file in the folder is not a revision.
        """
        return RevisionTable(self._revisions.all())

    def latest(self, channel: StudyChannel) -> Revision | None:
        """Return the newest revision of a channel's data and base model; None without one.

        Args:
            channel: the channel with its base model.
        """
        return next(reversed(self._revisions_of(channel)), None)

    def newest(self, channel: StudyChannel) -> Revision | None:
        """Return the newest revision of a channel's data, of any base model unless the study names one.

        Args:
            channel: the channel.
        """
        if self.model is not None:
            return self.latest(channel)
        identity = channel.name, channel.sha256
        newest_first = reversed(self.revisions)
        return next((each for each in newest_first if (each.channel, each.data_sha256) == identity), None)

    def revision(self, number: int) -> Revision:
        """Return a revision by its number.

        Args:
            number: number of the revision.

        Raises:
            InputError: there is none, or it has a user-defined effect that this study does not know.
        """
        revision = self._revisions.get(number)
        self._check_user_effects(revision)
        return revision

    def channel_of(self, revision: Revision) -> StudyChannel:
        """Return the channel of a revision, with its base model.

        Args:
            revision: revision of this study's folder.

        Raises:
            InputError: the study has no such channel.
        """
        return self.with_model(revision.channel, revision.model)

    def check(self, revision: Revision) -> None:
        """Check that a revision belongs to these data and agrees with this study's fit.

        Args:
            revision: revision of this study's folder.

        Raises:
            InputError: data or numbers differ, or the study has no such channel.
        """
        channel = self.channel_of(revision)
        if channel.sha256 != revision.data_sha256:
            raise InputError(
                f"revision {revision.number} is from other data (SHA-256 {revision.data_sha256[:12]}...). "
                "Give the options that it was made with (--where, --unit, --urdf, --fresh-runs), make a "
                "revision for these data (palpate diagnose --apply, palpate add --fresh), or name another "
                "folder"
            )
        if why := self._difference_from_fit(channel, revision.effects, revision.rmse, revision.parameters):
            raise InputError(
                f"revision {revision.number}: {why}; the revision was changed, or made by another version "
                f"({revision.software_version}); add its effects again (palpate add --fresh)"
            )

    def results(self) -> tuple[ChannelResult, ...]:
        """Return all results of each channel, with its newest revision of these data.

        Raises:
            InputError: a file in the folder is damaged.
        """
        return TableTuple(self._newest_result(self._current(member)) for member in self.channels)

    def result(
        self,
        channel: StudyChannel,
        effects: Sequence[str] = (),
        diagnosis: ChannelDiagnosis | None = None,
        reason: str = "",
    ) -> ChannelResult:
        """Return the result of a channel: base model, stages of added effects, comparisons and noise.

        Args:
            channel: the channel with its base model.
            effects: names of the added effects, in order.
            diagnosis: the diagnosis of the base model; None without one.
            reason: why added effects are not shown.

        Raises:
            InputError: an effect is unknown, already present, or does not apply.
        """
        try:
            base = self.comparison(channel)
        except InputError as error:
            return ChannelResult(channel, diagnosis, reason=str(error))
        numbers = {tuple(each.effects): each.number for each in self._revisions_of(channel)}
        chains = [tuple(effects[:count]) for count in range(len(effects) + 1)]
        stages = [
            ModelStage(self.fit(channel, chain), "".join(chain[-1:]), numbers.get(chain)) for chain in chains
        ]
        extended_comparison = self.comparison(channel, effects) if effects else None
        return ChannelResult(channel, diagnosis, base, tuple(stages), extended_comparison, reason)

    def _revisions_of(self, channel: StudyChannel) -> list[Revision]:
        """Return the revisions of a channel's data and base model, oldest first."""
        return [revision for revision in self.revisions if revision.key == channel.saved_key]

    def _table(self) -> DisplayTable:
        rows = [
            (member.name, member.model.name, len(member.data.runs), len(member.data), member.sha256[:12])
            for member in self.channels
        ]
        return DisplayTable(self.source.name, ("channel", "base model", "runs", "samples", "SHA-256"), rows)

    def _suited_channel(self, effects: Sequence[Effect], name: str | None, *, fresh: bool) -> StudyChannel:
        """Return the channel to which these effects apply.

        The only channel in which the diagnosis named them comes first, then a contact.
        """
        chosen = self.chosen(name)
        current = chosen if fresh else tuple(map(self._current, chosen))
        fitting_channels = []
        for base in current:
            data = base.data
            with suppress(InputError):  # the channel cannot be fitted, which is reported when it is selected
                data = self.fit(base).data  # includes signals derived in the fit, such as a joint's load
            if not (unsuited := [effect for effect in effects if inapplicable_reason(effect, data)]):
                fitting_channels.append(base)
        names = " and ".join(effect.name for effect in effects)
        if not fitting_channels:
            listed = ", ".join(
                base.name if base.name == base.kind else f"{base.name} ({base.kind})" for base in current
            )
            known = suited_names(unsuited[0].name, self.effects, [base.data for base in current])
            is_of_kind = any(base.kind in unsuited[0].channels for base in current)
            why = f", because {unsuited[0].name} cannot be identified from these data" if is_of_kind else ""
            verb = "do" if len(effects) > 1 else "does"
            raise InputError(f"{names} {verb} not apply to any channel ({listed}){why}. {known}")
        diagnoses = [(base, self.known_diagnosis(base)) for base in fitting_channels]
        named = [
            base
            for base, found in diagnoses
            if found and {effect.name for effect in effects} <= {entry.effect for entry in found.accepted}
        ]
        if len(named) == 1:
            return named[0]
        contacts = [base for base in fitting_channels if base.kind is ChannelKind.CONTACT]
        if len(fitting_channels) > 1 and len(contacts) != 1:
            listed = ", ".join(base.name for base in fitting_channels)
            raise InputError(f"{names} can be added to {listed}; choose one with --channel")
        return (contacts or fitting_channels)[0]

    def _newest_result(self, channel: StudyChannel) -> ChannelResult:
        newest, diagnosis = self.latest(channel), self.known_diagnosis(channel)
        if newest is None:
            return self.result(channel, (), diagnosis)
        try:
            self._check_user_effects(newest)
        except InputError as error:
            left_out = f"{channel.name} is shown without its added effects: {error}"
            return self.result(channel, (), diagnosis, left_out)
        return self.result(channel, newest.effects, diagnosis)

    def _current(self, channel: StudyChannel) -> StudyChannel:
        """Return the channel with the base model of its newest revision, or else of its saved diagnosis."""
        newest = self.newest(channel)
        if newest is not None:
            return self.channel_of(newest)
        saved = () if self.model is not None else read_saved_diagnoses(self.folder)
        models = [model for name, model, data in saved if (name, data) == (channel.name, channel.sha256)]
        return self.with_model(channel.name, models[0]) if models else channel

    def _check_user_effects(self, revision: Revision) -> None:
        """Raise InputError for a revision with a user-defined effect whose code is missing."""
        for place in revision.user_effects:
            if place not in self._user_places.values():
                raise InputError(
                    f"revision {revision.number} uses an effect of your own: add --effect {place}"
                )

    def _difference_from_fit(
        self,
        channel: StudyChannel,
        effects: Sequence[str],
        rmse: float,
        parameters: Mapping[str, ParameterValue],
    ) -> str:
        """Describe the first saved number that differs from the fit; empty if all agree.

        Models with a user-defined effect whose code is missing are not compared.
        """
        if not set(effects) <= set(self._library):
            return ""
        fit = self.fit(channel, effects)
        if differs_from_fit(rmse, fit.rmse):
            return f"its error is {rmse:.4g}, but these data give {fit.rmse:.4g}"
        for name, saved in parameters.items():
            fitted = fit.parameters.get(name)
            if fitted is not None and differs_from_fit(saved.value, fitted.value, fitted.std_err):
                return f"its {name} is {saved.value:.4g}, but these data give {fitted.value:.4g}"
        return ""

    def _save_stages(
        self, channel: StudyChannel, effects: Sequence[str], parent: Revision | None
    ) -> tuple[Revision, ...]:
        """Save each stage after the parent, or after a base model that is already saved."""
        before = parent or next((each for each in self._revisions_of(channel) if not each.effects), None)
        self.fit(channel, effects)  # raises before anything is saved if an effect cannot be added
        kept: list[Revision] = []
        try:
            for count in range(0 if before is None else len(before.effects) + 1, len(effects) + 1):
                kept.append(self._save_stage(channel, effects[:count], kept[-1] if kept else before))
        except BaseException:  # such as a full disk or Ctrl-C: save all stages or none
            self._revisions.discard(kept)
            raise
        return tuple(kept)

    def _save_stage(
        self, channel: StudyChannel, effects: Sequence[str], parent: Revision | None, *, removed: str = ""
    ) -> Revision:
        from importlib.metadata import version  # noqa: PLC0415, slow to import

        fit, created = self.fit(channel, effects), self._now().isoformat(timespec="seconds")
        noise = self.noise(channel)
        return self._revisions.save(
            lambda number: Revision(
                number=number,
                parent=None if parent is None else parent.number,
                channel=channel.name,
                model=channel.model.name,
                added="" if removed else "".join(effects[-1:]),
                removed=removed,
                effects=list(effects),
                user_effects=[self._user_places[name] for name in effects if name in self._user_places],
                effort_unit=channel.effort_unit,
                rmse=fit.rmse,
                noise_floor=noise.value,
                noise_at_most=noise.is_bound,
                parameters={name: SavedParameter.of(value) for name, value in fit.parameters.items()},
                data_sha256=channel.sha256,
                created_utc=created,
                software_version=version("palpate"),
            )
        )
