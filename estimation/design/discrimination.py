"""Predict how well an experiment separates rival models.

    lead(i, j) = 1 - sqrt( E_i^2 / E_j^2 ),    E_j^2 = 1/n min_theta |y_i - f_j(theta)|^2

Here y_i are the present data and the prediction of rival i for the experiment, with the present noise. A
diagnosis separates effects by the same figure (`palpate.estimation.diagnosis.bootstrap`); its value for the
present data is subtracted. For models that are linear in their parameters, E_j^2 - E_i^2 is the T-optimality
criterion (A. C. Atkinson, V. V. Fedorov, The design of experiments for discriminating between two rival
models, Biometrika 62 (1975) 57). `RivalModels.predicted_leads` computes it within milliseconds.
`RivalModels.simulated_leads` simulates the noise and refits all models with their inner parameters.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.data.import_files import joined_channels
from palpate.estimation.fit.blocks import block_average, decimate, with_load
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.fit.inner_search import refine_inner, search_inner
from palpate.estimation.fit.measurement_model import shuffle_noise
from palpate.estimation.fit.samples import slopes_of
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.robot_io.types import BoolArray, FloatArray

SMALL = 0.05  # relative change of an error that is reported but changes no verdict
CLEAR = 3.0 * SMALL  # a lead that needs no further data


@dataclass(frozen=True)
class RivalModels:
    """Models of one channel that the data do not separate, on one sample per block."""

    data: ChannelData  # the recorded channel, one sample per block
    good: BoolArray  # mask of the samples used in the fits, shape (n,)
    fits: tuple[FitResult, ...]  # the models

    @classmethod
    def of(cls, fits: Sequence[FitResult]) -> "RivalModels":
        """Refit models of the same channel to one sample per block.

        Args:
            fits: models fitted to the same channel.
        """
        blocked = fits[0].problem.blocked
        data, cache = decimate(blocked), FitCache()
        solutions = (fit.solution for fit in fits)
        refits = (fit_model(data, s.model, s.parameters, blocked.trusted, cache) for s in solutions)
        return cls(data, blocked.trusted, tuple(refits))

    def predicted_leads(self, planned: ChannelData) -> FloatArray:
        """Predict the leads of each true model (row) in a planned experiment to first order, (r, r).

        Args:
            planned: the channel with the planned motion; its effort is ignored.
        """
        planned_blocks, good = _block_averages(planned)
        combined = joined_channels((self.data, planned_blocks))
        used = np.concatenate([self.good, good])
        is_planned = np.arange(len(combined)) >= len(self.data)
        is_new = is_planned[used]
        settled = [_settled(fit, combined, is_planned) for fit in self.fits]
        expected = [_expected(fit, motion)[used] for fit, motion in zip(self.fits, settled, strict=True)]
        slopes = [_slopes(fit, motion)[used] for fit, motion in zip(self.fits, settled, strict=True)]
        tangents = [np.linalg.qr(columns)[0] for columns in slopes]
        squared_errors = np.empty((len(self.fits),) * 2)
        for true_index, effort in enumerate(expected):
            measured = np.where(is_new, effort, combined.effort[used])
            for rival_index, (predicted, tangent) in enumerate(zip(expected, tangents, strict=True)):
                difference = measured - predicted
                squared_errors[true_index, rival_index] = float(
                    difference @ difference - np.sum((tangent.T @ difference) ** 2)
                )
        squared_errors += good.sum() * float(np.mean(self._noise**2))
        leads = 1.0 - np.sqrt(np.diag(squared_errors)[:, None] / squared_errors)
        return self._gained_leads(leads, [fit.solution.sse for fit in self.fits])

    def simulated_leads(self, planned: ChannelData, rng: np.random.Generator) -> FloatArray:
        """Simulate an experiment with each model as truth (row), refit all, and return the leads, (r, r).

        Args:
            planned: the channel with the planned motion; its effort is ignored.
            rng: random generator for the noise of the simulated data.
        """
        planned_blocks, good = _block_averages(planned)
        used = np.concatenate([self.good, good])
        noise = np.resize(self._noise, len(planned_blocks))
        shared = set.intersection(*({e.name for e in fit.solution.model.effects} for fit in self.fits))
        leads = np.zeros((len(self.fits),) * 2)
        for true_index, true_model in enumerate(self.fits):
            settled = _settled(true_model, planned_blocks, np.ones(len(planned_blocks), dtype=np.bool_))
            effort = _expected(true_model, settled) + shuffle_noise(noise, planned_blocks.run, rng)
            data, cache = joined_channels((self.data, replace(planned_blocks, effort=effort))), FitCache()
            refits = (_refit_globally(data, fit, shared, used, cache) for fit in self.fits)
            squared_errors = np.array([fit.solution.held_out for fit in refits])
            leads[true_index] = 1.0 - np.sqrt(squared_errors[true_index] / np.maximum(squared_errors, 1e-300))
        return self._gained_leads(leads, [fit.solution.held_out for fit in self.fits])

    def _gained_leads(self, leads: FloatArray, squared_errors: Sequence[float]) -> FloatArray:
        """Subtract the leads in the present data."""
        present_leads = 1.0 - np.sqrt(np.array(squared_errors)[:, None] / np.maximum(squared_errors, 1e-300))
        return np.asarray(leads - np.maximum(present_leads, 0.0))

    def evidence(self, leads: FloatArray, planned: ChannelData) -> float:
        """Convert leads to a log likelihood ratio, summed over all pairs of models.

        Args:
            leads: leads of the models, shape (r, r).
            planned: the channel with the planned motion.
        """
        count = len(self.data) + len(_block_averages(planned)[0])
        return -count * float(np.sum(np.log1p(-np.clip(leads, 0.0, 0.999))))

    @property
    def _noise(self) -> FloatArray:
        """Residual of the best model in the samples used, shape (k,)."""
        best = min(self.fits, key=lambda fit: fit.solution.sse)
        return best.solution.residual[best.problem.blocked.trusted]


def _block_averages(planned: ChannelData) -> tuple[ChannelData, BoolArray]:
    """Return a channel with one sample per block, and the mask of its trusted samples."""
    blocked = block_average(planned)
    return decimate(blocked), blocked.trusted


def _refit_globally(
    data: ChannelData, rival: FitResult, shared: Collection[str], good: BoolArray, cache: FitCache
) -> FitResult:
    """Refit a rival from its parameters and from other start values of effects that not all rivals share."""
    model = rival.solution.model
    best = fit_model(data, model, rival.solution.parameters, good, cache)
    for effect in model.effects:
        if effect.inner and effect.name not in shared:
            starts = effect.starts(best.data)
            searched = search_inner(best.problem, model, effect.name, best.solution.parameters, starts)
            solution = refine_inner(best.problem, effect.name, searched).best
            refitted = fit_model(data, model, solution.parameters, good, cache)
            best = min(best, refitted, key=lambda fit: fit.solution.sse)
    return best


def _expected(rival: FitResult, motion: ChannelData) -> FloatArray:
    """Return the effort that a rival predicts for a motion, shape (n,)."""
    model, parameters = rival.solution.model, rival.solution.parameters
    return model.predict(with_load(motion, model, parameters), parameters)


def _settled(rival: FitResult, motion: ChannelData, is_planned: BoolArray) -> ChannelData:
    """Give planned samples (n,), which have no readings, those of sensors that settled before the run."""
    model, parameters = rival.solution.model, rival.solution.parameters
    if not model.sensors:
        return motion
    object_model = model.without(*(sensor.name for sensor in model.sensors))
    effort = object_model.predict(with_load(motion, object_model, parameters), parameters)
    return replace(motion, effort=np.where(is_planned, effort, motion.effort))


def _slopes(rival: FitResult, motion: ChannelData) -> FloatArray:
    """Return the derivative of a rival's prediction by each parameter, scaled to unit norm, shape (n, p)."""
    model, parameters = rival.solution.model, rival.solution.parameters
    slopes = slopes_of(model, with_load(motion, model, parameters), parameters)
    scaled: FloatArray = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    return scaled


def separated_names(names: Sequence[str], lead: FloatArray) -> list[str]:
    """Return the first rival that an experiment separates from any, then those from which it is separated.

    Args:
        names: names of the rivals.
        lead: expected leads between them, shape (r, r).
    """
    apart = (lead > SMALL) | (lead.T > SMALL)
    for name, row in zip(names, apart, strict=True):
        if row.any():
            return [name, *(other for other, is_apart in zip(names, row, strict=True) if is_apart)]
    return []


def separated_pairs(names: Sequence[str], leads: Iterable[FloatArray]) -> set[frozenset[str]]:
    """Return the pairs of rivals that at least one of several experiments separates.

    Args:
        names: names of the rivals.
        leads: expected leads between them in each experiment, shape (r, r).
    """
    return {frozenset((names[i], names[j])) for lead in leads for i, j in np.argwhere(lead > SMALL)}


EQUIVALENT = 0.9  # ratio to the best experiment's lead above which experiments are equivalent


@dataclass(frozen=True)
class Experiment:
    """A possible experiment, with its expected separation of rival models."""

    instruction: str  # instruction for the experimenter
    duration_s: float  # duration [s]
    # For each undecided channel, the expected leads between all rivals, shape (r, r); see
    # `palpate.estimation.design.discrimination`.
    leads: tuple[FloatArray, ...]
    evidence: float = 0.0  # expected log likelihood ratio, 0 if unknown; see `RivalModels.evidence`

    @property
    def separation(self) -> float:
        """Expected share of pairs of rivals that the experiment separates.

        The share is averaged over the undecided channels. A pair with a lead below `CLEAR` counts in part.
        """
        pairs = [lead[~np.eye(len(lead), dtype=bool)] for lead in self.leads if len(lead) > 1]
        shares = [float(np.mean(np.clip(lead / CLEAR, 0.0, 1.0))) for lead in pairs]
        return sum(shares) / max(len(self.leads), 1)

    @property
    def separates(self) -> bool:
        """Whether the expected lead over any wrong rival exceeds `SMALL`."""
        return any(bool(np.any(lead > SMALL)) for lead in self.leads)

    def combined_with(self, other: "Experiment") -> "Experiment":
        """Combine two consecutive experiments; the squared errors of a wrong model add up.

        Args:
            other: the second experiment.
        """
        leads = []
        for first, second in zip(self.leads, other.leads, strict=True):
            squared_error = (1.0 - first) ** -2.0 + (1.0 - second) ** -2.0 - 1.0  # relative to the true model
            leads.append(1.0 - np.maximum(squared_error, 1e-3) ** -0.5)
        instruction = f"{self.instruction}, and {other.instruction}"
        return Experiment(instruction, self.duration_s + other.duration_s, tuple(leads))


@dataclass(frozen=True)
class ExperimentChoice:
    """The chosen experiment and the reason."""

    index: int  # index of the experiment among those offered
    experiment: Experiment  # the chosen experiment
    reason: str  # one sentence


def choose_experiment(candidates: Sequence[Experiment]) -> ExperimentChoice | None:
    """Choose the experiment that separates rivals best; None if nothing is expected to separate any.

    Among nearly equal ones, the one with the most evidence is chosen, because a rival with many parameters
    can adapt to a weak experiment, or the shortest if the evidence is unknown.

    Args:
        candidates: feasible experiments with their expected leads.
    """
    useful = [number for number, experiment in enumerate(candidates) if experiment.separates]
    if not useful:
        return None
    best_separation = max(candidates[number].separation for number in useful)
    equivalent = [
        number for number in useful if candidates[number].separation >= EQUIVALENT * best_separation
    ]
    index = max(equivalent, key=lambda number: (candidates[number].evidence, -candidates[number].duration_s))
    chosen = candidates[index]
    rank = "This is the most informative experiment"
    if len(equivalent) > 1:
        advantage = "promises the most evidence" if chosen.evidence else "is the shortest"
        rank = f"Of {len(equivalent)} nearly equally informative experiments, this {advantage}"
    reason = (
        f"{chosen.instruction} ({chosen.duration_s:.0f} s). {rank}. It is expected to separate "
        f"{100 * chosen.separation:.0f} % of the remaining explanations"
    )
    return ExperimentChoice(index, chosen, reason)
