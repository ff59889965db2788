"""The page: builds its parts, handles clicks, and runs one fit at a time, the newest selection last."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui

from palpate.common.console import display_path
from palpate.common.files import derived_folder, output_folder
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data_quality import checklist, list_warnings
from palpate.estimation.estimate import with_unit
from palpate.render.build import REPORT
from palpate.robot_io.errors import InputError, PalpateError
from palpate.workbench import elements
from palpate.workbench.diagnosis import DiagnosisCard, riddle_card
from palpate.workbench.effects import EffectList
from palpate.workbench.elements import errors_as_warnings, heading, set_props
from palpate.workbench.parameters import ErrorCard, Parameters
from palpate.workbench.plots import PlotPanel
from palpate.workbench.startup import AppState
from palpate.workbench.state import DisplayedFit, ModelSelection, WorkbenchState

FOLLOW_S = 0.5  # time between checks for changes made in another tab [s]
_NEXT_S = 0.03  # pause in which the browser draws earlier updates
_KINDS = {
    ChannelKind.CONTACT: "contact force",
    ChannelKind.REVOLUTE: "joint torque",
    ChannelKind.PRISMATIC: "joint force",
    ChannelKind.SERVO: "goal error",
}


class Page:
    """View of the workbench in one browser."""

    def __init__(
        self,
        home: AppState,
        state: WorkbenchState,
        choose_other: Callable[[], None],
        next_step: Callable[[], None],
    ) -> None:
        """Show a state of the workbench.

        Args:
            home: state of the server.
            state: state to show.
            choose_other: called to offer another file.
            next_step: creates the elements below a diagnosis.
        """
        self._home, self.state = home, state
        self._choose_other, self._next_step = choose_other, next_step
        self._busy = asyncio.Lock()
        self._idle = asyncio.Event()
        self._idle.set()
        self._turn = 0
        self._shown: DisplayedFit | None = None

    async def build(self) -> None:
        """Build all parts: raw curves first, then the fit, then the evidence."""
        refused = self.state.study.refusal(self.state.channel)
        channel = self.state.choice.channel
        self._error = ErrorCard()
        self._header(refused)
        with ui.element("div").classes("desk"):
            with ui.element("div").classes("left"):
                if refused:
                    _data_checks(self.state)
                self._diagnosis = DiagnosisCard(self.state, self.add, self.on_diagnosed)
                if self._home.riddle:
                    riddle_card(self.state, self._diagnosis.start)
                self._diagnosis.build(self._next_step)
                self._effects = EffectList(self.state, self.tick)
                if not refused:
                    self._effects.build()
            with ui.element("div").classes("middle"):
                self._center = PlotPanel(self.state, self.use_runs)
                self._center.build()
            with ui.element("div").classes("right"):
                self._parameters = Parameters(self.state, self.choose, self.move_slider)
                if not refused:
                    self._error.build()
                    self._parameters.build()
                    _data_checks(self.state)
                with ui.element("section").classes("card same"):
                    heading("Equivalent commands", elements.SAME)
                    self._command = ui.label().classes("code").mark("command")
                    self._python = ui.label().classes("code").mark("python")
                self._revisions = ui.element("section").classes("card")
        self._show_commands()
        self._list_revisions()
        ui.keyboard(self._key, ignore=["input", "textarea"])

        async def begin() -> None:
            await self._change(self.state.show)
            if self._shown is not None:
                self._effects.fill()
                await self._effects.rank_effects(self._idle)

        async def follow() -> None:
            """Show the data, channel or model that another tab selected."""
            shown, choice = self._shown, self.state.choice
            if self._home.state is not self.state or choice.channel != channel:
                ui.navigate.reload()
            elif shown is not None and choice != shown.choice and self._idle.is_set():
                await self._change(self.state.show)

        if not refused:
            ui.timer(0.01, begin, once=True)
        ui.timer(FOLLOW_S, follow)

    async def tick(self, effect: str) -> None:
        """Add an effect, or remove it."""

        def toggled() -> ModelSelection:
            return self.state.toggled(effect)

        await self._change(lambda: self.state.choose(toggled()), toggled)

    async def choose(self, choice: ModelSelection) -> None:
        """Show another selection.

        Args:
            choice: the model to fit and show.
        """
        await self._change(lambda: self.state.choose(choice), lambda: choice)

    async def add(self, effects: Sequence[str]) -> None:
        """Select effects, as a diagnosis proposes.

        Args:
            effects: their names, in order.
        """
        choice = self.state.choice
        await self.choose(choice.with_effects(list(dict.fromkeys([*choice.effects, *effects]))))

    async def use_runs(self, out: Sequence[int], held_out: Sequence[int]) -> None:
        """Show a state in which runs are used differently.

        Args:
            out: runs excluded from fitting and scoring.
            held_out: runs excluded from fitting and used only for scoring.

        Raises:
            InputError: a channel would have no runs left, or none to fit.
        """
        if (tuple(sorted(out)), tuple(sorted(held_out))) != (self.state.out, self.state.study.held_out):
            self._show_state(await asyncio.to_thread(self.state.with_runs, out, held_out))

    def _show_state(self, state: WorkbenchState) -> None:
        self._home.state = state
        ui.navigate.reload()

    def on_diagnosed(self) -> None:
        """Use the noise level and the groups of effects of a finished diagnosis."""
        if self._shown is not None:
            self._effects.arrange()
            ui.timer(0.01, lambda: self._change(self.state.show), once=True)

    async def _change(
        self, work: Callable[[], DisplayedFit], coming: Callable[[], ModelSelection] | None = None
    ) -> None:
        """Fit, then show error and curves first, maps next, and intervals last.

        A preview of the selection is shown until a slow fit is complete.
        """
        self._turn += 1
        turn = self._turn
        self._idle.clear()
        try:
            async with self._busy:
                shown = await self._fit(work, coming)
                if shown is None:
                    return
                self._shown = shown
                self._error.show(shown)
                self._center.show(shown)
                self._show_commands()
                self._enable_steps()
                if shown.choice.slider_values:
                    self._draw_slider_values(shown)
            if turn == self._turn:
                await asyncio.sleep(_NEXT_S)
                self._parameters.show(shown)
                self._effects.show(shown.choice.effects)
                self._diagnosis.offer(shown.choice.effects)
                self._center.show_state()
                await asyncio.sleep(_NEXT_S)
                self._center.show_map()
                await asyncio.to_thread(shown.compute_intervals)
                if turn == self._turn:
                    self._parameters.show_intervals(shown.fitted.parameters)
                    self._error.judge(shown)
                    if self._shown is not None and self._shown.choice.slider_values:
                        self._draw_slider_values(self._shown)
        finally:
            if turn == self._turn:
                self._idle.set()

    async def _fit(
        self, work: Callable[[], DisplayedFit], coming: Callable[[], ModelSelection] | None
    ) -> DisplayedFit | None:
        """Preview the selection and fit it; return the fit shown before if that fails."""
        preview = None
        if coming is not None:
            with suppress(PalpateError):  # the fit reports the reason
                preview = await asyncio.to_thread(lambda: self.state.preview(coming()))
        if preview is not None:
            self._error.show(preview)
            self._center.show(preview)
            await asyncio.sleep(_NEXT_S)
        shown = self._shown
        with errors_as_warnings(multi_line=True, timeout=8000):
            shown = await asyncio.to_thread(work)
        return shown

    async def move_slider(self, name: str, value: float) -> None:
        """Draw the model with a slider at a value: curves first, then all other views.

        Args:
            name: name of the parameter.
            value: value of the slider, in the parameter's SI unit.
        """
        before = self._shown
        if before is None or before.choice.fitted != self.state.choice.fitted:
            return  # another model is being fitted
        if name not in before.fitted.values:
            return
        self.state.move_slider(name, value)
        shown = self._shown = replace(before, choice=self.state.choice)
        self._draw_slider_values(shown)
        self._parameters.mark_slider_values(shown)
        self._enable_steps()
        await asyncio.sleep(_NEXT_S)
        if shown is self._shown:
            self._center.show_state()
            await asyncio.sleep(_NEXT_S)
        if shown is self._shown:
            self._center.show_map()

    def _show_commands(self) -> None:
        self._command.set_text(self.state.command() or "only in Python:")
        self._python.set_text(self.state.python())

    def _draw_slider_values(self, shown: DisplayedFit) -> None:
        predicted, scored = shown.fitted.predict(shown.values), shown.base.scored
        self._center.preview(predicted)
        error = float(np.sqrt(np.mean((shown.fitted.data.effort - predicted)[scored] ** 2)))
        self._error.preview(shown, error)

    def _header(self, refused: str | None) -> None:
        study, choice = self.state.study, self.state.choice

        async def choose_channel(event: events.ValueChangeEventArguments[Any]) -> None:
            try:
                await asyncio.to_thread(self.state.to_channel, event.value)
            except InputError:  # the channel cannot be judged: show its raw curves and the reason
                self.state.set_choice(ModelSelection(event.value))
            ui.navigate.reload()

        with ui.element("div").classes("top"):
            ui.label("palpate").classes("brand")
            ui.label(study.source.name).classes("file")
            if not refused:
                self._error.build_number()
            options = {
                channel.name: f"{channel.name.replace('_', ' ')} · {_KINDS[channel.kind]}"
                for channel in study.channels
            }
            chooser = ui.select(options, value=choice.channel, on_change=choose_channel)
            chooser.props("dense outlined options-dense aria-label=channel")
            chooser.classes("channel").mark("channel")
            ui.label(f"base model {self.state.channel.model.name}").classes("quiet wide")
            ui.space()
            _button("Open", "folder_open", self._choose_other, "Another file or session, or a new probe")
            self._undo = _button("Undo", "undo", lambda: self._step(self.state.undo), "Ctrl+Z")
            self._redo = _button("Redo", "redo", lambda: self._step(self.state.redo), "Ctrl+Shift+Z")
            self._enable_steps()
            _button("Keep", "bookmark_add", self.save_revisions, elements.KEEP)
            about = "Write report.html with all that is shown"
            _button("Report", "description", self.write_report, about, look="unelevated")

    def _enable_steps(self) -> None:
        self._undo.set_enabled(self.state.can_undo)
        self._redo.set_enabled(self.state.can_redo)

    async def _step(self, work: Callable[[], WorkbenchState]) -> None:
        before = self.state.choice.channel
        state = await asyncio.to_thread(work)
        if state is not self.state:
            self._show_state(state)
        elif state.choice.channel != before:
            ui.navigate.reload()
        else:
            await self._change(state.show)

    async def _key(self, event: events.KeyEventArguments) -> None:
        if event.action.keydown and event.modifiers.ctrl and event.key.name in {"z", "Z", "y"}:
            again = event.key.name == "y" or event.modifiers.shift
            await self._step(self.state.redo if again else self.state.undo)

    async def save_revisions(self) -> None:
        """Save the selected effects as a revision."""
        with errors_as_warnings():
            revisions = await asyncio.to_thread(self.state.save_revisions)
            folder = self.state.study.folder
            place = "in memory only" if folder is None else f"in {display_path(folder)}"
            text = f"kept as revision {revisions[-1].number} {place}{self.state.use_of_runs}"
            ui.notify(text + _not_kept(self.state.choice), type="positive")
            self._list_revisions()

    async def write_report(self) -> None:
        """Save the selected effects as a revision, write their report, and link to it."""
        study = self.state.study
        path = study.source.path
        folder = study.folder or (derived_folder(path) if path is not None else Path("palpate-data"))
        with errors_as_warnings():
            if self.state.choice.effects and not self.state.is_saved:
                await asyncio.to_thread(self.state.save_revisions)
            commands = [line for line in [self.state.command()] if line]
            written = await asyncio.to_thread(lambda: study.report(output_folder(folder) / REPORT, commands))
            self._list_revisions()
            address = self._home.serve_report(written)
            link = f'<a href="{address}" target="_blank">report: {escape(str(written))}</a>'
            ui.notify(
                link + self.state.use_of_runs + _not_kept(self.state.choice),
                type="positive",
                multi_line=True,
                timeout=10_000,
                html=True,
            )

    def _list_revisions(self) -> None:
        self._revisions.clear()
        with self._revisions:
            heading("Revisions", elements.REVISIONS)
            channel = self.state.channel
            data = channel.name, channel.sha256
            saved = self.state.study.revisions
            revisions = [each for each in saved if (each.channel, each.data_sha256) == data]
            for revision in reversed(revisions[-8:]):
                terms = " + ".join([revision.model, *revision.effects])
                text = f"{revision.number} · {with_unit(revision.rmse, revision.effort_unit)} · {terms}"
                work = partial(self._change, partial(self.state.to_revision, revision))
                ui.button(text, on_click=work).props("flat dense no-caps align=left").classes("revision")
            if not revisions:
                others = saved or (self.state.whole or self.state).study.revisions
                of_these = " of this channel with these runs" if others else ""
                ui.label(f"no revisions{of_these} yet").classes("quiet")


def _not_kept(choice: ModelSelection) -> str:
    return elements.NOT_KEPT if choice.slider_values or choice.held or choice.bounds else ""


def _button(text: str, icon: str, work: Callable[[], object], about: str, look: str = "flat") -> ui.button:
    """Make a button of the header."""
    made = ui.button(text, icon=icon, on_click=work).mark(text.lower()).props("dense no-caps")
    # a narrow window shows only the icon
    return set_props(made, aria_label=text, title=f"{text}: {about}", **{look: True})


def _data_checks(state: WorkbenchState) -> None:
    """Make the checklist of the data checks, with the notes on how the data were read."""
    reasons = checklist(state.channel.to_fit, state.channel.model)
    with ui.element("section").classes("card"):
        heading("Are these data fit for a diagnosis?", elements.GATES)
        rows = []
        for kind, text in elements.GATE.items():
            if kind not in reasons:
                rows.append(f'<li class="quiet">· {text}: not checked</li>')
            elif reasons[kind]:
                rows.append(f'<li class="bad">✗ {text}<br><span>{escape(reasons[kind])}</span></li>')
            else:
                rows.append(f'<li class="good">✓ {text}</li>')
        notes = (*state.study.notes, *list_warnings(state.study.warnings.items()))
        rows += [f'<li class="note">! {escape(note)}</li>' for note in notes]
        ui.html(f'<ul class="gates">{"".join(rows)}</ul>').mark("gates")
