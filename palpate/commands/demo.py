"""`palpate demo`: run the whole workflow once without questions."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from palpate.common import console
from palpate.common.console import as_command, display_path, json_text, shell_path, significant
from palpate.common.files import output_file, output_folder, output_session
from palpate.common.options import JsonOption, SessionOutOption, scenario_names
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.study import ChannelEstimates, ChannelResult
from palpate.estimation.study.channels import CONTACT_MODEL
from palpate.estimation.study.fitting import Progress
from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.render.build import result_view, write_outcome
from palpate.render.estimates import as_data, print_estimates
from palpate.render.inspection import RECORDING, inspect_session
from palpate.render.progress import diagnosis_progress, probing_progress
from palpate.render.terminal import print_files, print_stages
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import open_answer
from palpate.runs.options import ENGINE, SESSIONS, time_stamp
from palpate.runs.probing import NO_WATCHER, ProbingJob, Watcher, run_probing
from palpate.runs.robots import DEFAULT, DEFAULT_SCENARIO, find_robot
from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.engines import EngineName
from palpate.sim_backend.hidden import SealedAnswer, noise_scale, sealed_path
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.noise_scale import CONTACT
from palpate.sim_backend.scenario import MOST_SEED, Scenario, load_scenario, shipped_scenarios
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

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data; the keys are stable."""
        return {
            "session": self.session,
            "files": self.files,
            "diagnosis": self.result.diagnosis,
            "answer": [{"effect": entry.name, **entry.model_dump()} for entry in self.answer.hidden],
            "found": self.found,
        }


_SCENARIO = f"Simulated world: a file, or one of {', '.join(shipped_scenarios())}."
_SEED = "Seed of simulated noise and hidden effects; default: random."


def demo_command(
    scenario: Annotated[str, Option(help=_SCENARIO, autocompletion=scenario_names)] = DEFAULT_SCENARIO,
    engine: Annotated[EngineName | None, Option(help=ENGINE)] = None,
    seed: Annotated[int | None, Option(help=_SEED, min=0, max=MOST_SEED)] = None,
    out: SessionOutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Probe a simulated object and estimate its stiffness, then find a hidden effect in another object.

    Writes two session files, NAME.mcap and NAME-hidden.mcap, each with a folder of results. Takes less
    than a minute.
    """
    world = load_scenario(scenario)
    if engine is not None:
        world = world.with_engine(engine)
    session = output_session(out or SESSIONS / f"demo-{time_stamp()}.mcap")
    # With another law, the base model would miss more than the hidden effect.
    can_hide = isinstance(world.object.law, KelvinVoigtLaw)
    second = output_file(session.with_name(f"{session.stem}-hidden.mcap")) if can_hide else None
    if seed is None and second is not None:
        seed = drawn_seed()
    named = None if scenario == DEFAULT_SCENARIO else scenario
    given = {"--scenario": named, "--engine": engine, "--seed": seed}
    chosen = [word for name, value in given.items() if value is not None for word in (name, str(value))]
    again = as_command(["demo", *chosen])
    stderr = console.stderr()
    seeded = "" if seed is None else f" (seed {seed})"
    stderr.print(
        f"A simulated arm probes [bold]{world.description or scenario}[/bold] at three speeds{seeded}."
    )
    with probing_progress(PLAN, live=True) as watcher:
        probe_demo(session, world, seed, watcher, command_line=again)
    with stderr.status("estimating, recording and plotting"):
        study, estimates, recording, plots = show_demo(session)
    truth = study.truth_of(estimates.channel)
    if not as_json:
        out_ = console.stdout()
        print_estimates(out_, estimates, truth)
        out_.print()
        recorded = {} if recording is None else {"recording": recording}
        print_files(out_, {"session": session, **recorded})
        print_files(out_, {"plots": plots})
    hidden = None
    if second is not None:
        stderr.print("\n[bold]Now the object has a hidden effect that the model lacks.[/bold]")
        world = hide_one(world, np.random.default_rng(seed))
        with probing_progress(HIDDEN_PLAN, live=True) as watcher:
            probe_demo(second, world, seed, watcher, HIDDEN_PLAN, command_line=again)
        stderr.print(f"probed again; the hidden effect is stored in {display_path(sealed_path(second))}")
        with diagnosis_progress(["contact"]) as progress:
            hidden = solve(second, progress)
    if as_json:
        console.print_json(
            {
                "again": again,
                "session": session,
                "recording": recording,
                "plots": [plots],
                "result": as_data(estimates, truth),
                "hidden": None if hidden is None else hidden.as_data(),
            }
        )
        return
    if hidden is not None:
        _print_hidden(hidden)
    own_arm = "check your own arm before it gets power (docs/how-to/hardware.md)"
    steps = [
        (f"palpate inspect {shell_path(session)}", "see arm, forces and estimates in Rerun"),
        ("palpate doctor --robot ARM.yaml", own_arm),
    ]
    if hidden is not None:
        if "recording" in hidden.files:
            steps.insert(1, console.rerun_step(hidden.files["recording"]))
        steps.insert(
            2, ("palpate probe --hidden random --seed 7", "another hidden effect, drawn from all effects")
        )
    console.next_steps(*steps, (again, "the same demo again"))


def _print_hidden(hidden: HiddenDemo) -> None:
    """Print the diagnosis of the second part, and what the sealed answer says."""
    out = console.stdout()
    print_stages(out, result_view(hidden.result))
    answer = "; ".join(
        f"[bold]{entry.name}[/bold] ("
        + ", ".join(f"{name} {significant(value)} {unit}" for name, (value, unit) in entry.values().items())
        + ")"
        for entry in hidden.answer.hidden
    )
    mark = "[bold green]CORRECT[/bold green]" if hidden.found else "[bold yellow]NOT FOUND[/bold yellow]"
    out.print(f"{mark}  the hidden effect was {answer}\n")
    print_files(out, {"session": hidden.session, **hidden.files})


def probe_demo(
    session: Path,
    scenario: Scenario,
    seed: int | None,
    watcher: Watcher = NO_WATCHER,
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
