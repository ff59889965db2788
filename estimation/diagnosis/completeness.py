"""Test whether a model is complete: whether it leaves only noise, without a sign of a missing effect."""

from functools import cache

import numpy as np

from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.acceptance import is_outperformed
from palpate.estimation.diagnosis.bootstrap import (
    SMOOTHING_TIMES,
    encoder_step_error,
    is_mostly_smoothing,
    lack_of_fit_test,
    smoothing_error,
)
from palpate.estimation.diagnosis.residual_checks import (
    ResidualFinding,
    check_residuals,
    find_excess_error,
    find_rare_events,
)
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.fit.measurement_noise import measurement_noise

# Largest share of the effort's variance that a complete model leaves if the noise is only bounded.
_MAX_VARIANCE_LEFT = 0.8


class Completeness:
    """Tests whether models leave only noise; each model is tested once."""

    def __init__(self, start: FitResult, rng: np.random.Generator) -> None:
        """Prepare the tests of a channel's models.

        Args:
            start: the base model.
            rng: random generator for bootstrap samples and permutations.
        """
        self._start = start
        self._rng = rng
        self._noise = measurement_noise(start)
        self.measurement = identify_measurement_model(start.training)
        self.leaves_noise = cache(self._leaves_noise)
        self._cached_finding = cache(self._evaluate_residuals)
        self.cleared = set[FitResult]()  # models whose residual checks are ignored
        # Models that count as incomplete, because effects improve them more than bootstrap samples of them.
        self.incomplete = set[FitResult]()

    def is_complete(self, fit: FitResult) -> bool:
        """Return whether a model leaves only noise and passes the residual checks.

        Args:
            fit: the model.
        """
        return fit not in self.incomplete and self.leaves_noise(fit) and self.residual_finding(fit) is None

    def leaves_smoothing(self, fit: FitResult) -> bool:
        """Return whether smoothing of the motion may cause all of the error that signals explain.

        Bootstrap samples contain this error only to first order. If it is most of the error, the residual
        checks say nothing about other causes.

        Args:
            fit: the model.
        """
        error = SMOOTHING_TIMES * smoothing_error(fit, self.measurement)
        largest = fit.problem.used.sum() * error**2
        if fit in self.incomplete or self.explains_little(fit) or fit.flexible.explained >= largest:
            return False
        return is_mostly_smoothing(fit, self.measurement) or self.residual_finding(fit) is None

    def explains_each_run(self, fit: FitResult) -> bool:
        """Return whether a model is complete, or would be if its gains could differ between runs.

        An upper bound of the noise does not show that the model explains each run.

        Args:
            fit: the model.
        """
        if self.is_complete(fit):
            return True
        may_be_complete = fit not in self.incomplete and not self._noise.is_bound
        finding = self.residual_finding(fit) if may_be_complete and self.leaves_noise(fit) else None
        return finding is not None and finding.fits_each_run

    def residual_finding(self, fit: FitResult) -> ResidualFinding | None:
        """Return the finding of the residual checks on a model, unless it is ignored.

        Args:
            fit: the model.
        """
        return None if fit in self.cleared else self._cached_finding(fit)

    def _evaluate_residuals(self, fit: FitResult) -> ResidualFinding | None:
        if fit.is_exact:
            return None
        complete = self.leaves_noise(fit)
        finding = check_residuals(fit, self.measurement, self._rng, complete=complete)
        if finding is None and complete:
            by_motion = np.hypot(
                SMOOTHING_TIMES * smoothing_error(fit, self.measurement),
                encoder_step_error(fit, self.measurement),
            )
            finding = find_rare_events(fit, self._noise) or find_excess_error(fit, self._noise, by_motion)
        return finding

    def _leaves_noise(self, fit: FitResult) -> bool:
        if fit.is_exact:
            return True
        if is_outperformed(self._start, fit) or self.explains_little(fit):
            return False
        if fit.rmse <= (1.0 + SMALL) * fit.floor():
            return True
        if fit.flexible.explained <= fit.problem.used.sum() * encoder_step_error(fit, self.measurement) ** 2:
            return True
        return not lack_of_fit_test(fit, self.measurement, self._rng).is_significant

    def explains_little(self, fit: FitResult) -> bool:
        """Return whether a model explains so little that a bounded noise may be smaller than its error.

        Args:
            fit: the model.
        """
        if not self._noise.is_bound:
            return False
        effort = fit.problem.blocked.effort[fit.problem.used]
        return fit.held_out_mean_square >= _MAX_VARIANCE_LEFT * float(np.var(effort))
