"""Which revisions are of the data at hand: a file may hold several specimens, and a session be probed anew.

Nothing but the file's name says where revisions lie, so it is told by the error of the base model.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from estimation.channel import ChannelData
from estimation.effect import Effect
from estimation.revision import standings
from palpate.findings.estimation_run import Arm, Material
from palpate.findings.kept_diagnosis import KeptDiagnosis, is_same
from palpate.findings.kept_revision import KeptRevision
from palpate.findings.revisions import RevisionShelf
from palpate.findings.subject import Subject, subject_of
from robot_io.errors import InputError


@dataclass(frozen=True)
class SameData:
    """Tells revisions of the data at hand from others.

    Attributes:
        material: the data at hand.
        arm: what its channels belong to.
        shelf: the revisions.
        kept: what was found earlier; None where no channel was mended by that.
        effects: where those that were added are found.
    """

    material: Material
    arm: Arm
    shelf: RevisionShelf
    kept: KeptDiagnosis | None
    effects: Sequence[Effect]

    def latest(self, channel: str, model: str | None = None) -> KeptRevision | None:
        """The newest revision of a channel, of those that are of this data; see `RevisionShelf.latest`."""
        found = [r for r in self.shelf.all() if r.channel == channel and model in {None, r.model}]
        return next((one for one in reversed(found) if self._other_error(one) is None), None)

    def check(self, revision: KeptRevision) -> None:
        """Refuse a revision of other data.

        Raises:
            InputError: it is, or its channel is not there.
        """
        channel_of(self.material, revision)
        today = self._other_error(revision)
        if today is not None:
            began, unit = self._origin(revision).rmse, revision.effort_unit
            here = "it cannot be fitted" if math.isnan(today) else f"that is {today:.4g} {unit}"
            raise InputError(
                f"revision {revision.number} is of other data: it began with an error of {began:.4g} {unit}, "
                f"here {here}. Give the options that it was made with (--where, --unit, --urdf), add to this "
                "data first (palpate diagnose --apply, palpate add --fresh), or name another folder"
            )

    def _other_error(self, revision: KeptRevision) -> float | None:
        """The error today of what a revision began with, where it is another; None where it is the same."""
        origin, today = self._origin(revision), float("nan")
        try:
            subject = subject_of(channel_of(self.material, revision), origin.model, self.arm)
        except InputError:  # the arm is not known here: nobody can say
            return None
        for today in self._errors(subject, origin):
            if is_same(today, origin.rmse):
                return None
        return today

    def _errors(self, subject: Subject, origin: KeptRevision) -> Iterator[float]:
        """Of the channel as it was measured, and as it was judged; none where it cannot be fitted."""
        seen = [subject] if self.kept is None else [subject, self.kept.as_judged(subject)]
        for one in seen[:1] if seen[-1] is subject else seen:
            try:
                *_, last = standings(one.channel, one.model, origin.effects, self.effects)
            except InputError:
                continue
            yield last.rmse

    def _origin(self, revision: KeptRevision) -> KeptRevision:
        """The earliest that is kept of those that a revision grew from: the base model, if nobody took it."""
        known = {one.number: one for one in self.shelf.all()}
        while revision.parent in known:
            revision = known[revision.parent]
        return revision


def channel_of(material: Material, revision: KeptRevision) -> ChannelData:
    """The channel that a revision is of.

    Raises:
        InputError: it is not there.
    """
    channel = next((one for one in material.channels if one.name == revision.channel), None)
    if channel is None:
        raise InputError(f"revision {revision.number} is of channel '{revision.channel}', which is not there")
    return channel
