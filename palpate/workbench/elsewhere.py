"""Diagnosis in a process of its own, with progress, and stopped at any time."""

from collections.abc import Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Event

from estimation.channel import ChannelData
from estimation.diagnosis import Diagnosis
from estimation.effect import Effect
from estimation.end_workers import end_with_parent
from estimation.model import Model
from estimation.study import fitting
from robot_io.errors import PalpateError

_POLL_S = 0.1


class StoppedError(PalpateError):
    """The user stopped the diagnosis."""


class Elsewhere:
    """Judges in another process, so that the page stays quick, and can be stopped; see `fitting.diagnose`."""

    def __init__(self) -> None:
        self._stop = Event()
        self.now = ("starting a process for it", 0.0)  # what is done, and the share that was
        self.said = ""  # why there is no answer

    def note(self, what: str, share: float) -> None:
        """How far it is."""
        self.now = what, share

    def stop(self) -> None:
        """End the work; whoever waits for it gets `StoppedError`."""
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
            StoppedError: it was stopped.
            PalpateError: the process failed.
        """
        here, there = get_context("spawn").Pipe()
        job = (there, list(data), list(models), list(effects), file)
        process = get_context("spawn").Process(target=_work, args=job, daemon=True)
        process.start()
        there.close()
        try:
            return self._wait(here, progress)
        except EOFError as error:
            raise PalpateError("the diagnosis ended without an answer; was there enough memory?") from error
        finally:
            process.terminate()
            process.join()
            here.close()

    def _wait(self, here: Connection, progress: fitting.Progress) -> Diagnosis:
        while True:
            if self._stop.is_set():
                raise StoppedError("stopped; nothing was changed")
            if here.poll(_POLL_S):
                what = here.recv()
                if isinstance(what, Diagnosis):
                    return what
                if isinstance(what, PalpateError):
                    raise what
                progress(*what)


def _work(
    there: Connection, data: list[ChannelData], models: list[Model], effects: list[Effect], file: str
) -> None:
    end_with_parent()
    try:
        there.send(
            fitting.diagnose(data, models, effects, lambda what, share: there.send((what, share)), file)
        )
    except PalpateError as error:
        there.send(error)
