"""Held-out error of a base model with the flexible laws of any set of kinds."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.estimation.budget.laws import COLLINEAR, BaseColumns, FlexibleLaw
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.motion import is_constant_in_runs
from palpate.estimation.statistics.least_squares import solve_within_bounds
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_RIDGES = (1e-6, 1e-4, 1e-2)  # ridge penalties, relative to the mean square of a column
_MAX_BLOCKS = 6000  # longer data are decimated
_PIECES = 16  # pieces of a run; alternating pieces fit and test the run's own coefficients
_SINGULAR = 1e-9
_FEW_LIFTED = 1e-3  # share of blocks with lost contact below which the fit is not repeated
_MAX_FITS = 6  # fits until the blocks with lost contact stay the same
_MIN_SINGULAR_VALUE = 1e-3  # singular values below this share of the largest are ignored in fits of one run

Kinds = frozenset[Kind]


class SquaredErrors(ABC):
    """Squared held-out errors for sets of kinds; each set is evaluated once."""

    _run: IntArray  # number of each block's run, from 0, shape (n,)
    _squares: dict[Kinds, FloatArray]  # results of `by_run`

    @property
    @abstractmethod
    def kinds(self) -> list[Kind]:
        """Kinds that can be in a set."""

    @abstractmethod
    def residual(self, kinds: Kinds) -> FloatArray:
        """Return the held-out residual of a model with these kinds, shape (n,) [effort].

        Args:
            kinds: kinds whose laws are added to the model.
        """

    @property
    def runs(self) -> int:
        """Number of runs r."""
        return int(self._run.max()) + 1

    @property
    def counts(self) -> FloatArray:
        """Blocks of each run, shape (r,)."""
        return np.bincount(self._run).astype(np.float64)

    def by_run(self, kinds: Kinds) -> FloatArray:
        """Return the sum of squared errors of each run, shape (r,) [effort^2].

        Args:
            kinds: kinds whose laws are added to the model.
        """
        if kinds not in self._squares:
            squares = np.bincount(self._run, weights=self.residual(kinds) ** 2)
            self._squares[kinds] = np.asarray(squares, dtype=np.float64)
        return self._squares[kinds]

    def mean_square(self, kinds: Kinds = frozenset()) -> float:
        """Return the mean squared error [effort^2].

        Args:
            kinds: kinds whose laws are added to the model.
        """
        return float(self.by_run(kinds).sum()) / len(self._run)


@dataclass
class HeldOutError(SquaredErrors):
    """Squared held-out errors of a base model with the flexible laws of some kinds.

    Coefficients come from ridge regression on all other folds, nonnegative where physics fixes the sign.
    Differences between runs have no columns. Instead, a gain and a zero are fitted to every other piece of a
    held-out run and tested on the remaining pieces.
    """

    base: BaseColumns
    laws: Sequence[FlexibleLaw]
    target: FloatArray  # effort that the columns explain, shape (m,)
    blocked: BlockedData
    used: BoolArray  # blocks that count, shape (m,)
    _predictions: dict[Kinds, FloatArray] = field(default_factory=dict)
    _squares: dict[Kinds, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Concatenate all columns, scale them to unit root mean square, and compute products by fold."""
        rows = np.flatnonzero(self.used)
        rows = rows[:: -(-len(rows) // _MAX_BLOCKS)]
        shared = [law for law in self.laws if Kind.RUN_DIFFERENCES not in law.kinds]
        run_laws = [law for law in self.laws if Kind.RUN_DIFFERENCES in law.kinds]
        self._run_columns = {law.kinds: law.columns[rows] for law in run_laws}
        columns = np.hstack([self.base.columns, *(law.columns for law in shared)])[rows]
        column_rms = np.sqrt(np.mean(columns**2, axis=0))
        self._columns: FloatArray = columns / np.where(column_rms > 0.0, column_rms, 1.0)
        self._target: FloatArray = self.target[rows]
        touching = self.blocked.data.touching
        touched = (
            np.zeros(len(rows)) if touching is None else self.blocked.reduce(touching.astype(float))[rows]
        )
        self._may_lift: BoolArray = touched == 0.0
        column_kinds: list[Kinds] = [frozenset()] * self.base.columns.shape[1]
        for law in shared:
            column_kinds += [law.kinds] * law.columns.shape[1]
        self._column_kinds = column_kinds
        signs = [self.base.lower >= 0.0, *(law.nonnegative for law in shared)]
        self._nonnegative: BoolArray = np.concatenate(signs)
        self._last_coefficients = np.ones(len(self._nonnegative))  # start values of the next fit
        one_sided = [self.base.one_sided, *(np.full(law.columns.shape[1], law.one_sided) for law in shared)]
        self._one_sided: BoolArray = np.concatenate(one_sided)
        self._run: IntArray = np.unique(self.blocked.run[rows], return_inverse=True)[1]
        self._half: IntArray = _alternating_pieces(self._run, self._target)
        self._fold: IntArray = np.unique(self.blocked.fold[rows], return_inverse=True)[1]
        self._folds = [np.flatnonzero(self._fold == number) for number in range(int(self._fold.max()) + 1)]
        self._grams = np.stack([self._columns[part].T @ self._columns[part] for part in self._folds])
        self._moments = np.stack([self._columns[part].T @ self._target[part] for part in self._folds])

    @property
    def kinds(self) -> list[Kind]:
        """Kinds with a law of their own, plus differences between runs if they can be told from the effort.

        This takes several runs, in which the effort changes: an offset of each run fits a constant effort.
        """
        kinds_with_law = [kind for kind in Kind if any(law.kinds == {kind} for law in self.laws)]
        if Kind.PERIODIC not in kinds_with_law and self._run_columns:
            kinds_with_law.append(Kind.PERIODIC)
        shows_runs = self.runs > 1 and not is_constant_in_runs(self.blocked.data)
        return [*kinds_with_law, Kind.RUN_DIFFERENCES] if shows_runs else kinds_with_law

    def residual(self, kinds: Kinds) -> FloatArray:
        """See `SquaredErrors.residual`."""
        predicted = self._predicted(kinds - {Kind.RUN_DIFFERENCES})
        error: FloatArray = self._target - predicted
        if Kind.RUN_DIFFERENCES not in kinds:
            return error
        adjusted = _adjusted_to_runs(self._target, predicted, self._run, self._half)
        adjusted += [  # waves of each run replace the waves that all runs share
            fit_each_run(self._target - self._predicted(kinds - run_kinds), columns, self._run)
            for run_kinds, columns in self._run_columns.items()
            if run_kinds <= kinds
        ]
        return min((error, *adjusted), key=lambda left: float(left @ left))

    def _predicted(self, kinds: Kinds) -> FloatArray:
        if kinds not in self._predictions:
            chosen = np.flatnonzero([need <= kinds for need in self._column_kinds])
            trials = self._predict(chosen, _RIDGES if kinds else (COLLINEAR,))
            self._predictions[kinds] = min(trials, key=lambda fit: float(np.sum((self._target - fit) ** 2)))
        return self._predictions[kinds]

    def _predict(self, chosen: IntArray, ridges: Sequence[float]) -> list[FloatArray]:
        """Predict each fold from the others with these columns, for each ridge penalty, shape (n,)."""
        is_base = chosen < self.base.columns.shape[1]
        lower, upper = np.where(self._nonnegative[chosen], 0.0, -np.inf), np.full(len(chosen), np.inf)
        grams = self._grams.take(chosen, axis=1).take(chosen, axis=2)
        moments = self._moments[:, chosen]
        gram, total_moment = grams.sum(axis=0), moments.sum(axis=0)
        columns, one_sided = self._columns.take(chosen, axis=1), self._one_sided[chosen]
        pushing = columns[:, one_sided]
        parts = [(rows, columns[rows], pushing[rows]) for rows in self._folds]
        trials = []
        for ridge in ridges:
            penalty = np.where(is_base, COLLINEAR, ridge) * len(self._target)
            total_gram, predicted = gram + np.diag(penalty), np.empty(len(self._target))
            for fold, (rows, columns_of_fold, pushing_of_fold) in enumerate(parts):
                system, moment = total_gram - grams[fold], total_moment - moments[fold]
                guess = self._last_coefficients[chosen]
                coefficients = solve_within_bounds(system, moment, lower, upper, guess)
                # Where the object would have to pull, contact is lost and the object's columns do not act.
                lifted = self._may_lift & (pushing @ coefficients[one_sided] < 0.0)
                for _ in range(_MAX_FITS if lifted.mean() > _FEW_LIFTED else 0):
                    train = np.flatnonzero(lifted & (self._fold != fold))
                    inactive = pushing[train]  # columns that do not act without contact
                    products = columns[train].T @ inactive
                    contact_system, contact_moment = system.copy(), moment.copy()
                    contact_system[:, one_sided] -= products
                    contact_system[one_sided] = contact_system[:, one_sided].T
                    contact_moment[one_sided] -= inactive.T @ self._target[train]
                    coefficients = solve_within_bounds(
                        contact_system, contact_moment, lower, upper, coefficients
                    )
                    previous, lifted = lifted, self._may_lift & (pushing @ coefficients[one_sided] < 0.0)
                    if np.array_equal(lifted, previous):
                        break
                self._last_coefficients[chosen] = coefficients
                predicted[rows] = columns_of_fold @ coefficients
                predicted[rows] -= lifted[rows] * (pushing_of_fold @ coefficients[one_sided])
            trials.append(predicted)
        return trials


@dataclass
class BestVariant(SquaredErrors):
    """Squared errors of the best of several variants of a model and its laws.

    Without laws, the first variant counts; it is the base model.
    """

    variants: Sequence[HeldOutError]
    _squares: dict[Kinds, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._run = self.variants[0]._run
        self.laws = self.variants[0].laws

    @property
    def kinds(self) -> list[Kind]:
        """See `SquaredErrors.kinds`."""
        return self.variants[0].kinds

    def residual(self, kinds: Kinds) -> FloatArray:
        """See `SquaredErrors.residual`."""
        variants = self.variants if kinds else self.variants[:1]
        return min((each.residual(kinds) for each in variants), key=lambda left: float(left @ left))


def fit_each_run(signal: FloatArray, columns: FloatArray, run: IntArray) -> FloatArray:
    """Return the residual (n,) of two-fold fits to alternating pieces of each run.

    Runs that are too short are returned unchanged.

    Args:
        signal: shape (n,).
        columns: shape (n, k).
        run: number of each sample's run, from 0, shape (n,).
    """
    half, residual = _alternating_pieces(run, signal), signal.copy()
    for number in range(int(run.max()) + 1):
        for side in (0, 1):
            train = np.flatnonzero((run == number) & (half != side))
            test = np.flatnonzero((run == number) & (half == side))
            if len(train) > 2 * columns.shape[1]:
                coefficients = np.linalg.lstsq(columns[train], signal[train], rcond=_MIN_SINGULAR_VALUE)[0]
                residual[test] -= columns[test] @ coefficients
    return residual


def _alternating_pieces(run: IntArray, signal: FloatArray) -> IntArray:
    """Number pieces of each run, of equal energy and time, 0, 1, 0, 1 ..., shape (n,)."""
    half = np.empty(len(run), dtype=np.int64)
    for number in range(int(run.max()) + 1):
        rows = np.flatnonzero(run == number)
        energy = signal[rows] ** 2
        weight = np.cumsum(energy / (energy.mean() or 1.0) + 1.0)
        half[rows] = np.minimum(weight * _PIECES / weight[-1], _PIECES - 1).astype(np.int64) % 2
    return half


def _adjusted_to_runs(
    target: FloatArray, predicted: FloatArray, run: IntArray, half: IntArray
) -> list[FloatArray]:
    """Return the residuals (n,) with a gain, a zero, or both for each run, fitted to its other pieces."""
    gain_only, zero_only, both_fitted = (np.empty(len(target)) for _ in range(3))
    for side in (0, 1):
        train, test = half != side, half == side
        count, p, y, pp, py = (
            np.bincount(run[train], weights=signal[train], minlength=int(run.max()) + 1)
            for signal in (np.ones(len(run)), predicted, target, predicted**2, predicted * target)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = np.nan_to_num(py / pp, nan=1.0, posinf=1.0, neginf=1.0)
            zero = np.nan_to_num((y - p) / count, nan=0.0)
            spread = count * pp - p**2
            slope = np.where(spread > _SINGULAR * count * pp, (count * py - p * y) / spread, 1.0)
            offset = np.nan_to_num((y - slope * p) / count, nan=0.0)
        run_of_test, predicted_test, target_test = run[test], predicted[test], target[test]
        gain_only[test] = target_test - gain[run_of_test] * predicted_test
        zero_only[test] = target_test - predicted_test - zero[run_of_test]
        both_fitted[test] = target_test - slope[run_of_test] * predicted_test - offset[run_of_test]
    return [gain_only, zero_only, both_fitted]
