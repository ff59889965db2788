"""The first thing that a newcomer sees: probe, estimate, record and plot, in one go."""

from dataclasses import dataclass
from pathlib import Path

from control.probing.plan import ProbingPlan
from estimation.study import ChannelEstimates
from estimation.study.channels import CONTACT_MODEL
from palpate.files import output_folder
from palpate.render.inspection import RECORDING, look_into
from palpate.runs.probing import NOBODY, ProbingJob, Watcher, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from palpate.study import Study
from robot_io.session import Session
from sim_backend.scenario import Scenario

PLAN = ProbingPlan()  # the paper's three speeds


@dataclass(frozen=True)
class Demo:
    """What the demo made.

    Attributes:
        session: the session file.
        study: the session with channels and truth.
        found: estimates of the probed place, by every estimator.
        recording: for Rerun.
        plots: pages of figures.
    """

    session: Path
    study: Study
    found: ChannelEstimates
    recording: Path
    plots: tuple[Path, ...]


def probe_demo(
    session: Path,
    scenario: Scenario,
    seed: int | None,
    watcher: Watcher = NOBODY,
    plan: ProbingPlan = PLAN,
    *,
    command_line: str = "palpate demo",
) -> None:
    """Probe a simulated object, by default once at three speeds.

    Args:
        session: the new session file.
        scenario: what is simulated.
        seed: of all noise, or None for the scenario's.
        watcher: told how far it is.
        plan: speeds and repeats.
        command_line: what makes the same session again.

    Raises:
        KeyboardInterrupt: the user stopped it.
        PalpateError: the arm was stopped, nothing was touched, or the session cannot be written.
    """
    job = ProbingJob(
        find_robot(DEFAULT), session, plan, scenario=scenario, seed=seed, command_line=command_line
    )
    run_probing(job, watcher).raise_for_failure()


def show_demo(session: Path) -> Demo:
    """Estimate, and make everything that can be looked at, in the folder of the session's own name.

    Raises:
        InputError: something cannot be written.
    """
    study = Study(session, CONTACT_MODEL)
    found = study.estimate()[0]
    opened = Session.open(session)
    folder = output_folder(opened.derived_dir)
    inspection = look_into(opened, found)
    inspection.record(folder / RECORDING)
    return Demo(session, study, found, folder / RECORDING, tuple(inspection.plot(folder)))
