"""Diagnosis and prefetched fits, each in a separate process."""

import asyncio
import os
from collections.abc import Sequence
from multiprocessing.connection import Connection
from threading import Event

from palpate.common import console
from palpate.common.worker_process import start_worker
from palpate.estimation.channel import ChannelData
from palpate.estimation.diagnosis import Diagnosis
from palpate.estimation.diagnosis.extension import PackedFit, fit_extended
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.model import Model
from palpate.estimation.study import StudyChannel, fitting
from palpate.estimation.study.fitting import fit_base
from palpate.estimation.workers import end_with_parent
from palpate.robot_io.errors import PalpateError
from palpate.study import Study

_POLL_S = 0.1
_STOPPED = "stopped; nothing was changed"


class StoppedError(PalpateError):
    """The user stopped the diagnosis."""


class DiagnosisProcess:
    """Diagnosis in another process, so that the page stays responsive and can stop it.

    Args:
        subject: file, channel and runs that are diagnosed.
    """

    def __init__(self, subject: str = "") -> None:
        self.subject = subject
        self._stop = Event()
        self.now = ("starting the process of the diagnosis", 0.0)  # current step, and the share that is done
        self.failure = ""  # reason why there is no result

    def note(self, what: str, share: float) -> None:
        """Store the progress.

        Args:
            what: current step.
            share: share of the work that is done, 0 to 1.

        Raises:
            StoppedError: the user stopped the diagnosis, which may be planning an experiment in this process.
        """
        if self._stop.is_set():
            raise StoppedError(_STOPPED)
        self.now = what, share

    def stop(self) -> None:
        """Stop the work; its caller gets `StoppedError`."""
        self._stop.set()

    def __call__(
        self,
        data: Sequence[ChannelData],
        models: Sequence[Model],
        effects: Sequence[Effect],
        progress: fitting.Progress,
        file: str,
    ) -> Diagnosis:
        """See `fitting.diagnose`.

        Raises:
            StoppedError: the user stopped the diagnosis.
            PalpateError: the process failed.
        """
        process, receiver = start_worker(_diagnose, list(data), list(models), list(effects), file)
        try:
            while not self._stop.is_set():
                if receiver.poll(_POLL_S):
                    message = receiver.recv()
                    if isinstance(message, Diagnosis):
                        return message
                    if isinstance(message, PalpateError):
                        raise message
                    progress(*message)
            raise StoppedError(_STOPPED)
        except EOFError as error:
            raise PalpateError("the diagnosis ended without a result, perhaps for lack of memory") from error
        finally:
            process.terminate()
            process.join()
            receiver.close()


RUNNING: set[DiagnosisProcess] = set()  # the diagnosis of this server, if there is one


def running_diagnosis() -> DiagnosisProcess | None:
    """Return the diagnosis that is running, of whichever file and runs."""
    return next(iter(RUNNING), None)


def stop_diagnoses() -> None:
    """Stop the running diagnosis when the server ends, which would otherwise wait for it."""
    if (diagnosis := running_diagnosis()) is not None:
        console.warn("the server ended during a diagnosis, so the diagnosis has no result")
        diagnosis.stop()


def _diagnose(
    sender: Connection, data: list[ChannelData], models: list[Model], effects: list[Effect], file: str
) -> None:
    end_with_parent()
    try:
        made = fitting.diagnose(data, models, effects, lambda what, share: sender.send((what, share)), file)
        sender.send(made)
    except PalpateError as error:
        sender.send(error)


_NICE = 10
_MOST = 6  # number of recent fits from which the process can continue


class FitPrefetcher:
    """Process that fits models of one channel ahead of their use."""

    def __init__(self, study: Study, channel: StudyChannel) -> None:
        self._study, self._channel = study, channel
        own = [
            effect for effect in study.effects if type(effect).__module__.startswith("palpate.estimation.")
        ]
        self._names = {effect.name for effect in own}
        self._process, self._pipe = start_worker(_fit_ahead, channel, own)

    async def fit(self, effects: Sequence[str]) -> None:
        """Compute a fit and store it in the study, unless the study has it.

        Args:
            effects: effects added to the base model, in order.

        Raises:
            InputError: the model cannot be fitted.
        """
        if self._names.issuperset(effects) and not self._study.is_fitted(self._channel, effects):
            self._pipe.send(tuple(effects))
            answer = await asyncio.to_thread(self._pipe.recv)
            if isinstance(answer, Exception):
                raise answer
            self._study.take_fit(self._channel, effects, answer)

    def close(self) -> None:
        """End the process at once; can be called repeatedly."""
        self._process.terminate()


def _fit_ahead(pipe: Connection, channel: StudyChannel, own: Sequence[Effect]) -> None:
    """Fit the requested models at low priority, and answer each request with the fit or an error."""
    end_with_parent()
    os.nice(_NICE)
    library, fits = {effect.name: effect for effect in own}, dict[tuple[str, ...], FitResult]()

    def fit(effects: tuple[str, ...]) -> FitResult:
        """Fit as `Study.fit` does, starting from fits of this process."""
        made = fits.pop(effects, None)
        if made is None and not effects:
            made = fit_base(channel.to_fit, channel.model)
        elif made is None:
            parent = fit(effects[:-1])
            made = fit_extended(channel.to_fit, parent, library[effects[-1]].suited_to(parent.data))
        fits[effects] = made
        while len(fits) > _MOST:
            del fits[next(iter(fits))]
        return made

    while True:
        try:
            pipe.send(PackedFit.of(fit(pipe.recv())))
        except EOFError:
            return
        except Exception as error:
            pipe.send(error)
