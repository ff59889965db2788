"""What is compared and diagnosed: channels, each with the simple model that is to explain it."""

from dataclasses import dataclass, replace

from estimation.channel import ChannelData, ChannelKind
from estimation.model import Model
from estimation.models import MODELS
from palpate.findings.estimation_run import DEFAULT_MODEL, Arm, Material, context_of
from robot_io.errors import InputError

ARM_MODEL = "rigid_body"
FITTED_ARM_MODEL = "rigid_body_fitted"
LOOSE_JOINT_MODEL = "inertia"


@dataclass(frozen=True)
class Subject:
    """One channel with its base model.

    Attributes:
        channel: with the signals that the model needs.
        model: the base model, as built for this channel.
        force_ahead_of: faults of the force sensor, ahead of which the contact's model says with what force
            the tip presses; empty for the force as it was measured.
        not_judged: joints of the same arm that a diagnosis of this contact leaves out.
    """

    channel: ChannelData
    model: Model
    force_ahead_of: tuple[str, ...] = ()
    not_judged: tuple[str, ...] = ()


def subjects_of(material: Material, model: str | None, arm: Arm) -> tuple[Subject, ...]:
    """The channels that a model describes; without one, all channels with the model that suits each.

    Raises:
        InputError: the model is unknown, describes none of the channels, or lacks something.
    """
    channels = material.channels if model is None else material.described_by(model)
    return tuple(subject_of(channel, model or usual_model(channel, arm), arm) for channel in channels)


def usual_model(channel: ChannelData, arm: Arm) -> str:
    """The model that one would start from: a spring and damper, or the arm as its URDF has it."""
    if channel.kind is ChannelKind.CONTACT:
        return DEFAULT_MODEL
    return ARM_MODEL if arm.urdf else LOOSE_JOINT_MODEL


def to_estimate(material: Material, model: str | None, arm: Arm) -> tuple[tuple[ChannelData, str], ...]:
    """The channels to estimate, each with its model: contacts where there are any or were to be, else joints.

    Args:
        material: what was measured.
        model: what the user asked for; None for what suits each channel and has something to estimate.
        arm: what the channels belong to.

    Raises:
        InputError: the model is unknown, or describes none of the channels.
    """
    contacts = any(channel.kind is ChannelKind.CONTACT for channel in material.channels)
    if model is None and (contacts or material.probed):
        model = DEFAULT_MODEL
    if model is not None:
        return tuple((channel, model) for channel in material.described_by(model))
    joints = FITTED_ARM_MODEL if arm.urdf else LOOSE_JOINT_MODEL
    return tuple((channel, joints) for channel in material.channels)


def model_names(subjects: tuple[Subject, ...]) -> str:
    """The base models, each once, with "+" between them."""
    return "+".join(dict.fromkeys(subject.model.name for subject in subjects))


def only_channel(subjects: tuple[Subject, ...], name: str | None) -> tuple[Subject, ...]:
    """The subject whose channel has this name; all of them for None.

    Raises:
        InputError: there is none.
    """
    chosen = tuple(subject for subject in subjects if name in {None, subject.channel.name})
    if not chosen:
        there = ", ".join(subject.channel.name for subject in subjects)
        raise InputError(f"--channel {name}: no such channel. There are: {there}")
    return chosen


def subject_of(channel: ChannelData, model: str, arm: Arm) -> Subject:
    """A channel with a base model.

    Raises:
        InputError: the model is unknown, or lacks something.
    """
    base, context = MODELS[model](), context_of(channel, arm)
    built = base.build(context)
    return Subject(base.prepare(channel, context), built)


ALL_CHANNELS = "all"


def channels_to_diagnose(
    subjects: tuple[Subject, ...], name: str | None, *, probed: bool = False
) -> tuple[Subject, ...]:
    """The named channel, all for "all", and for None the contacts where there are any.

    An arm's joints are left out unless they are asked for: the accelerations of a probing session are too
    noisy for a verdict that can be trusted (docs/missing-effects.md, "Joints").

    Args:
        subjects: all that there are.
        name: what the user asked for.
        probed: whether an arm was to touch something.

    Raises:
        InputError: there is no such channel, or nothing was touched.
    """
    if name == ALL_CHANNELS:
        return subjects
    contacts = tuple(subject for subject in subjects if subject.channel.kind is ChannelKind.CONTACT)
    if probed and name is None and not contacts:
        raise InputError(
            "no contact: the force never rises above that in free air. Was anything touched, is the sensor "
            f"alive? The joints alone: --channel {ALL_CHANNELS}"
        )
    chosen = contacts if name is None and contacts else only_channel(subjects, name)
    left_out = tuple(s.channel.name for s in subjects if s.channel.kind is not ChannelKind.CONTACT)
    return tuple(
        replace(one, not_judged=left_out) if one.channel.kind is ChannelKind.CONTACT else one
        for one in chosen
    )
