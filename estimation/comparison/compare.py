"""Model against measurement: how large the error is, where it is, and where the model fails first."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel import ChannelData
from estimation.comparison.split import splits
from estimation.diagnosis.judgement.noise_floor import NoiseFloor, noise_floor
from estimation.diagnosis.judgement.objection import floor_unseen
from estimation.fit.held_out import held_out_residual, rmse
from estimation.fit.standing import Standing
from estimation.fit.unexplained import is_explained
from estimation.model import Model
from estimation.revision import standings
from robot_io.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Part:
    """The error in one part of the data.

    Attributes:
        label: such as "moving in" or "0.01 to 0.05 m/s".
        samples: how many.
        rmse: root mean square of the residual.
        mean: mean of the residual; positive where the measurement is above the model.
        energy: share of the whole squared error.
        excess: rmse over the noise floor.
    """

    label: str
    samples: int
    rmse: float
    mean: float
    energy: float
    excess: float


@dataclass(frozen=True)
class Comparison:
    """A model beside a measurement.

    Attributes:
        channel: its name.
        effort_unit: unit of all errors.
        model: its name.
        parameters: by "effect.parameter".
        predicted: effort that the model expects, shape (n,).
        residual: effort less prediction, each run predicted from gains fitted to the others, shape (n,); NaN
            where a sample was left out (the end of a block, the border of a contact, a glitch).
        rmse: of that residual.
        floor: the error that a complete model would leave.
        parts: by way of splitting (phase, run, direction, speed, depth or position, effort, load).
        words: where the model fails first, in sentences.
    """

    channel: str
    effort_unit: str
    model: str
    parameters: Mapping[str, float]
    predicted: FloatArray
    residual: FloatArray
    rmse: float
    floor: NoiseFloor
    parts: Mapping[str, tuple[Part, ...]]
    words: tuple[str, ...]

    @property
    def lack_of_fit(self) -> float:
        """Error over noise floor: 1 where nothing is missing."""
        return self.rmse / self.floor.value if self.floor.value > 0.0 else float("inf")


def compare(data: ChannelData, model: Model, known_floor: float = np.inf) -> Comparison:
    """Fit a model and compare it with the measurement, on runs that the fit has not seen.

    What a flexible regression cannot explain is noise at most, and so is what does not return when a motion
    is repeated, and what a fuller model is known to leave. The floor is the smallest of them and of
    `floor_unseen` (runs that follow different laws, a rest in contact that is no noise).

    Args:
        data: the measurement.
        model: the model.
        known_floor: that of a fuller model, in the unit of the effort.

    Raises:
        InputError: the channel cannot be judged; the reason is in the message.
    """
    (standing,) = standings(data, model, ())
    return compare_standing(standing, known_floor)


def compare_standing(standing: Standing, known_floor: float = np.inf) -> Comparison:
    """Compare a model that is fitted already, with or without effects added to it; see `compare`."""
    data, model = standing.data, standing.trial.model
    residual = held_out_residual(standing.plain.frame, standing.trial)
    own = noise_floor(standing)
    unseen = floor_unseen(standing, own.value)
    explained = is_explained(standing) and not np.isfinite(unseen)
    floor = replace(own, value=min(own.value, own.repeats or np.inf, unseen, known_floor))
    parts = _parts(data, residual, floor.value)
    return Comparison(
        channel=data.name,
        effort_unit=data.kind.effort_unit,
        model=model.name,
        parameters=standing.trial.parameters,
        predicted=model.predict(data, standing.trial.parameters),
        residual=residual,
        rmse=rmse(residual),
        floor=floor,
        parts=parts,
        words=_words(rmse(residual), floor, parts, data.kind.effort_unit, explained=explained),
    )


def _parts(data: ChannelData, residual: FloatArray, floor: float) -> dict[str, tuple[Part, ...]]:
    """The error by each way of splitting that leaves more than one part with samples."""
    found = {}
    for by, masks in splits(data).items():
        every = (_part(label, residual, mask, floor) for label, mask in masks.items())
        told = tuple(part for part in every if part.samples)
        if len(told) > 1:
            found[by] = told
    return found


def _part(label: str, residual: FloatArray, mask: BoolArray, floor: float) -> Part:
    own = residual[mask & np.isfinite(residual)]
    if not len(own):
        return Part(label, 0, 0.0, 0.0, 0.0, 0.0)
    size = float(np.sqrt(np.mean(own**2)))
    energy = float(np.sum(own**2) / np.nansum(residual**2))
    return Part(
        label, len(own), size, float(own.mean()), energy, size / floor if floor > 0.0 else float("inf")
    )


def _words(
    error: float, floor: NoiseFloor, parts: Mapping[str, tuple[Part, ...]], unit: str, *, explained: bool
) -> tuple[str, ...]:
    """The overall judgement, then the splits that tell most, the most telling first."""
    times = error / floor.value if floor.value > 0.0 else float("inf")
    if explained:
        return (f"The error of {error:.3g} {unit} is noise: nothing smooth is left in it.",)
    said = [
        f"The error of {error:.3g} {unit} is {times:.1f} times the noise floor of {floor.value:.3g} {unit}."
    ]
    ordered = sorted(parts, key=lambda by: -_contrast(parts[by]))
    for by in ordered[:3]:
        worst = max(parts[by], key=lambda part: part.rmse)
        side = "above" if worst.mean > 0.0 else "below"
        said.append(
            f"By {by}, it is largest at {worst.label}: {worst.rmse:.3g} {unit}, the measurement "
            f"{abs(worst.mean):.3g} {unit} {side} the model on average."
        )
    return tuple(said)


def _contrast(parts: tuple[Part, ...]) -> float:
    """How unevenly the error is spread over the parts."""
    sizes = np.array([part.rmse for part in parts])
    means = np.array([part.mean for part in parts])
    whole = float(np.sqrt(np.mean(sizes**2))) or 1.0
    return float((np.std(sizes) + np.std(means)) / whole)
