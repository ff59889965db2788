"""Writes the experiment that a diagnosis proposes as a plan for `palpate probe --experiment`."""

import shlex
from pathlib import Path
from typing import Any

import yaml

from control.probing.plan import ProbingPlan
from estimation.diagnosis.result import NextExperiment
from palpate.files import write_text
from palpate.runs.hiding import SEALED
from palpate.runs.probing import PLAN
from palpate.words import as_shell_word
from robot_io.files.file_model import validate
from robot_io.files.safe_yaml import parse_yaml
from robot_io.session import Session

SLOWEST_M_S = 0.01  # runs slower than this need more time to load
PATIENCE_S = 60.0
_WORLD = ("--robot", "--scenario", "--seed", "--hidden", "--drivers")
_WIRE = "--wire"
_SWING = "free_air_swing_m"


def plan_of(experiment: NextExperiment, session: Session | None) -> ProbingPlan | None:
    """The plan to run next; None where the arm's task cannot do it.

    A joint that no probing arm moved is none of its joints: what was proposed for it stays words.

    Args:
        experiment: what is proposed.
        session: its plan is kept where the proposal says nothing.

    Raises:
        InputError: the proposal, or the session's plan, is not valid.
    """
    previous = _previous(session)
    is_of_joints = _SWING in experiment.probe
    if not experiment.probe or (is_of_joints and not previous):
        return None
    return validate(ProbingPlan, previous | dict(experiment.probe))


def write_plan(experiment: NextExperiment, plan: ProbingPlan, path: Path) -> None:
    """Write the plan with its purpose as a comment.

    Raises:
        InputError: it cannot be written.
    """
    words = f"# {experiment.instruction}\n# to {experiment.purpose}\n"
    text = yaml.safe_dump(plan.model_dump(mode="json"), sort_keys=False)
    write_text(path, words + text)


def same_world(session: Session) -> str | None:
    """The options of `palpate probe` that lead to the world in which a session was probed.

    Returns:
        Options for a shell; None where nobody but the session's maker can say them.
    """
    metadata = session.metadata
    try:
        words = shlex.split(metadata.command_line)
    except ValueError:
        return None
    if words[:2] != ["palpate", "probe"] or SEALED in words:
        return None
    chosen: list[str] = []
    for word, following in zip(words[2:], [*words[3:], ""], strict=True):
        name, equals, _ = word.partition("=")
        if name == _WIRE:
            chosen.append(word)
        elif name in _WORLD:
            chosen += [word] if equals else [word, following]
    if metadata.seed is not None and not any(word.startswith("--seed") for word in chosen):
        chosen += ["--seed", str(metadata.seed)]
    return " ".join(as_shell_word(word) for word in chosen)


def _previous(session: Session | None) -> dict[str, Any]:
    text = session.metadata.extra.get(PLAN, "") if session is not None else ""
    return dict(parse_yaml(text, "the session's plan").data) if text else {}
