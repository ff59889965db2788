"""The first thing that a newcomer sees: probe, estimate, record and plot, in one go."""

from dataclasses import dataclass
from pathlib import Path

from control.probing.plan import ProbingPlan
from estimation.estimators import ESTIMATORS
from palpate.arm.probing_run import NOBODY, ProbingJob, Watcher, run_probing
from palpate.arm.robots import DEFAULT, find_robot
from palpate.files import output_folder
from palpate.findings.estimation_run import (
    DEFAULT_MODEL,
    ChannelEstimates,
    Material,
    estimate_with,
    load_material,
)
from palpate.render.inspection import RECORDING, look_into
from robot_io.session import Session
from sim_backend.scenario import Scenario

PLAN = ProbingPlan()  # the paper's three speeds


@dataclass(frozen=True)
class Demo:
    """What the demo made.

    Attributes:
        session: the session file.
        material: the session with channels and truth.
        found: estimates of the probed place, by every estimator.
        recording: for Rerun.
        plots: pages of figures.
    """

    session: Path
    material: Material
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
        find_robot(DEFAULT), plan, session, scenario=scenario, seed=seed, command_line=command_line
    )
    run_probing(job, watcher).raise_for_failure()


def show_demo(session: Path) -> Demo:
    """Estimate, and make everything that can be looked at, in the folder of the session's own name.

    Raises:
        InputError: something cannot be written.
    """
    material = load_material(session, tared=True)
    found = estimate_with(material.described_by(DEFAULT_MODEL)[0], DEFAULT_MODEL, list(ESTIMATORS))
    opened = Session.open(session)
    folder = output_folder(opened.derived_dir)
    inspection = look_into(opened, found)
    inspection.record(folder / RECORDING)
    return Demo(session, material, found, folder / RECORDING, tuple(inspection.plot(folder)))
