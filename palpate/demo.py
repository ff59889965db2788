"""The first thing that a newcomer sees: probe, estimate, record and plot, in one go."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from control.probing_plan import ProbingPlan
from estimation.estimators import ESTIMATORS
from palpate.estimation_run import DEFAULT_MODEL, ChannelEstimates, Material, estimate_contact, load_material
from palpate.files import output_folder
from palpate.inspection import look_into
from palpate.probing_run import OnTick, ProbingJob, run_probing
from palpate.robots import DEFAULT, find_robot
from robot_io.errors import InputError
from sim_backend.scenario import Scenario

RECORDING = "recording.rrd"

Say = Callable[[str], None]


@dataclass(frozen=True)
class Demo:
    """What the demo made.

    Attributes:
        session: the session file.
        material: the session with channels and truth.
        found: estimates of the probed place, by every estimator.
        recording: for Rerun.
        plots: PNG files.
    """

    session: Path
    material: Material
    found: ChannelEstimates
    recording: Path
    plots: tuple[Path, ...]


def run_demo(session: Path, scenario: Scenario, seed: int | None, on_tick: OnTick | None, say: Say) -> Demo:
    """Probe an object at three speeds, and make everything of it that can be looked at.

    Args:
        session: the new session file; what is made from it goes into the folder of the same name.
        scenario: what is simulated.
        seed: of all noise, or None for the scenario's.
        on_tick: called in each tick of the probing.
        say: told what is being done.

    Raises:
        PalpateError: the arm was stopped, or something cannot be written.
    """
    plan = ProbingPlan()
    job = ProbingJob(
        find_robot(DEFAULT), plan, session, scenario=scenario, seed=seed, command_line="palpate demo"
    )
    run_probing(job.with_callback(on_tick)).loop.raise_for_trip()
    say("estimating")
    material = load_material(session)
    found = estimate_contact(material.contacts()[0], DEFAULT_MODEL, list(ESTIMATORS))
    say("writing recording and plots")
    return _pictures(session, material, found)


def _pictures(session: Path, material: Material, found: ChannelEstimates) -> Demo:
    if material.session is None:
        raise InputError(f"{session}: is no session")
    folder = output_folder(material.session.derived_dir)
    inspection = look_into(material.session, found)
    inspection.record(folder / RECORDING)
    return Demo(session, material, found, folder / RECORDING, tuple(inspection.plot(folder)))
