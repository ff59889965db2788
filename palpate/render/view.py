"""Views of a model and its measurement, as arrays and text, from which every medium is drawn.

Positions and velocities are in display units (mm for lengths); efforts and errors are in SI units.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.estimation.design.next_experiment import NextExperiment
from palpate.estimation.diagnosis.result import AcceptedEffect, RankedEffect
from palpate.estimation.effect import Effect
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.study.comparison import ErrorPart
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

RANGE = "alone or added last"  # header of `BudgetPart.range_text`
RANGE_MEANING = (
    "The range of a share has two ends: the share that the kind explains alone, and the share that it adds "
    "to all other kinds. The smaller comes first."
)
# What the words for a form in a budget mean, as sentences; in the order in which they are explained.
FORM_MEANINGS = {
    "exact": "Exact: with this effect, the model leaves only noise, no other law fits as well, and a "
    "deviation of 5 % from the law would show.",
    "approximate": (
        "Approximate: the effect explains most of the error that any law of its kind can explain, but its "
        "equation may differ from the true one."
    ),
    "unknown": "Unknown: the kind is known, but no effect explains enough of the kind's share.",
}
_MANY_TIMES = 1000  # largest multiple of the noise level that is stated
NOISE = 1.1  # multiple of the noise level below which an error is within the noise
_MOST_PARTS = 8


@dataclass(frozen=True)
class AxisLabels:
    """Names of a channel's quantities with units, and the effort's unit."""

    effort: str
    effort_unit: str
    position: str
    velocity: str

    @property
    def residual(self) -> str:
        """Title of an axis of residuals."""
        return f"measured − model [{self.effort_unit}]"

    @property
    def heading(self) -> str:
        """Heading of the curves of effort over position."""
        effort, position = (title.partition(" [")[0] for title in (self.effort, self.position))
        return f"{effort} over {position}".capitalize()


@dataclass(frozen=True)
class StageView:
    """One stage of a model."""

    number: int | None  # number of its revision; None if it was not saved
    label: str  # the base model's name, or "+ " with the effect that was added
    name: str  # the whole model, such as "kelvin_voigt + cubic_stiffness"
    rmse: float  # error in held-out runs, in the effort's unit
    predicted: FloatArray  # predicted effort, shape (n,)
    # Measured minus predicted from the other runs, shape (n,); NaN for samples excluded from scoring.
    residual: FloatArray
    parameters: tuple[ParameterEstimate, ...]  # in the order of the model
    effects: tuple[Effect, ...]  # the terms of the model
    equation: str  # all terms in one line
    unphysical: tuple[str, ...] = ()  # descriptions of gains outside their physical bounds


@dataclass(frozen=True)
class VerdictView:
    """The verdict on one channel."""

    word: str  # adequate, missing, unexplained or insufficient; after a comparison, fits or misses; or empty
    sentence: str  # sentence on this channel
    remarks: tuple[str, ...] = ()  # further sentences
    names: tuple[str, ...] = ()  # effects in the sentence, to be set in bold

    @property
    def tag(self) -> str:
        """Word before the sentence; empty if the sentence contains it."""
        return "" if self.word in {"fits", "misses"} else self.word.upper()


@dataclass(frozen=True)
class BudgetPart:
    """One part of the base model's error, as shares of its mean square in held-out runs."""

    word: str  # the kind's short name, "noise" or "unexplained"
    share: float
    color: str
    bound: str = ""  # "at most" or "at least" if the share is only bounded
    interval: tuple[float, float] | None = None  # 95 % interval over runs
    necessary: float | None = None  # share lost without this kind; None for noise and unexplained
    sufficient: float | None = None  # share explained by this kind alone
    form: str = ""  # exact, approximate or unknown
    effects: tuple[str, ...] = ()  # accepted effects, or for an unknown form the closest ones

    @property
    def share_text(self) -> str:
        """The share with its bound, such as "at most 4 %"."""
        return f"{self.bound} {percent(self.share, bound=self.bound)}".strip()

    @property
    def range(self) -> tuple[float, float] | None:
        """Necessary and sufficient share, the smaller first; None for noise and unexplained."""
        if self.necessary is None or self.sufficient is None:
            return None
        return min(self.necessary, self.sufficient), max(self.necessary, self.sufficient)

    @property
    def range_text(self) -> str:
        """`range` in percent, under the header `RANGE`; empty for noise and unexplained."""
        ends = dict.fromkeys(f"{100 * end:.0f}" for end in self.range or ())
        return f"{' to '.join(ends)} %" if ends else ""

    @property
    def effects_text(self) -> str:
        """Names of the effects; effects that are only the closest in form are marked."""
        return ("closest: " if self.form == "unknown" and self.effects else "") + ", ".join(self.effects)


@dataclass(frozen=True)
class BudgetView:
    """Shares of the base model's error by kind of effect, noise, and unexplained."""

    sentence: str  # the shares in words
    parts: tuple[BudgetPart, ...]  # kinds with the largest share first, then noise and unexplained
    # Sentences on indistinguishable kinds, each with the experiment that separates them.
    confusions: tuple[str, ...] = ()

    @property
    def form_meanings(self) -> tuple[str, ...]:
        """Explanations of the words for forms that occur, one sentence each."""
        forms = {part.form for part in self.parts}
        return tuple(text for form, text in FORM_MEANINGS.items() if form in forms)


def percent(share: float, *, bound: str = "") -> str:
    """Format a share of the whole in percent, with few digits.

    Args:
        share: share of the whole, 0 to 1.
        bound: "at most" or "at least" if the share is only bounded.
    """
    if 0.0 < share < 0.005:
        return "1 %" if bound == "at most" else "under 1 %"
    return f"{100 * share:z.0f} %"


@dataclass(frozen=True)
class ChannelView:
    """One channel: measurement, stages of its model, and findings."""

    name: str  # such as "contact"
    axes: AxisLabels  # names and units
    time_s: FloatArray  # time with the runs one after the other, shape (n,) [s]
    position: FloatArray  # position in display units, shape (n,)
    velocity: FloatArray  # velocity in display units, shape (n,)
    effort: FloatArray  # as measured, shape (n,)
    run: IntArray  # number of the run, shape (n,)
    engaged: BoolArray  # samples in contact, shape (n,)
    scored: BoolArray  # samples whose error counts, shape (n,); the others are shaded
    speeds: Mapping[int, str]  # description of each run's speed, by run number
    stages: tuple[StageView, ...]  # base model first; empty if the data cannot be judged
    error_steps: tuple[tuple[str, float], ...]  # label and error of each stage
    parameters: tuple[ParameterEstimate, ...]  # of the last stage
    noise_level: float  # error of a complete model, 0 if unknown
    noise_is_bound: bool  # whether the noise may be smaller
    noise_text: str  # the noise with its source, in words
    verdict: VerdictView  # verdict on the channel
    budget: BudgetView | None = None  # budget of the base model's error; None without a diagnosis
    # The last model's error by phase, run, speed and so on.
    parts: Mapping[str, Sequence[ErrorPart]] = field(default_factory=dict)
    accepted: tuple[AcceptedEffect, ...] = ()  # accepted effects
    ranking: tuple[RankedEffect, ...] = ()  # candidates that improve the base model, best first
    next_experiment: NextExperiment | None = None  # what to record next; None for nothing
    # Commanded or reference effort, shape (n,), with its name; None if unknown.
    commanded: tuple[str, FloatArray] | None = None

    @property
    def noise_label(self) -> str:
        """Label of the noise in tables and charts."""
        return "noise at most" if self.noise_is_bound else "noise level"

    def times_noise(self, error: float) -> float:
        """Return an error divided by the noise level.

        Args:
            error: error in the effort's unit.
        """
        return error / self.noise_level if self.noise_level > 0.0 else float("inf")

    def times_noise_text(self, error: float, decimals: int = 2) -> str:
        """Return `times_noise` as text, "≥ ..." if only an upper bound of the noise is known.

        Args:
            error: error in the effort's unit.
            decimals: number of decimals.
        """
        times = self.times_noise(error)
        if times > _MANY_TIMES:
            return f"> {_MANY_TIMES}"
        return f"{'≥ ' * self.noise_is_bound}{times:.{decimals}f}"

    def parts_by(self) -> Iterator[tuple[str, Sequence[ErrorPart]]]:
        """Yield each kind's name and parts; if there are very many parts, such as runs, only the worst."""
        for kind, parts in self.parts.items():
            if len(parts) > _MOST_PARTS:
                worst = sorted(parts, key=lambda part: -part.rmse)[: _MOST_PARTS - 2]
                yield f"{kind}, worst {len(worst)} of {len(parts)}", [p for p in parts if p in worst]
            else:
                yield kind, parts

    @property
    def shown_stages(self) -> tuple[StageView, ...]:
        """First and last stage, which curves and maps compare; only one if nothing was added."""
        return self.stages if len(self.stages) < 2 else (self.stages[0], self.stages[-1])


@dataclass(frozen=True)
class StudyView:
    """All channels of a file with its origin, and the commands that repeat the results."""

    file: str
    channels: tuple[ChannelView, ...]
    facts: Mapping[str, str] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # how a data file was read, in sentences


@dataclass(frozen=True)
class ResidualMap:
    """Mean residual over the state: cell centers (p,) and (v,), mean (v, p), NaN with too few samples."""

    position: FloatArray
    velocity: FloatArray
    mean: FloatArray


# Cells per axis; fewest samples of a mean; blocks of cells that are averaged otherwise (velocity, position).
_CELLS, _LEAST, _BLOCKS = 36, 3, ((3, 12), (3, 4), (1, 4), (1, 1))


def residual_map(
    position: FloatArray, velocity: FloatArray, residual: FloatArray, used: BoolArray
) -> ResidualMap:
    """Average a residual (n,) over position and velocity, for the samples in `used`.

    A cell with one or two samples, as in fast motion, has the mean of the smallest block of a fixed grid that
    contains it and three samples. It is NaN if the largest block has fewer, or if the cell is empty.

    Args:
        position: shape (n,).
        velocity: shape (n,).
        residual: shape (n,).
        used: samples that count, shape (n,).
    """
    used = used & np.isfinite(residual)
    velocity, position = velocity[used], position[used]
    edges = [_edges(velocity), _edges(position)]
    sums = np.stack([np.histogram2d(velocity, position, edges, weights=w)[0] for w in (None, residual[used])])
    mean = np.full(sums[0].shape, np.nan)
    for high, wide in _BLOCKS:
        blocks = sums.reshape(2, _CELLS // high, high, _CELLS // wide, wide).sum(axis=(2, 4))
        counts, totals = blocks.repeat(high, axis=1).repeat(wide, axis=2)
        mean = np.where((sums[0] > 0) & (counts >= _LEAST), totals / np.maximum(counts, 1), mean)
    centers = [(edge[1:] + edge[:-1]) / 2 for edge in edges]
    return ResidualMap(centers[1], centers[0], mean)


def _edges(values: FloatArray) -> FloatArray:
    if not len(values):
        return np.linspace(0.0, 1.0, _CELLS + 1)
    # The two lowest and the two highest values may be outliers.
    ordered, last = np.sort(values), min(_LEAST, len(values))
    low, high = ordered[last - 1], ordered[-last]
    return np.linspace(low, high if high > low else low + 1.0, _CELLS + 1)
