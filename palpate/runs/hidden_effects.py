"""Hide effects in a simulated world, store them in a sealed file, and read the true parameters."""

from collections.abc import Sequence
from pathlib import Path

from palpate.common.console import as_command
from palpate.common.files import existing_file
from palpate.common.options import yaml_files
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import FileModel, parse_yaml
from palpate.robot_io.session import Session
from palpate.sim_backend.contact_laws.standard import EngineContact, HuntCrossleyLaw, KelvinVoigtLaw
from palpate.sim_backend.hidden import SealedAnswer, draw_hidden, sealed_path, unseal
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.scenario import Hidden, Scenario

RANDOM = "random"
SEALED = "(sealed)"  # replaces hidden effects in a stored command line
SEAL = "seal"  # metadata key of the mark that session and sealed answer share


class HiddenFile(FileModel):
    """A YAML file of effects to hide, written as in a scenario."""

    hidden: tuple[Hidden, ...]


def hide(scenario: Scenario, what: str) -> Scenario:
    """Return the world with the requested hidden effects; its seed determines random choices.

    The location and strength of an effect that is given by name are random. A YAML file has a list `hidden`.

    Args:
        scenario: the world.
        what: "random", an effect's name, or the path of a YAML file.

    Raises:
        InputError: the effect or file does not exist, or does not fit the world.
    """
    if what == RANDOM or what in IMPERFECTIONS:
        effect = None if what == RANDOM else what
        return scenario.with_hidden(draw_hidden(scenario.seed, effect=effect, scenario=scenario))
    if not Path(what).suffix:
        raise InputError(f"--hidden {what}: {IMPERFECTIONS.unknown(what)}; or {RANDOM}, or a YAML file")
    return scenario.with_hidden(HiddenFile.load(existing_file(Path(what), "hidden")).hidden)


def open_answer(session: Session) -> SealedAnswer:
    """Open a session's sealed answer.

    Args:
        session: session with a sealed answer beside it.

    Raises:
        InputError: there is no sealed answer, or it is damaged or belongs to another session.
    """
    path = existing_file(sealed_path(session.path), "sealed answer")
    answer = unseal(path)
    if (answer.made_utc, answer.mark) != (session.metadata.created_utc, session.metadata.extra.get(SEAL, "")):
        raise InputError(f"sealed answer {path}: belongs to another session, made at {answer.made_utc}")
    return answer


def hidden_names() -> list[str]:
    """Return the effects that can be hidden, and the user's own files, for shell completion."""
    return [RANDOM, *IMPERFECTIONS, *yaml_files()]


def command_line(arguments: Sequence[str], hidden: str | None) -> str:
    """Return the command line for the session to store, without what is hidden.

    Args:
        arguments: arguments of the program.
        hidden: hidden effects as typed; None if none.
    """
    if hidden in (None, "", RANDOM):
        return as_command(arguments)
    words = list(arguments)
    for number, word in enumerate(words):
        if word == hidden and words[number - 1 : number] == ["--hidden"]:
            words[number] = SEALED
        elif word == f"--hidden={hidden}":
            words[number] = f"--hidden={SEALED}"
    return as_command(words)


SURFACE = "surface"


def scenario_of(session: Session) -> Scenario | None:
    """Return the simulated world of a session; None if it was not simulated.

    Args:
        session: the session.

    Raises:
        InputError: the session's copy of the scenario is not valid.
    """
    text = session.metadata.scenario
    return Scenario.load(parse_yaml(text, f"{session.path}, its scenario")) if text else None


def truth_of(scenario: Scenario | None) -> dict[str, float]:
    """Return a simulated world's true values by "effect.parameter"; empty without a world.

    `SURFACE` is the surface's coordinate along the press direction (downwards) [m].

    Args:
        scenario: the world; those of its object are returned, with the position of its surface.
    """
    if scenario is None:
        return {}
    surface = {SURFACE: -scenario.object.surface_height_m}
    match scenario.object.law:
        case KelvinVoigtLaw() | EngineContact() as law:
            return surface | {"stiffness.k": law.stiffness_n_m, "damping.c": law.damping_n_s_m}
        case HuntCrossleyLaw() as law:
            power = {"k": law.stiffness, "b": law.damping, "n": law.exponent}
            return surface | {f"hunt_crossley.{name}": value for name, value in power.items()}
    return surface
