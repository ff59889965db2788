"""The channels of a study, each with its base model and a hash of its data."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from difflib import get_close_matches
from functools import cached_property, lru_cache

import numpy as np

from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import Effect
from palpate.estimation.fit.blocks import LUMPED_GAINS
from palpate.estimation.fit.measurement_model import is_acceleration_resolved
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.study.fitting import recovery, surface_recovers
from palpate.estimation.study.source import DataSource
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

CONTACT_MODEL = "kelvin_voigt"
ARM_MODEL = "rigid_body"
FITTED_ARM_MODEL = "rigid_body_fitted"
LOOSE_JOINT_MODEL = "inertia"
SERVO_MODEL = "position_servo"
ChannelKey = tuple[str, str]  # channel and base model, in one study
SavedKey = tuple[str, str, str]  # channel, base model, SHA-256 of the data, in any study
ALL_CHANNELS = "all"
_DIGITS = 9  # decimal digits of what identifies data; rounding errors reach the 12th
_KIND_NAMES = {
    ChannelKind.CONTACT: "contact",
    ChannelKind.PRISMATIC: "prismatic joint",
    ChannelKind.REVOLUTE: "revolute joint",
    ChannelKind.SERVO: "position servo",
}


@dataclass(frozen=True, eq=False)
class StudyChannel:
    """One channel with its base model."""

    measured: ChannelData  # the recorded channel
    model: Model  # the base model of this channel
    context: ModelContext  # further information that the model may need
    arm: Arm  # the arm to which the channel belongs
    # Value of `data` if it depends on other channels; None to compute it from this channel.
    prepared: ChannelData | None = None
    # Runs excluded from fitting and used only for scoring; empty for cross-validation.
    held_out: tuple[int, ...] = ()

    @cached_property
    def data(self) -> ChannelData:
        """Channel with the signals that the model needs, computed on first use.

        Raises:
            InputError: the channel lacks something that the model needs.
        """
        if self.prepared:
            return self.prepared
        data = self.prepare()
        if data.recovers is not None:
            return data
        data = replace(data, surface_recovers=surface_recovers(self._without_held_out(data)))
        recovers, ratio, retardation_s = recovery(self._without_held_out(data))
        return replace(data, recovers=recovers, recovery_ratio=ratio, retardation_s=retardation_s)

    def prepare(self) -> ChannelData:
        """Compute the signals that the model needs.

        Raises:
            InputError: see `data`.
        """
        return MODELS[self.model.name]().prepare(self.measured, self.context)

    @cached_property
    def to_fit(self) -> ChannelData:
        """Runs of `data` that are used for fitting."""
        return self._without_held_out(self.data)

    def _without_held_out(self, data: ChannelData) -> ChannelData:
        return data.of_runs(np.setdiff1d(data.runs, self.held_out)) if self.held_out else data

    @property
    def name(self) -> str:
        """Name of the channel, such as "contact" or "joint_1"."""
        return self.measured.name

    @property
    def key(self) -> ChannelKey:
        """Key that identifies the channel and its base model within its study."""
        return self.name, self.model.name

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of all measured arrays, up to rounding, of the held-out runs, and of a joint's arm."""
        digest = data_sha256(self.measured, self.arm)
        if not self.held_out:
            return digest
        return hashlib.sha256(f"{digest} {self.held_out}".encode()).hexdigest()

    @property
    def saved_key(self) -> SavedKey:
        """Key that identifies the data and base model of what is saved in files."""
        return (*self.key, self.sha256)

    @property
    def kind(self) -> ChannelKind:
        """Kind of the channel."""
        return self.measured.kind

    @property
    def effort_unit(self) -> str:
        """Unit of all errors."""
        return self.measured.effort_unit

    def __repr__(self) -> str:
        samples, runs = len(self.measured), len(self.measured.runs)
        return f"{self.name}: {self.model.name}, {runs} runs, {samples} samples, {self.sha256[:12]}"


def channel_of(data: ChannelData, model: str, arm: Arm, held_out: tuple[int, ...] = ()) -> StudyChannel:
    """Build a channel with a base model.

    Args:
        data: the measured channel.
        model: name of the base model.
        arm: the arm to which the channel belongs.
        held_out: runs excluded from fitting and used only for scoring.

    Raises:
        InputError: the model is unknown, lacks required information, or no run is left for fitting.
    """
    context = arm.context_of(data)
    if held_out:
        if model == FITTED_ARM_MODEL:  # its joints share information from all runs
            raise InputError(f"model '{model}' predicts each run from the others; leave out held_out")
        if not len(np.setdiff1d(data.runs, held_out)):
            raise InputError(
                f"channel '{data.name}': all runs are held out; leave at least one run to fit to"
            )
    return StudyChannel(data, base_model(data, model, context), context, arm, held_out=held_out)


def base_model(data: ChannelData, model: str, context: ModelContext) -> Model:
    """Build the base model of a channel; its inertia is held at zero if the data do not resolve it.

    Args:
        data: the measured channel.
        model: name of the base model.
        context: further information that the model may need.

    Raises:
        InputError: the model is unknown or lacks required information.
    """
    built = MODELS[model]().build(context)
    inertias = [f"{name}.{gain}" for name, gain in LUMPED_GAINS.items() if f"{name}.{gain}" in built.gains]
    is_held = inertias and not is_acceleration_resolved(data)
    return replace(built, held=dict.fromkeys(inertias, 0.0)) if is_held else built


def default_model(channel: ChannelData, arm: Arm) -> str:
    """Return the usual base model: a spring and damper, or the rigid body of the arm's URDF.

    Args:
        channel: the channel.
        arm: the arm to which it belongs.
    """
    if channel.kind is ChannelKind.CONTACT:
        return CONTACT_MODEL
    if channel.kind is ChannelKind.SERVO:
        return SERVO_MODEL
    return ARM_MODEL if arm.urdf else LOOSE_JOINT_MODEL


def model_to_estimate(source: DataSource, model: str | None) -> dict[str, str]:
    """Return the models to estimate by channel: of contacts if there are any, otherwise of joints.

    Args:
        source: the measurement.
        model: name of the base model; None for the usual one.

    Raises:
        InputError: the model is unknown, or describes none of the channels, such as a probing without
            contact.
    """
    contacts = any(channel.kind is ChannelKind.CONTACT for channel in source.channels)
    if model is None and (contacts or source.probed):
        model = CONTACT_MODEL
    if model is not None:
        return {channel.name: model for channel in channels_for_model(source, model)}
    joints = FITTED_ARM_MODEL if source.arm.urdf else LOOSE_JOINT_MODEL
    return {channel.name: joints for channel in source.channels}


def channels_for_model(source: DataSource, model: str) -> tuple[ChannelData, ...]:
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
        # A displacement with both signs is read as a linear axis, to which spring and damper also apply.
        channels = tuple(channel for channel in source.channels if channel.kind is ChannelKind.PRISMATIC)
    if channels:
        return channels
    expected = " or ".join(_KIND_NAMES[kind] for kind in sorted(kinds))
    listed = ", ".join(f"{channel.name} ({channel.kind})" for channel in source.channels)
    hint = "." if source.session is None or ChannelKind.CONTACT not in kinds else "; was anything touched?"
    valid = [n for n in MODELS if MODELS[n].channels & {channel.kind for channel in source.channels}]
    raise InputError(
        f"{source.path or source.name}: model '{model}' describes a {expected}, but the channels are: "
        f"{listed}{hint} Choose with --model: {', '.join(valid)}"
    )


def inapplicable_reason(effect: Effect, data: ChannelData) -> str:
    """Describe why an effect does not apply to a channel; empty if it applies.

    Args:
        effect: the effect.
        data: the channel with derived signals.
    """
    if effect.applies_to(data):
        return ""
    missing = [signal for signal in effect.needs if signal not in data.context]
    which = "this" if data.kind in effect.channels else f"a {data.kind.value}"
    reason = f"needs {', '.join(missing)}" if missing else f"is not for {which} channel"
    return f"effect '{effect.name}' {reason} (channel '{data.name}')"


def suited_names(name: str, effects: Sequence[Effect], channels: Sequence[ChannelData]) -> str:
    """List applicable effects for a message about an unknown or unsuitable effect.

    Likely effects come first: those that share a word with the given name, or with the most similar name.

    Args:
        name: name given by the user.
        effects: the library of effects.
        channels: channels to which the effect may be added.
    """
    kinds = {channel.kind for channel in channels}
    names = [effect.name for effect in effects if effect.channels & kinds and effect.name != name]
    closest = get_close_matches(name, [effect.name for effect in effects], n=1)
    words = {word for text in (name, *closest) for word in text.split("_")}
    suggestions = [name for name in names if name in closest or words & set(name.split("_"))]
    suggestions.sort(key=lambda suggestion: suggestion not in closest)  # the most similar name first
    hint = f"Did you mean {' or '.join(suggestions)}? " if suggestions else ""
    where = " and ".join(f"a {kind.value}" for kind in sorted(kinds))
    return f"{hint}Effects of {where}: {', '.join(names)}"


def data_sha256(data: ChannelData, arm: Arm) -> str:
    """Compute the SHA-256 of all inputs of a fit except its model.

    Rounding errors, which differ between processors and versions of libraries, do not change it, nor do
    phases, which are derived with thresholds.

    Args:
        data: the measured channel.
        arm: the arm to which it belongs; ignored for a contact.
    """
    digest = hashlib.sha256()
    _update_digest(digest, replace(data, phase=np.full(len(data), -1)))
    if data.kind is not ChannelKind.CONTACT:
        _update_digest(digest, (arm.urdf, arm.tip_frame, arm.gravity_m_s2))
        if arm.rotor_inertia_kg_m2:
            _update_digest(digest, arm.rotor_inertia_kg_m2)
    return digest.hexdigest()


def _update_digest(digest: "hashlib._Hash", value: object) -> None:
    """Update a digest with a value, its type and its size; numbers that differ by rounding are the same."""
    match value:
        case np.ndarray() if value.dtype.kind == "f":
            # Its scale, and its rounded projections on fixed directions, identify an array.
            is_finite = np.isfinite(value).ravel()
            flat = np.where(is_finite, value.ravel(), 0.0)
            scale, directions = float(np.linalg.norm(flat)), _directions(len(flat))
            projected = (*(directions @ (flat / (scale or 1.0))).tolist(), *(directions @ is_finite))
            _update_digest(digest, (value.shape, scale, *(round(each, _DIGITS) + 0.0 for each in projected)))
        case float():
            digest.update(f"{value:.{_DIGITS}g};".encode())
        case np.ndarray():
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            _update_digest(digest, [(key, value[key]) for key in sorted(value)])
        case frozenset():
            _update_digest(digest, sorted(value))
        case str():
            digest.update(f"{len(value)}:{value}".encode())
        case Sequence():
            digest.update(f"[{len(value)}".encode())
            for item in value:
                _update_digest(digest, item)
        case _ if is_dataclass(value):
            for field in fields(value):
                if field.compare:
                    _update_digest(digest, (field.name, getattr(value, field.name)))
        case _:
            digest.update(f"{type(value).__name__}={value!r};".encode())


@lru_cache(maxsize=2)
def _directions(size: int) -> FloatArray:
    """Return two vectors, shape (2, size), without symmetry."""
    return np.cos(np.sqrt([[2.0], [3.0]]) * np.arange(1, size + 1))
