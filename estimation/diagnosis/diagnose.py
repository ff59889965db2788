"""Says what is missing in a model, with evidence; or that nothing is, or that nobody has named it."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from zlib import crc32

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.data_quality import reject_reason, usable
from palpate.estimation.design.next_experiment import FEW_READINGS
from palpate.estimation.diagnosis.acceptance import (
    accept_effects,
    accept_forms,
    acceptance_criteria,
    most_parsimonious,
    smallest_sufficient_model,
)
from palpate.estimation.diagnosis.bootstrap import SMALL, encoder_step_error, lack_of_fit_test
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.forms import (
    FormTest,
    PartiallyLinear,
    analyse_kinds,
    form_tests,
    named_forms,
)
from palpate.estimation.diagnosis.random_effects import add_run_variation
from palpate.estimation.diagnosis.residual_checks import ResidualFinding, check_residuals, exceeds_noise
from palpate.estimation.diagnosis.result import ChannelDiagnosis, Diagnosis
from palpate.estimation.diagnosis.search import Progress, Search, prepare_search, select_effects
from palpate.estimation.diagnosis.verdict import Evidence, decide_verdict, insufficient_diagnosis
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.model import Model
from palpate.estimation.shared_gains import with_shared_gains
from palpate.estimation.workers import end_when_told, end_workers

_HANDFUL = 12  # different readings in all; with more, an effort crosses so many steps that they average out


def diagnose(
    data: ChannelData | Sequence[ChannelData],
    model: Model | Sequence[Model],
    effects: Iterable[Effect] | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
    file: str = "",
    processes: int = 1,
) -> Diagnosis:
    """Diagnose each channel.

    Args:
        data: one channel or several.
        model: the base model of all, or one for each channel.
        effects: the library of hypotheses; by default all that palpate knows.
        rng: for all draws.
        progress: told what is being done and which share of that is done.
        file: what the data came from, for the record.
        processes: that share the channels.

    Returns:
        One entry for each channel, in the order given.
    """
    channels = [data] if isinstance(data, ChannelData) else list(data)
    models = [model] * len(channels) if isinstance(model, Model) else list(model)
    known = effect_library() if effects is None else tuple(effects)
    channels = with_shared_gains(channels, models)
    seed = int(rng.integers(2**32))  # a channel is judged alike alone and among others
    seeds = [np.random.default_rng([seed, crc32(channel.name.encode())]) for channel in channels]
    jobs = list(zip(channels, models, seeds, strict=True))
    work = partial(_diagnose_job, known)
    if processes == 1 or len(jobs) == 1:
        diagnoses = [diagnose_channel(*job[:2], known, job[2], progress) for job in jobs]
    else:
        with ProcessPoolExecutor(
            min(processes, len(jobs)), get_context("fork"), initializer=end_when_told
        ) as pool:
            try:
                diagnoses = list(_counted(pool.map(work, jobs), channels, progress))
            except BaseException:  # a signal, above all: nobody waits for the fits that are going on
                end_workers(pool)
                raise
    name = "+".join(dict.fromkeys(model.name for model in models))
    return Diagnosis(file=file, model=name, channels=diagnoses)


def _diagnose_job(
    effects: tuple[Effect, ...], job: tuple[ChannelData, Model, np.random.Generator]
) -> ChannelDiagnosis:
    data, model, rng = job
    return diagnose_channel(data, model, effects, rng)


def _counted(
    diagnoses: Iterable[ChannelDiagnosis], channels: Sequence[ChannelData], progress: Progress
) -> Iterator[ChannelDiagnosis]:
    """Results as they come, each channel told as begun and as done."""
    for channel in channels:
        progress(f"{channel.name}: judging", 0.0)
    for diagnosis in diagnoses:
        progress(f"{diagnosis.channel}: {diagnosis.verdict.value}", 1.0)
        yield diagnosis


def diagnose_channel(
    data: ChannelData,
    model: Model,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
) -> ChannelDiagnosis:
    """Diagnose one channel; see `diagnose`.

    Args:
        data: the channel, with its motion.
        model: the base model.
        effects: the library.
        rng: for draws.
        progress: called with the current step and the share of it that is done.
    """
    if reason := reject_reason(data):
        return insufficient_diagnosis(data, reason)
    search = prepare_search(data, model, usable(data), effects, rng, progress)
    checks = _Completeness(search)
    kinds = cache(lambda: analyse_kinds(search))
    coarse_kinds = cache(lambda: analyse_kinds(search.coarse or search))
    fit = search.start
    if not fit.is_exact:
        part = partial(smallest_sufficient_model, search, measurement=checks.measurement)

        @cache
        def forms() -> FitResult:
            progress(f"{data.name}: comparing forms within kinds", 0.0)
            return named_forms(coarse_kinds())

        fit = select_effects(search, checks.in_every_respect, part, forms)
    varied = add_run_variation(search, fit)
    if checks.objection(varied) is None:  # else what is left may be what made the runs differ
        fit = varied
    end, tests = _accept(search, fit, checks, kinds)
    if not fit.is_exact and not checks.in_every_respect(end):
        rough = forms()
        formed = search.fitted(rough.solution.model, rough.solution.parameters)
        rival, other_tests = accept_forms(search, kinds(), formed, checks.measurement)
        if search.is_better(rival, end):
            end, tests = rival, other_tests
        if end is search.start:  # together, needless effects may have stood in one's way
            for single in [option for option in search.screen(end) if option.possible][:1]:
                end, tests = accept_forms(search, kinds(), search.with_candidate(single), checks.measurement)
    objection, complete = checks.objection(end), checks.in_every_respect(end)
    names = search.added_effects(end)
    is_doubtful = "quantisation" not in names if names else not complete
    if is_doubtful and (reason := _below_a_step(search.start)):
        return insufficient_diagnosis(data, reason)
    of_kinds = (None, None) if complete else (kinds(), coarse_kinds())
    return decide_verdict(Evidence(search, checks.measurement, end, complete, objection, tests, *of_kinds))


def _accept(
    search: Search, fit: FitResult, checks: "_Completeness", kinds: Callable[[], PartiallyLinear]
) -> tuple[FitResult, list[FormTest]]:
    """Reduce the model that was found to effects that may bear their names, with the test of each form."""
    if checks.in_every_respect(fit):
        end = accept_effects(search, fit, checks.measurement)
        if end is not search.start:
            checks.refute(search.start)
            end = most_parsimonious(search, end, checks.measurement, checks.in_every_respect)
            if checks.in_every_respect(end):
                return end, form_tests(kinds(), end)
            fit = end
        elif (
            checks.leaves_noise(end)
            and search.added_effects(fit)
            and search.is_sensible(fit)
            and exceeds_noise(end, checks.measurement, search.rng) is None
        ):  # draws from the base model gain as much by a model to which nothing objects
            checks.withdraw_objection(end)
    if checks.in_every_respect(search.start):  # what improves on it is no more than noise or smoothing
        return search.start, []
    return accept_forms(search, kinds(), fit, checks.measurement)


class _Completeness:
    """Whether models leave no more than draws from them do; each is judged once."""

    def __init__(self, search: Search) -> None:
        self._search = search
        self.measurement = identify_measurement_model(search.data)
        self.leaves_noise = cache(self._leaves_noise)
        self._found_objection = cache(self._objection)
        self._without_objection: list[FitResult] = []
        self._refuted: list[FitResult] = []

    def in_every_respect(self, fit: FitResult) -> bool:
        """Whether a model is complete, and nothing that no signal shows speaks against it.

        Args:
            fit: the model.
        """
        is_refuted = any(fit is known for known in self._refuted)
        return not is_refuted and self.leaves_noise(fit) and self.objection(fit) is None

    def objection(self, fit: FitResult) -> ResidualFinding | None:
        """What no signal shows and speaks against a model.

        Args:
            fit: the model.
        """
        return None if any(fit is known for known in self._without_objection) else self._found_objection(fit)

    def withdraw_objection(self, fit: FitResult) -> None:
        """Take a model for complete though its runs, or its error in time, look unusual.

        Args:
            fit: the model.
        """
        self._without_objection.append(fit)

    def refute(self, fit: FitResult) -> None:
        """Take a model for incomplete, since draws from it gain less by effects that are sound.

        Args:
            fit: the model.
        """
        self._refuted.append(fit)

    def _objection(self, fit: FitResult) -> ResidualFinding | None:
        if fit.is_exact:
            return None
        complete = self.leaves_noise(fit)
        return check_residuals(fit, self.measurement, self._search.rng, complete=complete)

    def _leaves_noise(self, fit: FitResult) -> bool:
        if fit.is_exact:
            return True
        if acceptance_criteria(self._search.start, fit).is_outperformed:
            return False
        if fit.rmse <= (1.0 + SMALL) * fit.floor():
            return True
        if fit.flexible.explained <= fit.problem.used.sum() * encoder_step_error(fit, self.measurement) ** 2:
            return True
        return not lack_of_fit_test(fit, self.measurement, self._search.rng).is_significant


def _below_a_step(start: FitResult) -> str | None:
    """Why nothing can be said of a channel whose reader shows a handful of values only; None if it can.

    A reader that rounds is off by up to half a step, and always in the same way where the motion is the same
    (B. Widrow, I. Kollar, Quantization Noise (2008)).
    """
    levels = np.unique(start.data.effort)
    if not 1 < len(levels) <= _HANDFUL:
        return None
    step, unit = float(np.median(np.diff(levels))), start.data.kind.effort_unit
    if start.rmse >= step:
        return None
    return (
        f"only {len(levels)} {FEW_READINGS}, {step:.3g} {unit} apart, and the model is off by "
        f"{start.rmse:.3g} {unit}, less than one such step: the residual may be rounding; "
        "use a finer sensor, or a motion that takes more effort"
    )
