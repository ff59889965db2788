"""Compare a model with a measurement: size of the held-out error, and conditions in which it is large."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from palpate.control.loop.task import Phase
from palpate.estimation.budget import BudgetEntry, error_budget
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.completeness import Completeness
from palpate.estimation.diagnosis.forms import error_of_kinds
from palpate.estimation.estimate import DisplayTable, ParameterEstimate, TableDisplay, rounded, with_unit
from palpate.estimation.estimate_channel import UNPHYSICAL
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.workers import single_threaded
from palpate.robot_io.errors import InputError, UnknownNameError
from palpate.robot_io.types import BoolArray, FloatArray

_MIN_SHARE = 0.5  # least share of the error in the means of the parts for a pattern
_MIN_DIRECTION_SHARE = 0.3  # least share for a dependence on the direction alone
_GROWTH_RATIO = 2.0  # least ratio of the errors in the last and first parts for a growing error
_ONE_SIDED_SHARE = 0.7  # least share of the error in its mean for an error of one sign
_MIN_ADVANTAGE = 1.2  # least ratio by which another split must explain more
_MAX_PATTERNS = 2  # largest number of reported patterns

# Effort and phase depend on position and direction, so a pattern in these explains one in effort or phase.
_IMPLIED_BY = dict.fromkeys(("effort", "phase"), ("depth", "position", "direction"))


@dataclass(frozen=True)
class ErrorPart:
    """The error in one part of the data."""

    label: str  # such as "moving in" or "0.01 to 0.05 m/s"
    samples: int  # number of samples
    rmse: float  # root mean square of the residual
    mean: float  # mean of the residual; positive if the measurement is above the model
    energy: float  # share of the total squared error
    excess: float  # ratio of the rmse to the noise level


@dataclass(frozen=True)
class ErrorPattern:
    """A pattern in an error."""

    by: str  # split that shows the pattern
    words: str  # description, such as "changes with the direction of motion"
    share: float  # share of the error that follows the pattern

    @property
    def sentence(self) -> str:
        """The pattern as a sentence."""
        return f"The error {self.words}."


def patterns(parts: Mapping[str, Sequence[ErrorPart]], rmse: float) -> tuple[ErrorPattern, ...]:
    """Describe patterns in the parts of an error, the strongest first; empty without any.

    Args:
        parts: errors by kind of split, see `palpate.estimation.study.comparison`.
        rmse: total error [effort].
    """
    # Ratio of the mean residual to the total error; 0 if the error was not split.
    largest_split = max(parts.values(), key=lambda split: sum(part.samples for part in split), default=())
    residual_sum = sum(part.samples * part.mean for part in largest_split)
    samples = sum(part.samples for part in largest_split)
    one_sided = abs(residual_sum) / (rmse * samples) if largest_split and rmse > 0.0 else 0.0
    # Subtract the overall mean from the parts, and compute the correlation ratio of each split: root mean
    # square of the parts' means over the total error.
    centered_rmse = rmse * float(np.sqrt(1.0 - min(one_sided, 1.0) ** 2))
    varying, means = dict[str, list[ErrorPart]](), dict[str, float]()
    for by, split in parts.items():
        weights = [part.samples for part in split]
        mean = float(np.average([part.mean for part in split], weights=weights))
        sizes = [float(np.sqrt(max(part.rmse**2 + mean**2 - 2.0 * mean * part.mean, 0.0))) for part in split]
        centered = zip(split, sizes, strict=True)
        varying[by] = [replace(part, mean=part.mean - mean, rmse=size) for part, size in centered]
        spread = float(np.sqrt(np.average([part.mean**2 for part in varying[by]], weights=weights)))
        means[by] = spread / centered_rmse if centered_rmse > 0.0 else 0.0
    patterns = [
        ErrorPattern(by, words, share)
        for by, split in varying.items()
        if means[by]
        > _MIN_ADVANTAGE * max((means.get(name, 0.0) for name in _IMPLIED_BY.get(by, ())), default=-1.0)
        for words, share in _pattern_of_split(by, split, means[by])
    ]
    if one_sided > _ONE_SIDED_SHARE:
        patterns.append(ErrorPattern("all", "has one sign throughout", one_sided))
    return tuple(sorted(patterns, key=lambda pattern: -pattern.share)[:_MAX_PATTERNS])


def _pattern_of_split(by: str, parts: Sequence[ErrorPart], share: float) -> Iterator[tuple[str, float]]:
    """Yield description and strength of the patterns in one split."""
    match by:
        case "direction":
            moving = [part.mean for part in parts if part.label.startswith("moving")]
            if len(moving) == 2 and moving[0] * moving[1] < 0.0 and share > _MIN_DIRECTION_SHARE:
                yield "changes with the direction of motion", share
        case "speed":
            growth = parts[-1].rmse / parts[0].rmse if parts[0].rmse > 0.0 else np.inf
            if not 1.0 / _GROWTH_RATIO < growth < _GROWTH_RATIO:
                end = "high" if growth >= _GROWTH_RATIO else "low"
                yield f"is largest at {end} speed", _MIN_DIRECTION_SHARE
        case "run" if share > _MIN_SHARE:
            yield "differs from run to run", share
        case _ if share > _MIN_SHARE:
            known = by in {"depth", "position", "phase", "effort", "load"}
            yield f"varies with {'the ' if known else ''}{by}", share


_BINS = 4


def splits(data: ChannelData) -> dict[str, dict[str, BoolArray]]:
    """Return masks (n,) of the parts of each split of the samples, by label, if it has at least two parts.

    Args:
        data: the channel.
    """
    known = {int(phase): phase.name.lower().replace("_", " ") for phase in Phase}
    phases = {known[p]: data.phase == p for p in np.unique(data.phase).tolist() if p in known}
    slow = 0.02 * (float(np.quantile(np.abs(data.velocity), 0.95)) or 1.0)
    position_name, inwards, outwards = "position", "moving forwards", "moving backwards"
    if data.kind is ChannelKind.CONTACT:
        position_name, inwards, outwards = "depth", "moving in", "moving out"
    directions = {
        inwards: data.velocity > slow,
        outwards: data.velocity < -slow,
        "at rest": np.abs(data.velocity) <= slow,
    }
    unit, effort_unit, pressed = data.position_unit, data.effort_unit, data.engaged
    masks_by = {
        "phase": phases,
        "run": {f"run {run}": data.run == run for run in data.runs},
        "direction": directions,
        "speed": _bins(np.abs(data.velocity), f"{unit}/s", pressed),
        position_name: _bins(data.position, unit, pressed),
        "effort": _bins(data.effort, effort_unit, pressed),
    }
    if "load" in data.context:
        masks_by["load"] = _bins(np.abs(data.context["load"]), effort_unit, pressed)
    for name in sorted(data.recorded):
        by = f"recorded {name}" if name in masks_by else name
        masks_by[by] = _bins(data.context[name], "", pressed)
    for by, masks in masks_by.items():
        masks_by[by] = {name: mask for name, mask in masks.items() if mask.any()}
    return {by: masks for by, masks in masks_by.items() if len(masks) > 1}


def _bins(signal: FloatArray, unit: str, engaged: BoolArray) -> dict[str, BoolArray]:
    """Return masks of bins with equal width over all but the outermost samples, for engaged samples."""
    if not engaged.any():
        return {}
    low, high = np.quantile(signal[engaged], [0.005, 0.995])
    low = 0.0 if 0.0 < low < 0.02 * high else low
    if not high > low:
        return {}
    edges = np.linspace(low, high, _BINS + 1)
    bin_index = np.digitize(signal, edges[1:-1])
    labels = [f"{rounded(low)} to {with_unit(high, unit)}".strip() for low, high in pairwise(edges)]
    return {label: (bin_index == i) & engaged for i, label in enumerate(labels)}


AT_NOISE = 1.1  # ratio to the noise below which an error is within the noise
# Text for an error above the noise if no test shows a missing effect.
MAY_BE_NOISE = (
    "but neither a flexible regression nor the residual checks show a missing effect. The noise may be "
    "larger than estimated, or the measured motion may have errors"
)
EXPLAINS_LITTLE = "but the model explains so little of the effort that these data cannot show whether it fits"
ROUNDING = "numerical rounding"  # the error of an exact model
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
    # Whether the error is within the noise, or up to `FAR` times it without a sign of a missing effect.
    is_complete: bool
    # Errors by kind of split (phase, run, direction, speed, depth or position, effort, load).
    parts: Mapping[str, tuple[ErrorPart, ...]]
    words: tuple[str, ...]  # sentences on size and distribution of the error, and the kinds that explain it
    patterns: tuple[ErrorPattern, ...] = ()  # patterns in the parts of the error; empty if it is complete
    # Kinds whose flexible laws explain the error, the largest share first; empty if it is complete.
    kinds: tuple[BudgetEntry, ...] = ()
    # Whether it counts as complete only because its whole error may be noise, which is only bounded.
    may_be_noise: bool = False

    @property
    def rmse(self) -> float:
        """Error in held-out runs."""
        return self.fitted.rmse

    @property
    def lack_of_fit(self) -> float:
        """Ratio of the error to the noise: about 1 if no effect is missing."""
        return self.rmse / self.noise.value if self.noise.value > 0.0 else float("inf")

    @property
    def fits(self) -> bool:
        """Whether no missing effect shows, see `is_complete`, and all parameters are physically possible."""
        return self.is_complete and not self.fitted.unphysical

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
        fitted_runs = "" if self.fitted.validation is None else "the runs of the fit, "
        is_contact = self.fitted.data.kind is ChannelKind.CONTACT
        reasons = (
            "contact boundaries, sharp corners and stops of the motion"
            if is_contact
            else "joints at rest, stops"
        )
        return (
            f"{count:,} of {whole:,} samples ({100 * count / whole:.1f} %) are excluded from scoring: "
            f"{fitted_runs}{reasons}, starts and ends of runs, invalid readings."
        )

    def _table(self) -> DisplayTable:
        rows = [
            (by, part.label, rounded(part.rmse), f"{part.mean:+.2g}", f"{part.excess:.1f}")
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


def compare(fitted: FitResult, base: FitResult, model: str, noise: MeasurementNoise) -> Comparison:
    """Compare a fitted model with the measurement, and split the error.

    The completeness test uses the runs of the fit. It says nothing on other runs that are only scored.

    Args:
        fitted: the fitted model.
        base: the base model, to which effects may have been added.
        model: name of the model, with the added effects.
        noise: noise of the channel.
    """
    data, unit = fitted.data, fitted.data.effort_unit
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
    within_noise = fitted.rmse < AT_NOISE * noise.value or fitted.is_exact
    is_complete, may_be_noise, kinds = within_noise, False, tuple[BudgetEntry, ...]()
    with single_threaded():
        # An upper bound of the noise does not show that nothing is missing.
        is_tested = noise.is_bound if within_noise else fitted.rmse <= FAR * noise.value
        if is_tested and fitted.validation is None and not fitted.is_exact:
            checks = Completeness(base.training_fit, np.random.default_rng(0))
            may_be_noise = within_noise and checks.explains_little(fitted)
            is_complete = may_be_noise or checks.is_complete(fitted) or checks.leaves_smoothing(fitted)
        if not is_complete:  # find the kinds whose flexible laws explain the held-out error
            error = error_of_kinds(fitted.training_fit)
            kinds = error_budget(error, np.random.default_rng(0)).entries
    found_patterns = () if is_complete else patterns(parts, fitted.rmse)
    first, *where = _words(fitted.rmse, noise, {} if is_complete else parts, unit)
    if within_noise and not is_complete:
        first = f"{first[:-1]}, but a test shows that part of this error is not noise."
    elif may_be_noise:
        first = f"{first[:-1]}, {EXPLAINS_LITTLE}."
    elif fitted.is_exact:
        first = f"The error of {with_unit(fitted.rmse, unit)} is {ROUNDING}."
    elif is_complete and not within_noise:
        first = f"{first[:-1]}, {MAY_BE_NOISE}."
    if fitted.unphysical:
        first = f"{first} But {', '.join(fitted.unphysical)}: {UNPHYSICAL}."
    words = [first, *where, *(pattern.sentence for pattern in found_patterns), *_describe_kinds(kinds)]
    noise = noise.below(fitted.rmse)
    return Comparison(
        data.name,
        unit,
        model,
        fitted,
        noise,
        is_complete,
        parts,
        tuple(words),
        found_patterns,
        kinds,
        may_be_noise,
    )


def _describe_kinds(kinds: Sequence[BudgetEntry]) -> Iterator[str]:
    """State which kinds of effects would explain the error, if any."""
    shares = []
    for entry in kinds:
        replacing = " or ".join(kind.word for kind in entry.replaceable_by)
        share = f"{entry.kind.word} {100 * entry.share:.0f} %"
        shares.append(f"{share} (or {replacing})" if replacing else share)
    if shares:
        listed = ", ".join(shares)
        yield (
            "Kinds of effects that would explain the error, with their shares of the squared error: "
            f"{listed}."
        )


def _words(
    error: float, noise: MeasurementNoise, parts: Mapping[str, tuple[ErrorPart, ...]], unit: str
) -> tuple[str, ...]:
    """Describe the total error, then the splits in which it is most uneven."""
    level = noise.describe(unit)
    if error < AT_NOISE * noise.value:
        return (f"The error of {with_unit(error, unit)} is within the noise ({level}).",)
    times = error / noise.value if noise.value > 0.0 else float("inf")
    at_least = "at least " * noise.is_bound
    sentences = [f"The error of {with_unit(error, unit)} is {at_least}{times:.1f} times the noise ({level})."]
    for by in sorted(parts, key=lambda by: -_contrast(parts[by]))[:_MAX_SPLITS]:
        worst, least = (pick(parts[by], key=lambda part: part.rmse) for pick in (max, min))
        if worst.rmse <= (1.0 + SMALL) * least.rmse:  # all errors are equally large: compare their means
            high, low = (pick(parts[by], key=lambda part: part.mean) for pick in (max, min))
            sentences.append(
                f"The error has the same size at any {by}; on average, measured minus modeled is "
                f"{high.mean:+.3g} {unit} ({high.label}) and {low.mean:+.3g} {unit} ({low.label})."
            )
            continue
        largest = f"By {by}, the largest error is {with_unit(worst.rmse, unit)} ({worst.label})"
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
