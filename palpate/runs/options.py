"""Options of all commands that run an arm, and the confirmation before a real arm gets power."""

import functools
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from palpate.common import console
from palpate.common.console import as_shell_word, count, safe
from palpate.common.files import existing_file, output_session
from palpate.common.options import JsonOption, scenario_names
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import RobotFile
from palpate.runs.hidden_effects import command_line, hidden_names
from palpate.runs.robots import DEFAULT, find_robot, importable, robot_names, shipped_robots
from palpate.sim_backend.engines import EngineName
from palpate.sim_backend.scenario import MOST_SEED, load_scenario, shipped_scenarios

SESSIONS = Path("sessions")
YEAR_DAYS = 365.0
_ROBOT = f"Robot file, or a shipped arm: {', '.join(shipped_robots())}."
_SCENARIO = f"Simulated world: a file, or one of {', '.join(shipped_scenarios())}."
ENGINE = "Physics engine of the simulated world; default: the scenario's, otherwise PyBullet if installed."
_HIDDEN = "Hide effects in the simulated world: random, an effect's name, or a YAML file that lists effects."
_WIRE = "Run the real drivers with emulated devices, without any hardware."
_DRIVERS = "Python package with your own drivers."
YesOption = Annotated[bool, Option("--yes", help="Do not ask before a real arm gets power.")]


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Which arm runs: real, emulated or simulated."""

    robot: Annotated[str, Option(help=_ROBOT, autocompletion=robot_names)] = DEFAULT
    scenario: Annotated[str | None, Option(help=_SCENARIO, autocompletion=scenario_names)] = None
    engine: Annotated[EngineName | None, Option(help=ENGINE)] = None
    seed: Annotated[
        int | None,
        Option(help="Seed of the simulated noise; default: that of the scenario.", min=0, max=MOST_SEED),
    ] = None
    hidden: Annotated[str | None, Option(help=_HIDDEN, metavar="WHAT", autocompletion=hidden_names)] = None
    wire: Annotated[bool, Option("--wire", help=_WIRE)] = False
    realtime: Annotated[bool, Option("--realtime", help="Simulate no faster than real time.")] = False
    drivers: Annotated[list[str] | None, Option(help=_DRIVERS, metavar="PACKAGE")] = None
    as_json: JsonOption = False

    @functools.cached_property
    def robot_file(self) -> RobotFile:
        """The arm's file."""
        return find_robot(self.robot)

    @property
    def job(self) -> dict[str, Any]:
        """Keyword arguments of an `ArmJob`."""
        return {
            "scenario": load_scenario(self.scenario) if self.scenario is not None else None,
            "engine": self.engine,
            "seed": self.seed,
            "hidden": self.hidden,
            "wired": self.wire,
            "paced": self.realtime,
            "drivers": importable(self.drivers or []),
            "command_line": command_line(sys.argv[1:], self.hidden),
        }

    @property
    def robot_words(self) -> str:
        """Options that name the same robot in another command."""
        packages = "".join(f" --drivers {as_shell_word(package)}" for package in self.drivers or ())
        return f"--robot {as_shell_word(self.robot)}{packages}"

    def stamped_name(self, kind: str = "") -> str:
        """Return a new file name with the arm and the current time.

        Args:
            kind: last part of the name; empty for none.
        """
        return "-".join(filter(None, (time_stamp(), self.robot_file.name, kind)))

    def session_file(self, out: Path | None, kind: str = "", keep: Iterable[Path] = ()) -> Path:
        """Return the path of the session to write, as `output_session` does.

        Args:
            out: path from the user; None for a new name in `SESSIONS`.
            kind: last part of the new name; empty for none.
            keep: input files, which are never replaced.

        Raises:
            InputError: see `output_session`.
        """
        return output_session(out or SESSIONS / f"{self.stamped_name(kind)}.mcap", keep)


def time_stamp() -> str:
    """Return the current local time as a part of a new file's name."""
    return f"{datetime.now().astimezone():%Y%m%d-%H%M%S}"


def probing_plan(experiment: Path | None, usual: ProbingPlan | None = None) -> ProbingPlan:
    """Read a probing plan.

    Args:
        experiment: YAML file from the user; None for the usual plan.
        usual: plan without a file; None for the default of each setting.

    Raises:
        InputError: the file does not exist, or is not a plan.
    """
    if experiment is None:
        return usual or ProbingPlan()
    return ProbingPlan.load(existing_file(experiment, "experiment"))


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions(RunOptions):
    """Input and output of a calibration."""

    from_: Annotated[
        Path | None,
        Option("--from", help="Compute the calibration from this file, without the arm.", metavar="FILE"),
    ] = None
    out: Annotated[Path | None, Option("--out", "-o", help="Calibration file to write (YAML).")] = None
    session: Annotated[Path | None, Option(help="Session file to write.")] = None
    valid_days: Annotated[float, Option(help="Period of validity.", metavar="DAYS", min=0.01, max=3650)] = (
        YEAR_DAYS
    )
    accept_implausible: Annotated[
        bool,
        Option("--accept-implausible", help="Write a calibration even if its values are implausible."),
    ] = False


@dataclass(frozen=True, kw_only=True)
class MotionOptions(CalibrateOptions):
    """Options of calibrations that power a real arm."""

    yes: YesOption = False


def parse_numbers(option: str, text: str, example: str = "") -> list[float]:
    """Parse comma-separated numbers; raise `InputError` if invalid or too large.

    Args:
        option: name of the option, for errors.
        text: text as typed.
        example: added to the error, such as ", such as 1,2".
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} {text!r}: give numbers separated by commas{example}") from None
    if not all(abs(number) < 1e6 for number in values):  # true for NaN as well
        raise InputError(f"{option} {text!r}: give finite numbers between -1000000 and 1000000")
    return values


def parse_joint_angles(option: str, text: str, robot_file: RobotFile) -> list[float]:
    """Parse one angle per joint [rad], or "home"; raise `InputError` if invalid or of the wrong number.

    Args:
        option: name of the option, for errors.
        text: angles as typed, or "home".
        robot_file: robot file of the arm.
    """
    if text == "home":
        return list(robot_file.home_rad)
    angles = parse_numbers(option, text)
    if len(angles) != robot_file.joint_count:
        raise InputError(
            f"{option} {text!r}: {len(angles)} angles, but the robot has {robot_file.joint_count} joints"
        )
    return angles


COUNTDOWN_S = 3
Permission = Callable[[], None]


def without_question() -> None:
    """Grant power without asking, for simulated arms and for programs with their own confirmation."""


def ask_for_power(motion: str, *, yes: bool, pause: Callable[[float], None] = time.sleep) -> None:
    """Describe a real arm's motion, ask for confirmation, and count down before the arm gets power.

    Args:
        motion: the planned motion, in one sentence.
        yes: whether permission was already given; then only the countdown runs.
        pause: waits for a number of seconds.

    Raises:
        InputError: the answer was no, or there is no terminal to ask at; nothing has moved.
    """
    if not yes and not sys.stdin.isatty():
        raise InputError(
            "a person must confirm before a real arm gets power; run this in a terminal, or add --yes "
            "(or --wire, to emulate the devices)"
        )
    stderr = console.stderr()
    stderr.print(f"[bold]{safe(motion)}[/bold]")
    stderr.print("Keep clear of the arm and of the space below it, and hold its power switch in your hand.")
    if not yes:
        stderr.print("Power the arm now? \\[y/N]: ", end="")  # stdout is reserved for --json
        if sys.stdin.readline().strip().lower() not in ("y", "yes"):
            raise InputError("permission to power the arm denied: nothing has moved")
    for left_s in range(COUNTDOWN_S, 0, -1):
        stderr.print(f"power in {left_s} s; Ctrl-C cancels")
        pause(1.0)


def describe_motion(robot_file: RobotFile, plan: ProbingPlan) -> str:
    """Describe a probing motion, for the confirmation before a real arm gets power."""
    speeds = ", ".join(f"{1e3 * speed:g}" for speed in plan.speeds_m_s)
    return (
        f"'{robot_file.name}' will move: {count(len(plan.runs()), 'run')} at {speeds} mm/s, "
        f"pressing with {plan.force_limit_n:g} N. The guard stops the arm beyond "
        f"{robot_file.limits.force_n:g} N."
    )


def ask_for_pose(pose_rad: Sequence[float], *, yes: bool) -> None:
    """Wait until a person confirms that the unpowered arm is held in a pose.

    Args:
        pose_rad: joint positions, shape (n,) [rad].
        yes: whether the arm is already held there; then return at once.

    Raises:
        InputError: there is no terminal to ask at.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise InputError(
            "a person must bring the arm into the pose; run this in a terminal, or add --yes once the arm is "
            "held there"
        )
    pose = ", ".join(f"{angle:.4g}" for angle in pose_rad)
    console.stderr().print(f"Bring the arm into the pose {pose} rad, hold it there, and press Enter")
    if not sys.stdin.readline():
        raise InputError("the input ended before Enter was pressed, so the pose is not confirmed")
