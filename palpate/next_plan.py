"""Writes the experiment that a diagnosis proposes as a plan for `palpate probe --experiment`."""

import shlex

import yaml

from control.probing.plan import ProbingPlan
from estimation.design.next_experiment import NextExperiment
from palpate.runs.hiding import SEALED
from palpate.words import as_shell_word
from robot_io.session import Session

_WORLD = ("--robot", "--scenario", "--engine", "--seed", "--hidden", "--drivers")
_WIRE = "--wire"


def plan_text(experiment: NextExperiment, plan: ProbingPlan) -> str:
    """The plan as YAML, with its purpose as a comment."""
    words = f"# {experiment.instruction}\n# to {experiment.purpose}\n"
    return words + yaml.safe_dump(plan.model_dump(mode="json"), sort_keys=False)


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
