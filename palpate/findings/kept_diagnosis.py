"""What an earlier diagnosis of the same data found, for the commands that go on from there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import ChannelDiagnosis, Diagnosis
from estimation.diagnosis.dead_band import swallowing
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.result import Accepted
from estimation.diagnosis.true_force import sensor_faults, with_true_force
from estimation.effect import Effect
from estimation.models import MODELS
from estimation.revision import standings
from palpate.findings.estimation_run import Arm, Material
from palpate.findings.subject import Subject, subject_of
from robot_io.errors import InputError

RESULT = "diagnosis.json"
_WIDTH = "width"  # of a dead band, which is all that other channels tell
_SAME = 1e-6  # relative difference of an error that is computed once more


@dataclass(frozen=True)
class KeptDiagnosis:
    """The diagnosis in a session's derived folder, as far as it is about the data at hand.

    Attributes:
        found: the answers by the name of the channel.
        models: names of the base models that were judged.
        contacts: those contacts whose force sensor was surely found to be at fault.
        effects: the library in which the effects that were found are.
    """

    found: dict[str, ChannelDiagnosis]
    models: tuple[str, ...]
    contacts: tuple[Judged, ...]
    effects: tuple[Effect, ...]

    def model_of(self, kind: ChannelKind) -> str | None:
        """The base model by which channels of this kind were judged, if any were."""
        return next((name for name in self.models if kind in MODELS[name].channels), None)

    def as_judged(self, subject: Subject) -> Subject:
        """The subject as it was, or would be, judged.

        A joint gets the force ahead of the sensor's faults, a contact the dead band that its joints showed.
        """
        own = self.found.get(subject.channel.name)
        swallowed = _swallowed(own, subject) if own is not None else None
        if swallowed is not None:
            return replace(subject, channel=swallowing(subject.channel, *swallowed))
        if own is not None and own.baseline is not None and not own.force_ahead_of:
            return subject  # it was judged alone, by the force as measured
        mended = with_true_force(subject.channel, self.contacts, self.effects)
        if mended is subject.channel:
            return subject
        faults = dict.fromkeys(name for one in self.contacts for name in sensor_faults(one, self.effects))
        return replace(subject, channel=mended, force_ahead_of=tuple(faults))

    def of(self, channel: str, base_rmse: float) -> ChannelDiagnosis | None:
        """What was found in a channel, if it was judged from a base model with this error."""
        found = self.found.get(channel)
        return found if found is not None and _is_about(found, base_rmse) else None


def kept_diagnosis(folder: Path, material: Material, arm: Arm, effects: Sequence[Effect]) -> KeptDiagnosis:
    """Read what `palpate diagnose` wrote; nothing found where it wrote nothing.

    What is there may be about other rows of a data file, or come from another version: it is gone by only
    where the error of the base model is the same today.

    Args:
        folder: the derived folder.
        material: the data at hand.
        arm: what its channels belong to.
        effects: the library.

    Raises:
        InputError: the file is damaged.
    """
    diagnosis = _read(folder / RESULT)
    if diagnosis is None:
        return KeptDiagnosis({}, (), (), tuple(effects))
    models = tuple(name for name in diagnosis.model.split("+") if name in MODELS)
    kept = KeptDiagnosis({entry.channel: entry for entry in diagnosis.channels}, models, (), tuple(effects))
    contacts = [_contact(channel, arm, kept) for channel in material.channels]
    return replace(kept, contacts=tuple(one for one in contacts if one is not None))


def _contact(channel: ChannelData, arm: Arm, kept: KeptDiagnosis) -> Judged | None:
    """A contact whose sensor is at fault, with the base model that it was judged by."""
    entry, model = kept.found.get(channel.name), kept.model_of(channel.kind)
    known = {effect.name for effect in kept.effects}
    if channel.kind is not ChannelKind.CONTACT or entry is None or model is None:
        return None
    subject = subject_of(channel, model, arm)
    borne_out = any(entry.force_ahead_of for entry in kept.found.values())
    judged = Judged(subject.channel, subject.model, entry, borne_out)
    named = known.issuperset(one.effect for one in entry.accepted)
    if not named or not sensor_faults(judged, kept.effects):
        return None
    return judged if _is_of(entry, subject) else None


def _swallowed(found: ChannelDiagnosis, subject: Subject) -> tuple[float, float] | None:
    """Width and standard error of the dead band that its joints showed in a contact; None without one."""
    told = [entry.parameters[_WIDTH] for entry in _told(found)]
    if not told or told[0].std_err is None or subject.channel.kind is not ChannelKind.CONTACT:
        return None
    return (told[0].value, told[0].std_err) if _is_of(found, subject) else None


def _told(found: ChannelDiagnosis) -> list[Accepted]:
    return [entry for entry in found.accepted if entry.told_by]


def _is_of(found: ChannelDiagnosis, subject: Subject) -> bool:
    """Whether an answer is about this channel as it was measured, and its base model."""
    try:
        (base,) = standings(subject.channel, subject.model, ())
    except InputError:  # it cannot be judged today
        return False
    return _is_about(found, base.rmse)


def is_same(one_rmse: float, other_rmse: float) -> bool:
    """Whether two errors are those of one model on the same data."""
    return math.isclose(one_rmse, other_rmse, rel_tol=_SAME)


def _is_about(found: ChannelDiagnosis, base_rmse: float) -> bool:
    return found.baseline is not None and is_same(found.baseline.rmse, base_rmse)


def _read(file: Path) -> Diagnosis | None:
    if not file.is_file():
        return None
    damaged = f"{file}: is damaged; delete it, or run palpate diagnose again"
    try:
        diagnosis = Diagnosis.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise InputError(damaged) from error
    for found in diagnosis.channels:
        if any(_WIDTH not in entry.parameters for entry in _told(found)):
            raise InputError(f"{damaged} (what others told of '{found.channel}' is without its {_WIDTH})")
    return diagnosis
