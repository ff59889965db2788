"""The question before a real arm gets power: somebody must know that it is going to move."""

import sys
import time
from collections.abc import Callable, Sequence

from control.probing.plan import ProbingPlan
from palpate.common import console
from palpate.common.formatting import count, safe
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile

COUNTDOWN_S = 3
Permission = Callable[[], None]


def without_question() -> None:
    """The permission that simulated arms need, and programs that ask in their own way: none."""


def ask_for_power(motion: str, *, yes: bool, pause: Callable[[float], None] = time.sleep) -> None:
    """Say what a real arm is going to do, ask for permission, and count down. It has no power meanwhile.

    With `yes` nothing is asked; the countdown still runs.

    Raises:
        InputError: the answer was no, or nobody is there to be asked; nothing has moved.
    """
    if not yes and not sys.stdin.isatty():
        raise InputError(
            "a real arm would get power, and nobody is there to be asked: run this in a terminal, "
            "or add --yes (--wire emulates the devices instead)"
        )
    talk = console.stderr()
    talk.print(f"[bold]{safe(motion)}[/bold]")
    talk.print("Keep clear of it, also from below, with its switch in your hand.")
    if not yes and not _confirmed():
        raise InputError("permission to power the arm denied: nothing has moved")
    for left_s in range(COUNTDOWN_S, 0, -1):
        talk.print(f"power in {left_s} s; Ctrl-C stops it")
        pause(1.0)


def motion_in_words(robot_file: RobotFile, plan: ProbingPlan) -> str:
    """What is asked of a real arm, for the question before it gets power."""
    speeds = ", ".join(f"{1e3 * speed:g}" for speed in plan.speeds_m_s)
    return (
        f"'{robot_file.name}' is going to move: {count(len(list(plan.runs())), 'run')} at {speeds} mm/s, "
        f"pressing with {plan.force_limit_n:g} N; its guard stops it beyond {robot_file.limits.force_n:g} N."
    )


def _confirmed() -> bool:
    """Whether the answer is yes; stdout, where `--json` goes, is left alone."""
    console.stderr().print("Power the arm now? \\[y/N]: ", end="")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def ask_for_pose(pose_rad: Sequence[float], *, yes: bool) -> None:
    """Wait until somebody holds a real arm in a pose (n,) [rad], if not `yes`; it gets no power.

    Raises:
        InputError: nobody is there to bring it.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise InputError(
            "the arm is brought into the pose by hand: run this in a terminal, or, once it is held there, "
            "add --yes"
        )
    pose = ", ".join(f"{angle:.4g}" for angle in pose_rad)
    console.stderr().print(f"Bring the arm into the pose {pose} rad, hold it there, and press Enter")
    if not sys.stdin.readline():
        raise InputError("the arm was not brought into the pose: nothing was read")
