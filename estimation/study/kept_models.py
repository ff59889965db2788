"""Saved models of one measurement: keep them, find them, and reject those of other data or versions."""

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path

from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.study.channels import StudyChannel
from palpate.estimation.study.fits import StudyFits
from palpate.estimation.study.results import RevisionTable
from palpate.estimation.study.revisions import KeptParameter, Revision, Revisions
from palpate.estimation.study.saved_diagnosis import is_other
from palpate.robot_io.errors import InputError


class StudyRevisions(StudyFits):
    """Revisions of a study's models; `ModelStudy` says where they are saved."""

    folder: Path | None  # of revisions and the diagnosis; None to keep them in memory
    _revisions: Revisions
    _now: Callable[[], datetime]  # clock for the creation time of revisions

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
            number: number of the revision.

        Raises:
            InputError: there is none, or it has an effect of the user's own that this study was not given.
        """
        revision = self._revisions.get(number)
        self._check_own(revision)
        return revision

    def channel_of(self, revision: Revision) -> StudyChannel:
        """Return the channel of a revision, with its base model.

        Args:
            revision: revision of this study's folder.

        Raises:
            InputError: the channel is not there.
        """
        return self.with_model(revision.channel, revision.model)

    def check(self, revision: Revision) -> None:
        """Reject a revision of other data, or with other numbers than this study's fit.

        Args:
            revision: revision of this study's folder.

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

    def _current(self, channel: StudyChannel) -> StudyChannel:
        newest = self.newest(channel)
        return channel if newest is None else self.channel_of(newest)

    def _check_own(self, revision: Revision) -> None:
        """Reject a revision with a user-defined effect whose code was not given."""
        for place in revision.user_effects:
            if place not in self._own.values():
                raise InputError(
                    f"revision {revision.number} has an effect of your own: add --effect {place}"
                )

    def _other_numbers(
        self,
        channel: StudyChannel,
        effects: Sequence[str],
        rmse: float,
        parameters: Mapping[str, ParameterValue],
    ) -> str:
        """Describe the first saved number that differs from the fit; empty if all agree.

        Models with a user-defined effect whose code was not given cannot be compared.
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
