"""Runs estimators over the channels of a session or data file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.data.channels import is_session, load_channels, session_channels
from estimation.data.import_options import ImportOptions
from estimation.effects.contact_offset import ContactOffset
from estimation.estimate import Estimate
from estimation.estimate_channel import estimate_channel, fitting_rows
from estimation.estimators import ESTIMATORS
from estimation.model import Model
from estimation.models import MODELS
from estimation.surface import Surface
from palpate.files import existing_file
from palpate.truth import true_parameters
from robot_io.errors import InputError
from robot_io.session import Session
from robot_io.types import BoolArray, FloatArray

BEST = ("robust", "weighted", "lsq")  # whose estimate is shown where there is room for one
MOST = 0.8  # of the samples
ALL = "all"
SEED = 1  # of the random choices of RANSAC
OFFSET = "contact_offset.offset"
DEFAULT_MODEL = "kelvin_voigt"
NO_OPTIONS = ImportOptions()


@dataclass(frozen=True)
class Material:
    """What estimators work on.

    Attributes:
        path: session or data file.
        session: None for a data file.
        channels: what was measured.
        truth: true parameters, where the session was simulated.
    """

    path: Path
    session: Session | None
    channels: tuple[ChannelData, ...]
    truth: dict[str, float]

    def contacts(self) -> tuple[ChannelData, ...]:
        """The channels that are contacts.

        Raises:
            InputError: there are none.
        """
        found = tuple(channel for channel in self.channels if channel.kind is ChannelKind.CONTACT)
        if not found:
            names = ", ".join(channel.name for channel in self.channels)
            raise InputError(f"{self.path}: nothing was touched; its channels are {names}")
        return found


@dataclass(frozen=True)
class ChannelEstimates:
    """One channel with what the estimators made of it.

    Attributes:
        channel: all samples.
        rows: samples that were fitted, shape (n,).
        model: what was fitted.
        estimates: one for each estimator.
    """

    channel: ChannelData
    rows: BoolArray
    model: Model
    estimates: tuple[Estimate, ...]

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
        """The surface as this estimate has it; None where the channel's depth was given."""
        surface = self.channel.surface
        if surface is None:
            return None
        offset = next((p for p in estimate.parameters if p.name == OFFSET), None)
        if offset is None:
            return surface
        return Surface(surface.position_m + offset.value, offset.std_err)

    def prediction(self) -> FloatArray:
        """The best estimate's effort for the whole channel, shape (n,)."""
        return self.model.predict(self.channel, {p.name: p.value for p in self.best.parameters})


def load_material(path: Path, options: ImportOptions = NO_OPTIONS) -> Material:
    """Read a session or a data file.

    Raises:
        InputError: it is neither, or cannot be used.
    """
    existing_file(path, "session or data file")
    if not is_session(path):
        return Material(path, None, load_channels(path, options), {})
    session = Session.open(path)
    return Material(path, session, session_channels(session), true_parameters(session))


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
    return [ESTIMATORS[name].name for name in chosen]


def estimate_contact(channel: ChannelData, model_name: str, estimators: Sequence[str]) -> ChannelEstimates:
    """Fit one model to one contact with several estimators.

    Where the surface was found in the same data it is estimated along, so that the intervals say what not
    knowing it costs.

    Raises:
        InputError: the model does not describe a contact, or there are too few samples.
    """
    model = _contact_model(model_name, surface_is_known=channel.surface is None)
    rows = fitting_rows(channel)
    estimates = tuple(
        estimate_channel(channel, model, ESTIMATORS[name](), rng=np.random.default_rng(SEED), rows=rows)
        for name in estimators
    )
    return ChannelEstimates(channel, rows, model, estimates)


def _contact_model(name: str, *, surface_is_known: bool) -> Model:
    base = MODELS[name]()
    if ChannelKind.CONTACT not in base.channels:
        valid = ", ".join(n for n, other in MODELS.items() if ChannelKind.CONTACT in other.channels)
        raise InputError(f"model '{name}' does not describe a contact. Valid: {valid}")
    model = base.build(ModelContext())
    return model if surface_is_known else model.with_effect(ContactOffset())
