"""The second part of the demo: something is hidden in the object, found, added, and only then revealed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from control.probing.plan import ProbingPlan
from estimation.study import ChannelResult
from estimation.study.channels import CONTACT_MODEL
from estimation.study.engine import Progress
from estimation.study.kept_diagnosis import RESULT
from palpate.demo.probe import probe_demo
from palpate.files import output_folder
from palpate.outcome import as_json, write_outcome
from palpate.runs.hiding import open_answer
from palpate.runs.probing import NOBODY, Watcher
from palpate.study import Study
from palpate.words import typed as typed_path
from robot_io.session import Session
from sim_backend.contact_laws import KelvinVoigt
from sim_backend.hidden import noise_scale
from sim_backend.imperfection import IMPERFECTIONS
from sim_backend.noise_scale import CONTACT
from sim_backend.scenario import Scenario
from sim_backend.secret import Answer, sealed_path

HIDDEN = ("stress_relaxation", "cubic_stiffness", "quadratic_damping")
STRENGTH = 20.0  # times the noise floor
_SEEDS = 1_000_000  # few enough to be typed
PLAN = ProbingPlan(repeats=2)


@dataclass(frozen=True)
class HiddenDemo:
    """What the second part made.

    Attributes:
        session: the session file.
        result: what was found out, stage by stage.
        files: result, report, picture and recording.
        answer: what was hidden.
    """

    session: Path
    result: ChannelResult
    files: dict[str, Path]
    answer: Answer

    @property
    def found(self) -> bool:
        """Whether what was hidden is what was named, and nothing else."""
        return self.result.added == [entry.name for entry in self.answer.hidden]


def can_hide(scenario: Scenario) -> bool:
    """Whether the demo's base model is that of the object, so that all that is missing is what is hidden."""
    return isinstance(scenario.object.law, KelvinVoigt)


def drawn_seed() -> int:
    """A seed for one demo: another each time, and short enough to be typed for that demo again."""
    return int(np.random.default_rng().integers(_SEEDS))


def hide_one(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """The world with one effect hidden in its object."""
    effect = IMPERFECTIONS[str(rng.choice(HIDDEN))]
    return scenario.with_hidden([effect.at_strength(STRENGTH, CONTACT, noise_scale(scenario), rng)])


def probe_hidden(
    session: Path,
    scenario: Scenario,
    seed: int | None,
    watcher: Watcher = NOBODY,
    *,
    command_line: str = "palpate demo",
) -> Path:
    """Probe the world; what is hidden is sealed beside the session; see `palpate.demo.probe.probe_demo`.

    Returns:
        The sealed file.

    Raises:
        KeyboardInterrupt: the user stopped it.
        PalpateError: the arm was stopped, nothing was touched, or the session cannot be written.
    """
    probe_demo(session, scenario, seed, watcher, PLAN, command_line=command_line)
    return sealed_path(session)


def solve(session: Path, progress: Progress) -> HiddenDemo:
    """Diagnose, add what is missing, draw it, and then open the answer.

    Raises:
        InputError: something cannot be written.
    """
    study = Study(session, CONTACT_MODEL)
    folder = output_folder(Session.open(session).derived_dir)
    diagnosis = study.diagnose(apply=True, progress=progress)
    (result,) = study.results()
    typed = f"palpate diagnose {typed_path(session)} --model {CONTACT_MODEL} --apply"
    texts = {RESULT: as_json(study.diagnosis_data(diagnosis))}
    files = write_outcome(folder, study, [result], [typed], texts)
    return HiddenDemo(
        session, result, {"result": folder / RESULT, **files}, open_answer(Session.open(session))
    )
