"""The demo: probe, estimate and draw; then find a hidden effect in another object."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from palpate.common.console import json_text, shell_path
from palpate.common.files import output_folder
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.study import ChannelEstimates, ChannelResult
from palpate.estimation.study.channels import CONTACT_MODEL
from palpate.estimation.study.fitting import Progress
from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.render.build import write_outcome
from palpate.render.inspection import RECORDING, inspect_session
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import open_answer
from palpate.runs.probing import NOBODY, ProbingJob, Watcher, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from palpate.sim_backend.hidden import SealedAnswer, noise_scale
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.noise_scale import CONTACT
from palpate.sim_backend.scenario import Scenario
from palpate.study import Study

PLAN = ProbingPlan()  # the paper's three speeds
HIDDEN_PLAN = ProbingPlan(repeats=2)
HIDDEN = ("stress_relaxation", "cubic_stiffness", "quadratic_damping")
STRENGTH = 20.0  # times the noise level
_SEEDS = 1_000_000  # small enough to be typed


@dataclass(frozen=True)
class HiddenDemo:
    """Results of the second part of the demo: the diagnosis of a hidden effect."""

    session: Path  # the session file
    result: ChannelResult  # result, stage by stage
    files: dict[str, Path]  # result, report, picture and recording
    answer: SealedAnswer  # what was hidden

    @property
    def found(self) -> bool:
        """Whether the diagnosis named exactly the hidden effects."""
        return self.result.added == [entry.name for entry in self.answer.hidden]


def probe_demo(
    session: Path,
    scenario: Scenario,
    seed: int | None,
    watcher: Watcher = NOBODY,
    plan: ProbingPlan = PLAN,
    *,
    command_line: str = "palpate demo",
) -> None:
    """Probe a simulated object, by default once at three speeds; hidden effects are sealed beside.

    Args:
        session: the new session file.
        scenario: the simulated world.
        seed: seed of all noise; None for the scenario's seed.
        watcher: receives the progress.
        plan: speeds and repeats.
        command_line: command line that makes the same session again.

    Raises:
        KeyboardInterrupt: the user stopped it.
        PalpateError: the arm was stopped, nothing was touched, or the session cannot be written.
    """
    job = ProbingJob(
        find_robot(DEFAULT), session, plan, scenario=scenario, seed=seed, command_line=command_line
    )
    run_probing(job, watcher).raise_for_failure()


def show_demo(session: Path) -> tuple[Study, ChannelEstimates, Path | None, Path]:
    """Estimate, and write recording and plots into the session's folder.

    Args:
        session: file of the first part.

    Returns:
        The session's study, estimates of the probed place by every estimator, the recording (None where
        Rerun is not installed), and the page of figures.

    Raises:
        InputError: something cannot be written.
    """
    study = Study(session, CONTACT_MODEL)
    estimates = study.estimate()[0]
    opened = Session.open(session)
    folder = output_folder(opened.derived_dir)
    inspection = inspect_session(opened, estimates)
    recording = folder / RECORDING if find_spec("rerun") else None
    if recording is not None:
        inspection.record(recording)
    return study, estimates, recording, inspection.plot(folder)


def drawn_seed() -> int:
    """Draw a seed that is short enough to be typed again."""
    return int(np.random.default_rng().integers(_SEEDS))


def hide_one(scenario: Scenario, rng: np.random.Generator, among: tuple[str, ...] = HIDDEN) -> Scenario:
    """Return the world with one random effect hidden in its object.

    Args:
        scenario: the world.
        rng: draws the effect and its values.
        among: names of the effects.
    """
    effect = IMPERFECTIONS[str(rng.choice(among))]
    return scenario.with_hidden([effect.at_strength(STRENGTH, CONTACT, noise_scale(scenario), rng)])


def solve(session: Path, progress: Progress) -> HiddenDemo:
    """Diagnose, add what is missing, draw it, and then open the answer.

    Args:
        session: file of the second part.
        progress: called with the current step and the share of it that is done.

    Raises:
        InputError: something cannot be written.
    """
    study, opened = Study(session, CONTACT_MODEL), Session.open(session)
    folder = output_folder(opened.derived_dir)
    diagnosis = study.diagnose(apply=True, progress=progress)
    (result,) = study.results()
    again = f"palpate diagnose {shell_path(session)} --model {CONTACT_MODEL} --apply"
    texts = {RESULT: json_text(study.diagnosis_data(diagnosis))}
    files = write_outcome(folder, study, [result], [again], texts)
    return HiddenDemo(session, result, {"result": folder / RESULT, **files}, open_answer(opened))
