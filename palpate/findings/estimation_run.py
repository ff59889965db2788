"""Runs estimators over the channels of a session or data file."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from control.loop.tick_record import STREAM_NAME
from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.data.channels import is_session, session_channels
from estimation.data.import_file import import_file
from estimation.data.import_options import ImportOptions
from estimation.estimate import Estimate
from estimation.estimate_channel import estimate_channel, fitting_rows
from estimation.estimators import ESTIMATORS
from estimation.model import Model
from estimation.models import MODELS
from estimation.surface import Surface
from palpate.files import existing_file
from palpate.findings.truth import true_parameters
from robot_io.calibration import NO_CALIBRATIONS, parse_calibrations
from robot_io.errors import InputError
from robot_io.robot_file import parse_robot_file
from robot_io.session import Session
from robot_io.types import BoolArray, FloatArray

BEST = ("robust", "weighted", "lsq")  # whose estimate is shown where there is room for one
MOST = 0.8  # of the samples
ALL = "all"
SEED = 1  # of the random choices of RANSAC
OFFSET = "contact_offset.offset"
DEFAULT_MODEL = "kelvin_voigt"
NO_OPTIONS = ImportOptions()
_IN_WORDS = {
    ChannelKind.CONTACT: "contact",
    ChannelKind.PRISMATIC: "prismatic joint",
    ChannelKind.REVOLUTE: "revolute joint",
}


@dataclass(frozen=True)
class Arm:
    """The arm that was measured.

    Attributes:
        urdf: text of its URDF, empty where it is not known.
        tip_frame: the tip's frame in it.
        origin: where the URDF comes from, for errors.
        gravity_m_s2: shape (3,), fall acceleration in the axes of its base [m/s^2].
    """

    urdf: str = ""
    tip_frame: str = ""
    origin: str = "URDF text"
    gravity_m_s2: tuple[float, float, float] = NO_CALIBRATIONS.gravity_base_m_s2


NO_ARM = Arm()


@dataclass(frozen=True)
class Material:
    """What estimators work on.

    Attributes:
        path: session or data file.
        session: None for a data file.
        channels: what was measured.
        truth: true parameters of the object, where the session was simulated.
        arm: what the channels belong to.
        unused: columns of numbers of a data file that nothing was made of.
    """

    path: Path
    session: Session | None
    channels: tuple[ChannelData, ...]
    truth: dict[str, float]
    arm: Arm
    unused: tuple[str, ...] = ()

    @property
    def probed(self) -> bool:
        """Whether an arm was to touch something."""
        return self.session is not None and STREAM_NAME in self.session.stream_names

    def described_by(self, model: str) -> tuple[ChannelData, ...]:
        """The channels that a base model describes.

        Raises:
            InputError: there is no such model, or it describes none of the channels.
        """
        kinds = MODELS[model].channels
        found = tuple(channel for channel in self.channels if channel.kind in kinds)
        if not found:
            wanted = " or ".join(_IN_WORDS[kind] for kind in sorted(kinds))
            there = ", ".join(f"{channel.name} ({channel.kind})" for channel in self.channels)
            hint = (
                "." if self.session is None or ChannelKind.CONTACT not in kinds else "; was anything touched?"
            )
            valid = [n for n in MODELS if MODELS[n].channels & {channel.kind for channel in self.channels}]
            raise InputError(
                f"{self.path}: model '{model}' describes a {wanted}, its channels are: {there}{hint} "
                f"Choose with --model: {', '.join(valid)}"
            )
        return found

    def truth_of(self, channel: ChannelData) -> Mapping[str, float]:
        """True parameters of a channel, as far as they are known: those of the object, not of the joints."""
        return self.truth if channel.kind is ChannelKind.CONTACT else {}


@dataclass(frozen=True)
class ChannelEstimates:
    """One channel with what the estimators made of it.

    Attributes:
        channel: all samples.
        rows: samples that were fitted, shape (n,).
        model: what was fitted.
        estimates: one for each estimator that could work on these samples; at least one.
        failures: why the others could not, by name.
    """

    channel: ChannelData
    rows: BoolArray
    model: Model
    estimates: tuple[Estimate, ...]
    failures: dict[str, str] = field(default_factory=dict)

    @property
    def best(self) -> Estimate:
        """The first of `BEST` that was asked for and used most of the samples, or the first of all.

        A robust method that sets many samples aside says that the model is wrong, not that they are.
        """
        by_name = {estimate.estimator: estimate for estimate in self.estimates}
        ranked = [by_name[name] for name in BEST if name in by_name]
        trusted = [estimate for estimate in ranked if np.mean(estimate.inliers) >= MOST]
        return (trusted or ranked or list(self.estimates))[0]

    def surface_of(self, estimate: Estimate) -> Surface | None:
        """The surface as this estimate has it, not below the touch; None where depth was given."""
        surface = self.channel.surface
        if surface is None:
            return None
        offset = next((p for p in estimate.parameters if p.name == OFFSET), None)
        if offset is None:
            return surface
        std_err_m = offset.std_err if np.isfinite(offset.std_err) else surface.std_err_m
        position_m = min(surface.position_m + offset.value, surface.deepest_m)
        return replace(surface, position_m=position_m, std_err_m=std_err_m)

    def prediction(self) -> FloatArray:
        """The best estimate's effort for the whole channel, shape (n,)."""
        return self.model.predict(self.channel, {p.name: p.value for p in self.best.parameters})


def load_material(path: Path, options: ImportOptions = NO_OPTIONS, *, tared: bool = False) -> Material:
    """Read a session or a data file.

    Args:
        path: either.
        options: for a data file; none for a session.
        tared: take the force in free air off that of a probing, to estimate; else leave it as it was
            measured, to look for what is wrong with it.

    Raises:
        InputError: it is neither, or cannot be used.
    """
    existing_file(path, "session or data file")
    if not is_session(path):
        imported = import_file(path, options)
        return Material(path, None, imported.channels, {}, NO_ARM, imported.unused)
    if options != NO_OPTIONS:
        raise InputError(
            f"{path}: is a session; --column, --unit, --where, --context and --fresh-runs are for data files"
        )
    session = Session.open(path)
    channels = session_channels(session, tared=tared)
    return Material(path, session, channels, true_parameters(session), arm_of(session))


def arm_of(session: Session) -> Arm:
    """The arm as the session keeps it.

    Raises:
        InputError: its copy of the robot file is not valid.
    """
    text = session.metadata.robot_file
    tip_frame = parse_robot_file(text, f"{session.path}, its robot file").tip_frame if text else ""
    calibrations = parse_calibrations(session.metadata.calibration, f"{session.path}, its calibration")
    origin = f"{session.path}, its URDF"
    return Arm(session.metadata.urdf, tip_frame, origin, calibrations.gravity_base_m_s2)


def choose_estimators(names: str) -> list[str]:
    """Names of estimators from "all" or a list with commas.

    Raises:
        InputError: one of them is not known.
    """
    if names == ALL:
        return list(ESTIMATORS)
    chosen = [name.strip() for name in names.split(",") if name.strip()]
    if not chosen:
        raise InputError(f"estimator '{names}': give names with commas between them, or {ALL}")
    if twice := {name for name in chosen if chosen.count(name) > 1}:
        raise InputError(f"estimator '{names}': {min(twice)} is there twice")
    return [ESTIMATORS[name].name for name in chosen]


def estimate_with(
    channel: ChannelData, model_name: str, estimators: Sequence[str], arm: Arm = NO_ARM
) -> ChannelEstimates:
    """Fit one model to one channel with several estimators.

    Args:
        channel: of a kind that the model describes.
        model_name: a base model.
        estimators: names.
        arm: what the channel belongs to, for models that need it.

    Raises:
        InputError: the model lacks something or has nothing to estimate, or no estimator can work.
    """
    base, context = MODELS[model_name](), context_of(channel, arm)
    model = base.build(context)
    if not model.gains:
        raise InputError(f"model '{model_name}' has no free parameter: there is nothing to estimate")
    channel = base.prepare(channel, context)
    rows = fitting_rows(channel)
    estimates, failures = [], {}
    for name in estimators:
        try:
            rng = np.random.default_rng(SEED)
            estimates.append(estimate_channel(channel, model, ESTIMATORS[name](), rng=rng, rows=rows))
        except InputError as error:
            failures[name] = str(error)
    if not estimates:
        raise InputError(next(iter(failures.values())))
    return ChannelEstimates(channel, rows, model, tuple(estimates), failures)


def context_of(channel: ChannelData, arm: Arm) -> ModelContext:
    """What a base model may need to know of a channel."""
    joint = re.fullmatch(r"joint_(\d+)", channel.name)
    return ModelContext(
        joint=int(joint[1]) - 1 if joint else None,
        urdf=arm.urdf,
        tip_frame=arm.tip_frame,
        urdf_origin=arm.origin,
        gravity_m_s2=arm.gravity_m_s2,
        surface_found=channel.surface is not None,
    )
