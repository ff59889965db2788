"""Cards of the diagnosis and of the riddle; any tab can start, follow and stop them."""

import asyncio
from base64 import b64encode
from collections.abc import Awaitable, Callable, Sequence, Set
from functools import partial

from nicegui import ui

from palpate.common.console import json_text
from palpate.common.files import output_folder, write_text
from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.render.diagnosis import budget_svg, budget_view, diagnosis_verdict
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import open_answer
from palpate.workbench import elements
from palpate.workbench.elements import heading, set_props
from palpate.workbench.processes import RUNNING, DiagnosisProcess, running_diagnosis
from palpate.workbench.state import WorkbenchState

_POLL_S = 0.2
_PICTURE_WIDTH = 340  # [px], at which it is drawn; the column's width scales it


class DiagnosisCard:
    """Starts a diagnosis, shows its progress and result, and applies its steps."""

    def __init__(
        self,
        state: WorkbenchState,
        add: Callable[[Sequence[str]], Awaitable[None]],
        on_diagnosed: Callable[[], None],
    ) -> None:
        self._state, self._add, self._on_diagnosed = state, add, on_diagnosed
        self._buttons: ui.element | None = None
        self._judging: DiagnosisProcess | None = None  # the diagnosis that the page shows

    def build(self, more: Callable[[], None] = lambda: None) -> None:
        """Create the elements of the panel.

        Args:
            more: creates the elements below the verdict.
        """
        self._more = more
        with ui.element("section").classes("card"):
            with ui.row().classes("bar"):
                heading("What is missing?", elements.DIAGNOSE)
                ui.space()
                self._start = ui.button("Diagnose", on_click=self.start).mark("diagnose")
                set_props(self._start.props("dense unelevated no-caps"), title=elements.DIAGNOSE)
                self._stop = ui.button("Stop", on_click=self.stop).mark("stop")
                set_props(self._stop.props("dense outline no-caps"), title=elements.STOP)
            self._bar = ui.linear_progress(show_value=False, value=0.0).props("instant-feedback")
            self._what = ui.label().classes("quiet")
            self._answer = ui.element("div")
        self._judging = running_diagnosis()  # which may end before the first look at its progress
        self._running(now=False)
        ui.timer(_POLL_S, self._show_progress)
        self._show()

    async def start(self) -> None:
        """Diagnose the selected channel, or wait for the diagnosis that is running."""
        study, name = self._state.study, self._state.choice.channel
        while (diagnosing := running_diagnosis()) is not None:
            await asyncio.sleep(_POLL_S)
            if running_diagnosis() is not diagnosing:
                return
        judge = DiagnosisProcess(self._subject)
        RUNNING.add(judge)
        self._show_progress()
        try:
            diagnosis = await asyncio.to_thread(study.diagnose, name, progress=judge.note, judge=judge)
            if study.folder is not None:
                content = json_text(study.diagnosis_to_save(diagnosis))
                write_text(output_folder(study.folder) / RESULT, content)
        except PalpateError as error:
            judge.failure = str(error)
        finally:
            RUNNING.remove(judge)

    @property
    def _subject(self) -> str:
        """File, channel and runs that this card diagnoses."""
        state = self._state
        return f"{state.study.source.name} {state.choice.channel}{state.use_of_runs}"

    def _show_progress(self) -> None:
        """Show the progress of a diagnosis, even of another tab, of other runs, or before a reload."""
        before, judge = self._judging, running_diagnosis()
        self._judging = judge
        if judge is not None:
            other = "" if judge.subject == self._subject else f"{judge.subject}: "
            self._what.set_text(other + judge.now[0])
            self._bar.set_value(round(judge.now[1], 2))
        self._running(now=judge is not None)
        if judge is None and before is not None:
            if before.failure:
                ui.notify(before.failure, type="warning", multi_line=True)
            self._show()
            if self._state.diagnosis is not None:
                self._on_diagnosed()

    def stop(self) -> None:
        """Stop the running diagnosis, if there is one."""
        if (judge := running_diagnosis()) is not None:
            judge.stop()

    def _running(self, *, now: bool) -> None:
        self._start.set_visibility(not now)
        for element in (self._stop, self._bar, self._what):
            element.set_visibility(now)

    def offer(self, chosen: Sequence[str]) -> None:
        """Offer the diagnosed effects step by step, without effects that are already selected.

        Args:
            chosen: names of the effects in the model.
        """
        if self._buttons is None:
            return
        self._buttons.clear()
        shown = self._state.diagnosis
        missing = [] if shown is None else [e.effect for e in shown.accepted if e.effect not in chosen]
        with self._buttons:
            for count in range(1, len(missing) + 1):
                names = missing[:count]
                ui.button(f"Add {' + '.join(names)}", on_click=partial(self._add, names)).props(
                    "dense outline no-caps"
                ).mark(f"add-{count}")

    def _show(self) -> None:
        try:
            diagnosis = self._state.diagnosis
        except InputError as error:
            ui.notify(str(error), type="warning")
            return
        self._answer.clear()
        self._buttons = None
        if diagnosis is None:
            return
        view, budget = diagnosis_verdict(diagnosis), budget_view(diagnosis)
        with self._answer:
            if budget is not None:
                with set_props(ui.element("div").classes("budget").mark("budget"), title=elements.BUDGET):
                    ui.label(budget.sentence)
                    if len(budget.parts) > 1:
                        # As an image, in which scripts never run.
                        drawn = b64encode(budget_svg(budget, _PICTURE_WIDTH).encode()).decode()
                        picture = f"data:image/svg+xml;base64,{drawn}"
                        set_props(ui.element("img"), src=picture, alt=budget.sentence)
                    for confusion in budget.confusions:
                        ui.label(confusion).classes("quiet")
            verdict = ui.element("div").classes("verdict").classes(view.word).mark("verdict")
            with set_props(verdict, title=elements.VERDICTS[view.word]):
                ui.label(view.sentence)
                for remark in view.remarks:
                    ui.label(remark).classes("quiet")
            self._buttons = ui.element("div").classes("steps")
            self.offer(self._state.choice.effects)
            if diagnosis.next_experiment is not None:
                following = diagnosis.next_experiment
                ui.label(f"Next: {following.instruction}, to {following.purpose}").classes("q-mt-sm")
            self._more()


def score_riddle(truth: Set[str], guessed: Set[str], named: Set[str], alike: Set[str]) -> str:
    """Compare the guesses of user and diagnosis with the hidden effects, in a few sentences.

    Args:
        truth: hidden effects.
        guessed: effects that the user had ticked.
        named: effects that the diagnosis named.
        alike: the named effects, and those that the diagnosis cannot distinguish from them.
    """

    def rated(names: Set[str]) -> str:
        if names == truth:
            return "right"
        if names & truth:
            return "partly right"
        is_alike = bool(names) and names <= alike
        return "accepted as right, because these data cannot tell them apart" if is_alike else "wrong"

    text = f"The hidden effect: {_listed(truth)}. You said {_listed(guessed)}: {rated(guessed)}. "
    text += f"The diagnosis said {_listed(named)}: {rated(named)}."
    if alike & truth and (others := alike - named):
        text += f" The diagnosis adds that these data cannot tell its answer from {_listed(others, ' or ')}."
    return text


def _listed(names: Set[str], joint: str = " and ") -> str:
    return joint.join(sorted(name.replace("_", " ") for name in names)) or "nothing"


def riddle_card(state: WorkbenchState, diagnose: Callable[[], Awaitable[None]]) -> None:
    """Create a card that asks the user which effect is hidden, and shows the answer.

    Args:
        state: state of the page.
        diagnose: diagnoses the selected channel.
    """

    async def judge() -> None:
        """Diagnose, open the sealed answer and score both."""
        guessed = set(state.choice.effects)
        button.disable()
        answer.set_text("the diagnosis looks for the effect, too")
        await diagnose()
        button.enable()
        diagnosis, path = state.diagnosis, state.study.source.path
        if diagnosis is None or path is None:
            answer.set_text("the diagnosis was stopped, so the sealed answer was not opened")
            return
        try:
            opened = await asyncio.to_thread(lambda: open_answer(Session.open(path)))
        except PalpateError as error:
            answer.set_text(str(error))
            return
        named = {entry.effect for entry in diagnosis.accepted}
        alike = {name for entry in diagnosis.accepted for name in entry.confused_with} | named
        answer.set_text(score_riddle({entry.name for entry in opened.hidden}, guessed, named, alike))

    with ui.element("section").classes("card"):
        heading("Riddle")
        ui.label(
            "The arm pressed an object with a spring, a damper and one more effect. Tick effects until "
            "the error falls to the noise level; then press the button."
        )
        button = ui.button("That is it", on_click=judge).props("unelevated dense no-caps").mark("guess")
        answer = ui.label().classes("text-bold").mark("score")
