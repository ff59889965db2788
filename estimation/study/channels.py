"""The channels of a study, each with its base model and a hash of its data."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cached_property

import numpy as np

from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import Effect
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.study.source import Source
from palpate.robot_io.errors import InputError

CONTACT_MODEL = "kelvin_voigt"
ARM_MODEL = "rigid_body"
FITTED_ARM_MODEL = "rigid_body_fitted"
LOOSE_JOINT_MODEL = "inertia"
SERVO_MODEL = "position_servo"
ChannelKey = tuple[str, str, str]  # channel, base model, SHA-256 of the data
ALL_CHANNELS = "all"
_IN_WORDS = {
    ChannelKind.CONTACT: "contact",
    ChannelKind.PRISMATIC: "prismatic joint",
    ChannelKind.REVOLUTE: "revolute joint",
    ChannelKind.SERVO: "position servo",
}


@dataclass(frozen=True, eq=False)
class StudyChannel:
    """One channel with its base model."""

    measured: ChannelData  # as it was recorded
    model: Model  # the base model, as built for this channel
    context: ModelContext  # what that may need to know beside the channel
    sha256: str  # of all arrays as they were measured and, for a joint, of the arm
    # `data`, where it is more than the base model makes of this channel alone.
    prepared: ChannelData | None = None
    # Runs that no model is fitted to, and which alone judge models; none for each in turn.
    held_out: tuple[int, ...] = ()

    @cached_property
    def data(self) -> ChannelData:
        """Channel with the signals that the model needs, computed on first use.

        Raises:
            InputError: the channel lacks something that the model needs.
        """
        return self.prepared or MODELS[self.model.name]().prepare(self.measured, self.context)

    @cached_property
    def to_fit(self) -> ChannelData:
        """Runs of `data` that models are fitted to."""
        return self.data.of_runs(np.setdiff1d(self.data.runs, self.held_out)) if self.held_out else self.data

    @property
    def name(self) -> str:
        """Such as "contact" or "joint_1"."""
        return self.measured.name

    @property
    def key(self) -> ChannelKey:
        """Identifies the data and base model that a fit is about."""
        return self.name, self.model.name, self.sha256

    @property
    def kind(self) -> ChannelKind:
        """Kind of the channel's effort and motion."""
        return self.measured.kind

    @property
    def effort_unit(self) -> str:
        """Unit of all errors."""
        return self.kind.effort_unit

    def __repr__(self) -> str:
        samples, runs = len(self.measured), len(self.measured.runs)
        return f"{self.name}: {self.model.name}, {runs} runs, {samples} samples, {self.sha256[:12]}"


def channel_of(data: ChannelData, model: str, arm: Arm, held_out: tuple[int, ...] = ()) -> StudyChannel:
    """Build a channel with a base model.

    Args:
        data: the channel as it was measured.
        model: name of the base model.
        arm: the arm that the channel belongs to.
        held_out: runs excluded from fitting and used only for scoring.

    Raises:
        InputError: the model is unknown, lacks something, or has no run to be fitted to.
    """
    context, sha256 = arm.context_of(data), data_sha256(data, arm)
    if held_out:
        if model == FITTED_ARM_MODEL:  # its joints share what all runs say of their masses
            raise InputError(f"model '{model}' predicts each run from the others: leave out held_out")
        if not len(np.setdiff1d(data.runs, held_out)):
            raise InputError(
                f"channel '{data.name}': all runs are held out; leave at least one run to fit to"
            )
        sha256 = hashlib.sha256(f"{sha256} {held_out}".encode()).hexdigest()  # other data to any fit
    return StudyChannel(data, MODELS[model]().build(context), context, sha256, held_out=held_out)


def usual_model(channel: ChannelData, arm: Arm) -> str:
    """Return the usual base model: a spring and damper, or the rigid body of the arm's URDF.

    Args:
        channel: the channel.
        arm: the arm that it belongs to.
    """
    if channel.kind is ChannelKind.CONTACT:
        return CONTACT_MODEL
    if channel.kind is ChannelKind.SERVO:
        return SERVO_MODEL
    return ARM_MODEL if arm.urdf else LOOSE_JOINT_MODEL


def model_to_estimate(source: Source, model: str | None) -> dict[str, str]:
    """Choose models to estimate: of contacts where there are any or should be, else of joints.

    Args:
        source: the measurement.
        model: name of the base model; None for the usual one.

    Returns:
        Names of models by channel.

    Raises:
        InputError: the model is unknown, or describes none of the channels.
    """
    contacts = any(channel.kind is ChannelKind.CONTACT for channel in source.channels)
    if model is None and (contacts or source.probed):
        model = CONTACT_MODEL
    if model is not None:
        return {channel.name: model for channel in described_by(source, model)}
    joints = FITTED_ARM_MODEL if source.arm.urdf else LOOSE_JOINT_MODEL
    return {channel.name: joints for channel in source.channels}


def described_by(source: Source, model: str) -> tuple[ChannelData, ...]:
    """Return the channels that a base model describes.

    Args:
        source: the measurement.
        model: name of the base model.

    Raises:
        InputError: there is no such model, or it describes none of the channels.
    """
    kinds = MODELS[model].channels
    channels = tuple(channel for channel in source.channels if channel.kind in kinds)
    if not channels and model == CONTACT_MODEL and source.session is None:
        # A displacement to both sides is read as a linear axis, to which spring and damper apply as well.
        channels = tuple(channel for channel in source.channels if channel.kind is ChannelKind.PRISMATIC)
    if channels:
        return channels
    expected = " or ".join(_IN_WORDS[kind] for kind in sorted(kinds))
    listed = ", ".join(f"{channel.name} ({channel.kind})" for channel in source.channels)
    hint = "." if source.session is None or ChannelKind.CONTACT not in kinds else "; was anything touched?"
    valid = [n for n in MODELS if MODELS[n].channels & {channel.kind for channel in source.channels}]
    raise InputError(
        f"{source.path or source.name}: model '{model}' describes a {expected}, its channels are: "
        f"{listed}{hint} Choose with --model: {', '.join(valid)}"
    )


def unapplicable(effect: Effect, data: ChannelData) -> str:
    """Say why an effect cannot be in a channel, in a few words; empty if it can.

    Args:
        effect: the effect.
        data: the channel, with derived signals.
    """
    if effect.applies_to(data):
        return ""
    lacking = [signal for signal in effect.needs if signal not in data.context]
    which = "this" if data.kind in effect.channels else f"a {data.kind.value}"
    why = f"needs {', '.join(lacking)}" if lacking else f"is not for {which} channel"
    return f"effect '{effect.name}' {why} (channel '{data.name}')"


def suited_names(name: str, effects: Sequence[Effect], channels: Sequence[ChannelData]) -> str:
    """List the effects that suit, for a message about one that is unknown or does not suit.

    Likely effects come first: those that share a word with the given name or with the one closest to it.

    Args:
        name: the effect that the user named.
        effects: the library.
        channels: where the effect may be.
    """
    kinds = {channel.kind for channel in channels}
    names = [effect.name for effect in effects if effect.channels & kinds]
    meant = get_close_matches(name, [effect.name for effect in effects], n=1)
    words = {word for text in (name, *meant) for word in text.split("_")}
    likely = [name for name in names if name in meant or words & set(name.split("_"))]
    hint = f"Did you mean {' or '.join(likely)}? " if likely else ""
    where = " and ".join(f"a {kind.value}" for kind in sorted(kinds))
    return f"{hint}In {where} there are: {', '.join(names)}"


def data_sha256(data: ChannelData, arm: Arm) -> str:
    """Compute the SHA-256 of everything that a fit depends on except its model.

    Args:
        data: the channel as it was measured.
        arm: the arm that it belongs to; ignored for a contact.

    Returns:
        64 hexadecimal digits.
    """
    digest = hashlib.sha256()
    _feed(digest, data)
    if data.kind is not ChannelKind.CONTACT:
        _feed(digest, (arm.urdf, arm.tip_frame, arm.gravity_m_s2))
        if arm.rotor_inertia_kg_m2:
            _feed(digest, arm.rotor_inertia_kg_m2)
    return digest.hexdigest()


def _feed(digest: "hashlib._Hash", value: object) -> None:
    """Yield each value with its type and size, so that different values give different bytes."""
    match value:
        case np.ndarray():
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            _feed(digest, [(key, value[key]) for key in sorted(value)])
        case frozenset():
            _feed(digest, sorted(value))
        case str():
            digest.update(f"{len(value)}:{value}".encode())
        case Sequence():
            digest.update(f"[{len(value)}".encode())
            for item in value:
                _feed(digest, item)
        case _ if is_dataclass(value):
            for field in fields(value):
                _feed(digest, (field.name, getattr(value, field.name)))
        case _:
            digest.update(f"{type(value).__name__}={value!r};".encode())
