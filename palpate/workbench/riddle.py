"""The riddle: something is hidden in the simulated object; who finds it, you or the diagnosis?"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from nicegui import ui

from palpate.runs.hidden_effects import open_answer
from palpate.runs.robots import DEFAULT_SCENARIO
from palpate.workbench.elements import heading
from palpate.workbench.state import WorkbenchState
from palpate.workflows.demo import HIDDEN_PLAN, drawn_seed, hide_one, probe_demo
from robot_io.errors import PalpateError
from robot_io.session import Session
from sim_backend.scenario import load_scenario

HIDDEN = (
    *("adhesion", "cubic_stiffness", "delay", "dry_friction", "layered_stiffness", "plastic_set"),
    *("quadratic_damping", "stress_relaxation"),
)


def pose(folder: Path) -> Path:
    """Probe an object in which one of `HIDDEN` is hidden; the answer is sealed beside the session.

    Raises:
        PalpateError: the session cannot be written.
    """
    drawn = drawn_seed()
    world = hide_one(load_scenario(DEFAULT_SCENARIO), np.random.default_rng(drawn), HIDDEN)
    session = folder / f"riddle-{drawn}.mcap"
    probe_demo(session, world, drawn, plan=HIDDEN_PLAN, command_line="palpate workbench --riddle")
    return session


@dataclass(frozen=True)
class RiddleScore:
    """Who was right."""

    truth: frozenset[str]  # what was hidden
    guessed: frozenset[str]  # what the user had ticked
    found: frozenset[str]  # what the diagnosis named
    alike: frozenset[str]  # effects that the diagnosis says this data cannot tell from what it named

    def in_words(self) -> str:
        """The result in a few sentences."""
        said = f"Hidden was {_listed(self.truth)}. "
        said += f"You said {_listed(self.guessed)}: {self._rated(self.guessed)}. "
        said += f"The diagnosis said {_listed(self.found)}: {self._rated(self.found)}."
        if self.alike & self.truth and (others := self.alike - self.found):
            said += f" It adds that this data cannot tell that from {_listed(others, ' or ')}."
        return said

    def _rated(self, names: frozenset[str]) -> str:
        if names == self.truth:
            return "right"
        if names & self.truth:
            return "partly right"
        return (
            "as good as right, this data cannot tell them apart" if names and names <= self.alike else "wrong"
        )


def _listed(names: frozenset[str], joint: str = " and ") -> str:
    return joint.join(sorted(name.replace("_", " ") for name in names)) or "nothing"


class RiddleCard:
    """Where the user says what is hidden, and hears the answer."""

    def __init__(self, state: WorkbenchState, diagnose: Callable[[], Awaitable[None]]) -> None:
        self._state, self._diagnose = state, diagnose

    def build(self) -> None:
        """Put the elements."""
        with ui.element("section").classes("card"):
            heading("Riddle")
            ui.label(
                "The arm pressed an object that is a spring and a damper, and one thing more. Tick what you "
                "think it is until the error falls to the noise level; then say so."
            )
            self._button = (
                ui.button("That is it", on_click=self._judge).props("unelevated dense no-caps").mark("guess")
            )
            self._answer = ui.label().classes("text-bold").mark("score")

    async def _judge(self) -> None:
        guessed = frozenset(self._state.choice.effects)
        self._button.disable()
        self._answer.set_text("the diagnosis is thinking about it, too")
        await self._diagnose()
        self._button.enable()
        found, path = self._state.diagnosis, self._state.study.source.path
        if found is None or path is None:
            self._answer.set_text("stopped: no answer was opened")
            return
        try:
            answer = await asyncio.to_thread(lambda: open_answer(Session.open(path)))
        except PalpateError as error:
            self._answer.set_text(str(error))
            return
        named = frozenset(entry.effect for entry in found.accepted)
        alike = frozenset(name for entry in found.accepted for name in entry.confused_with) | named
        self._answer.set_text(
            RiddleScore(frozenset(e.name for e in answer.hidden), guessed, named, alike).in_words()
        )
