"""Compare a model with a measurement: size of the held-out error, and conditions in which it is large."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.estimation.budget import BudgetEntry, error_budget
from palpate.estimation.channel import ChannelKind
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.forms import error_of_kinds
from palpate.estimation.estimate import DisplayTable, ParameterEstimate, TableDisplay, with_unit
from palpate.estimation.estimate_channel import UNPHYSICAL
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.study.patterns import ErrorPart, ErrorPattern, patterns, splits
from palpate.estimation.workers import single_threaded
from palpate.robot_io.errors import InputError, UnknownNameError
from palpate.robot_io.types import BoolArray

AT_NOISE = 1.1  # ratio to the noise below which an error is within the noise
FAR = 3.0  # ratio to the noise above which a model is far off
_MAX_SPLITS = 3  # largest number of splits that are described
_MIN_MEAN_SHARE = 0.1  # mean relative to a part's error below which it is not described


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(TableDisplay):
    """Comparison of a fitted model with a measurement."""

    channel: str  # name of the channel
    effort_unit: str  # unit of all errors
    model: str  # name of the model, with the added effects
    fitted: FitResult  # the fitted model, whose residual is held out
    noise: MeasurementNoise  # noise of the channel, independent of the model
    # Errors by kind of split (phase, run, direction, speed, depth or position, effort, load).
    parts: Mapping[str, tuple[ErrorPart, ...]]
    words: tuple[str, ...]  # sentences on size and distribution of the error, and the kinds that explain it
    patterns: tuple[ErrorPattern, ...] = ()  # patterns in the parts of the error; empty if it is noise
    # Kinds whose flexible laws explain the error, the largest share first; empty if it is noise.
    kinds: tuple[BudgetEntry, ...] = ()

    @property
    def rmse(self) -> float:
        """Error in held-out runs."""
        return self.fitted.rmse

    @property
    def lack_of_fit(self) -> float:
        """Ratio of the error to the noise: about 1 if no effect is missing."""
        return self.rmse / self.noise.value if self.noise.value > 0.0 else float("inf")

    @property
    def parameters(self) -> Mapping[str, ParameterEstimate]:
        """Parameters by "effect.parameter"."""
        return self.fitted.parameters

    @property
    def scored(self) -> BoolArray:
        """Mask of the scored samples, shape (n,)."""
        return self.fitted.scored

    @property
    def exclusion_note(self) -> str:
        """Sentence on the samples excluded from the error; empty if there are none."""
        count, whole = int(np.count_nonzero(~self.scored)), len(self.scored)
        if not count:
            return ""
        is_contact = self.fitted.data.kind is ChannelKind.CONTACT
        reasons = "contact boundaries, sharp corners of the motion" if is_contact else "joints at rest"
        return (
            f"{count:,} of {whole:,} samples ({100 * count / whole:.1f} %) are excluded from scoring: "
            f"{reasons}, starts and ends of runs, invalid readings."
        )

    def _table(self) -> DisplayTable:
        rows = [
            (by, part.label, f"{part.rmse:.3g}", f"{part.mean:+.2g}", f"{part.excess:.1f}")
            for by, parts in self.parts.items()
            for part in parts
        ]
        unit = self.effort_unit
        caption = f"Model {self.model} of {self.channel}. {' '.join(self.words[:1])} {self.exclusion_note}"
        return DisplayTable(caption, ("by", "where", f"rmse [{unit}]", f"mean [{unit}]", "x noise"), rows)


@dataclass(frozen=True, repr=False)
class Comparisons(TableDisplay):
    """Comparisons of the channels of a study with their models."""

    channels: tuple[Comparison, ...]  # one comparison for each channel that can be fitted
    failures: Mapping[str, str]  # reasons why other channels cannot be fitted, by name

    def __getitem__(self, channel: str) -> Comparison:
        """Return the comparison of one channel.

        Raises:
            InputError: there is no such channel, or it cannot be fitted.
        """
        if channel in self.failures:
            raise InputError(self.failures[channel])
        by_name = {channel.channel: channel for channel in self.channels}
        if channel not in by_name:
            raise UnknownNameError(f"no channel '{channel}' is compared. Available: {', '.join(by_name)}")
        return by_name[channel]

    def _table(self) -> DisplayTable:
        rows = [
            (
                channel.channel,
                channel.model,
                with_unit(channel.rmse, channel.effort_unit),
                f"{channel.lack_of_fit:.2f}",
                channel.exclusion_note,
            )
            for channel in self.channels
        ]
        rows += [(name, "", "", "", why) for name, why in self.failures.items()]
        columns = ("channel", "model", "held-out error", "x noise", "excluded")
        return DisplayTable("Models compared with the measurement", columns, rows)


def compare(fitted: FitResult, model: str, noise: MeasurementNoise) -> Comparison:
    """Compare a fitted model with the measurement, and split the error.

    Args:
        fitted: the fitted model.
        model: name of the model, with the added effects.
        noise: noise of the channel.
    """
    data, unit = fitted.data, fitted.data.kind.effort_unit
    # Compute the error for each split that has more than one part with samples.
    parts = {}
    for by, masks in splits(fitted.data).items():
        occupied = list[ErrorPart]()
        for label, mask in masks.items():
            residuals = fitted.residual[mask & fitted.scored]
            if len(residuals):
                size = float(np.sqrt(np.mean(residuals**2)))
                energy = float(np.sum(residuals**2) / np.nansum(fitted.residual**2))
                excess = size / noise.value if noise.value > 0.0 else float("inf")
                occupied.append(
                    ErrorPart(label, len(residuals), size, float(residuals.mean()), energy, excess)
                )
        if len(occupied) > 1:
            parts[by] = tuple(occupied)
    is_noise = fitted.rmse < AT_NOISE * noise.value
    found_patterns = () if is_noise else patterns(parts, fitted.rmse)
    kinds: tuple[BudgetEntry, ...] = ()
    if not is_noise:  # find the kinds whose flexible laws explain the held-out error
        with single_threaded():
            kinds = error_budget(error_of_kinds(fitted.training_fit), np.random.default_rng(0)).entries
    first, *where = _words(fitted.rmse, noise, parts, unit)
    if fitted.unphysical:
        first = f"{first} But {', '.join(fitted.unphysical)}: {UNPHYSICAL}."
    words = [first, *where, *(pattern.sentence for pattern in found_patterns)]
    if kinds:
        shares = []
        for entry in kinds:
            replacing = " or ".join(kind.word for kind in entry.replaceable_by)
            share = f"{entry.kind.word} {100 * entry.share:.0f} %"
            shares.append(f"{share} (or {replacing})" if replacing else share)
        listed = ", ".join(shares)
        words.append(f"Kinds of effects that would explain it, as shares of the squared error: {listed}.")
    return Comparison(data.name, unit, model, fitted, noise, parts, tuple(words), found_patterns, kinds)


def _words(
    error: float, noise: MeasurementNoise, parts: Mapping[str, tuple[ErrorPart, ...]], unit: str
) -> tuple[str, ...]:
    """Describe the total error, then the splits in which it is most uneven."""
    level = noise.describe(unit)
    if error < AT_NOISE * noise.value:
        return (f"The error of {with_unit(error, unit)} is within the noise ({level}).",)
    times = error / noise.value if noise.value > 0.0 else float("inf")
    sentences = [f"The error of {with_unit(error, unit)} is {times:.1f} times the noise ({level})."]
    for by in sorted(parts, key=lambda by: -_contrast(parts[by]))[:_MAX_SPLITS]:
        worst, least = (pick(parts[by], key=lambda part: part.rmse) for pick in (max, min))
        if worst.rmse <= (1.0 + SMALL) * least.rmse:  # all errors are equally large: compare their means
            high, low = (pick(parts[by], key=lambda part: part.mean) for pick in (max, min))
            sentences.append(
                f"It has the same size at any {by}; measured minus modeled is on average "
                f"{high.mean:+.3g} {unit} ({high.label}), {low.mean:+.3g} {unit} ({low.label})."
            )
            continue
        largest = f"By {by}, the error is largest for {worst.label}: {with_unit(worst.rmse, unit)}"
        if abs(worst.mean) > _MIN_MEAN_SHARE * worst.rmse:
            side = "above" if worst.mean > 0.0 else "below"
            largest += f"; the measurement is {with_unit(abs(worst.mean), unit)} {side} the model on average"
        sentences.append(f"{largest}.")
    return tuple(sentences)


def _contrast(parts: tuple[ErrorPart, ...]) -> float:
    """Return a measure of how unevenly the error is distributed over the parts."""
    sizes = np.array([part.rmse for part in parts])
    means = np.array([part.mean for part in parts])
    total = float(np.sqrt(np.mean(sizes**2))) or 1.0
    return float((np.std(sizes) + np.std(means)) / total)
