"""Diagnosis from the page: in a process of its own, with progress, and stopped at any time."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Event

from nicegui import ui

from estimation.channel import ChannelData
from estimation.diagnosis import Diagnosis
from estimation.effect import Effect
from estimation.model import Model
from estimation.study import engine
from estimation.study.kept_diagnosis import RESULT
from palpate.files import output_folder, write_text
from palpate.outcome import as_json
from palpate.render.sentences import diagnosed
from palpate.workbench import words
from palpate.workbench.bench import Bench
from robot_io.errors import InputError, PalpateError

_POLL_S = 0.1


class StoppedError(PalpateError):
    """The user stopped the diagnosis."""


class Elsewhere:
    """Judges in another process, so that the page stays quick, and can be stopped; see `engine.diagnose`."""

    def __init__(self) -> None:
        self._stop = Event()

    def stop(self) -> None:
        """End the work; whoever waits for it gets `StoppedError`."""
        self._stop.set()

    def __call__(
        self,
        data: Sequence[ChannelData],
        models: Sequence[Model],
        effects: Sequence[Effect],
        progress: engine.Progress,
        file: str,
    ) -> Diagnosis:
        """See `engine.diagnose`.

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

    def _wait(self, here: Connection, progress: engine.Progress) -> Diagnosis:
        while True:
            if self._stop.is_set():
                raise StoppedError("stopped")
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
    try:
        there.send(
            engine.diagnose(data, models, effects, lambda what, share: there.send((what, share)), file)
        )
    except PalpateError as error:
        there.send(error)


class DiagnosisCard:
    """Starts a diagnosis, shows how far it is and what it says, and applies its steps."""

    def __init__(
        self, bench: Bench, apply: Callable[[tuple[str, ...]], Awaitable[None]], found: Callable[[], None]
    ) -> None:
        self._bench, self._apply, self._found = bench, apply, found
        self._elsewhere: Elsewhere | None = None
        self._now = ("", 0.0)

    def build(self, more: Callable[[], None] = lambda: None) -> None:
        """Put the elements; `more` builds what belongs below the verdict."""
        self._more = more
        with ui.element("section").classes("card"):
            with ui.row().classes("bar"):
                ui.html("<h2>What is missing?</h2>", sanitize=False).props(f'title="{words.DIAGNOSE}"')
                ui.space()
                self._start = (
                    ui.button("Diagnose", on_click=self.start)
                    .props(f'dense unelevated no-caps title="{words.DIAGNOSE}"')
                    .mark("diagnose")
                )
                self._stop = (
                    ui.button("Stop", on_click=self._stopped)
                    .props(f'dense outline no-caps title="{words.STOP}"')
                    .mark("stop")
                )
            self._bar = ui.linear_progress(show_value=False, value=0.0).props("instant-feedback")
            self._what = ui.label().classes("quiet").mark("progress")
            self._answer = ui.element("div")
        self._running(now=False)
        ui.timer(0.2, self._tell)
        self._show()

    async def start(self) -> None:
        """Diagnose the channel that is shown."""
        self._elsewhere, study, name = Elsewhere(), self._bench.study, self._bench.choice.channel
        self._running(now=True)
        try:
            judge = self._elsewhere
            diagnosis = await asyncio.to_thread(
                lambda: study.diagnose(name, progress=self._progress, judge=judge)
            )
            if study.folder is not None:
                write_text(output_folder(study.folder) / RESULT, as_json(study.diagnosis_data(diagnosis)))
        except StoppedError:
            ui.notify("stopped; nothing was changed")
        except PalpateError as error:
            ui.notify(str(error), type="warning", multi_line=True)
        self._running(now=False)
        self._show()
        if self._bench.diagnosis is not None:
            self._found()

    def _progress(self, what: str, share: float) -> None:
        self._now = what, share

    def _tell(self) -> None:
        if self._elsewhere is not None:
            self._what.set_text(self._now[0] or "starting a process for it")
            self._bar.set_value(round(self._now[1], 2))

    def _stopped(self) -> None:
        if self._elsewhere is not None:
            self._elsewhere.stop()

    def _running(self, *, now: bool) -> None:
        self._start.set_visibility(not now)
        for element in (self._stop, self._bar, self._what):
            element.set_visibility(now)
        if not now:
            self._elsewhere, self._now = None, ("", 0.0)

    def _show(self) -> None:
        try:
            found = self._bench.diagnosis
        except InputError as error:
            ui.notify(str(error), type="warning")
            return
        self._answer.clear()
        if found is None:
            return
        said = diagnosed(found)
        with self._answer:
            with (
                ui.element("div")
                .classes(f"verdict {said.word}")
                .props(f'title="{words.VERDICTS[said.word]}"')
                .mark("verdict")
            ):
                ui.label(said.sentence)
                for remark in said.remarks:
                    ui.label(remark).classes("quiet")
            names = tuple(entry.effect for entry in found.accepted)
            if names:
                for count in range(1, len(names) + 1):
                    ui.button(
                        f"Add {' + '.join(names[:count])}", on_click=lambda c=count: self._apply(names[:c])
                    ).props("dense outline no-caps").mark(f"apply-{count}")
            if found.next_experiment is not None:
                ui.label(f"Next: {found.next_experiment.instruction}").props(
                    f'title="To {found.next_experiment.purpose}."'
                ).classes("q-mt-sm")
            self._more()
