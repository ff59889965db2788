"""Hides effects in a simulated world, and seals what they are beside the session."""

from pathlib import Path

from palpate.files import existing_file
from robot_io.errors import InputError
from robot_io.file_model import FileModel, validate
from robot_io.safe_yaml import load_yaml
from sim_backend.hidden import draw_hidden
from sim_backend.imperfection import IMPERFECTIONS
from sim_backend.scenario import Hidden, Scenario
from sim_backend.secret import Answer, seal, unseal

RANDOM = "random"


class HiddenFile(FileModel):
    """A YAML file that says what to hide.

    Attributes:
        hidden: the effects, as in a scenario.
    """

    hidden: tuple[Hidden, ...]


def hide(scenario: Scenario, what: str) -> Scenario:
    """The same world with other hidden effects.

    Args:
        scenario: the world; its seed decides what is drawn.
        what: "random"; the name of an effect, whose place and strength are then random; or a YAML file with a
            list `hidden`.

    Raises:
        InputError: no such effect or file, or they do not fit the world.
    """
    if what == RANDOM or what in IMPERFECTIONS:
        effect = None if what == RANDOM else what
        return scenario.with_hidden(draw_hidden(scenario.seed, effect=effect, scenario=scenario))
    if not Path(what).suffix:
        raise InputError(f"hidden '{what}': {IMPERFECTIONS.unknown(what)}; or {RANDOM}, or a YAML file")
    document = load_yaml(existing_file(Path(what), "hidden"))
    return scenario.with_hidden(validate(HiddenFile, document.data, document).hidden)


def seal_hidden(session: Path, scenario: Scenario, what: str | None, made_utc: str) -> Path | None:
    """Write what is hidden in the world of a session beside it.

    Args:
        session: the session file.
        scenario: its world.
        what: how it was chosen, as for `hide`, or None if the scenario says so itself.
        made_utc: when the session was made, as its metadata say.

    Returns:
        the sealed file, or None where nothing is hidden.

    Raises:
        InputError: it cannot be written.
    """
    if not scenario.hidden:
        return None
    drawn = what is not None and not Path(what).suffix
    return seal(session, Answer(scenario.hidden, scenario.seed if drawn else None, made_utc))


def open_answer(path: Path, made_utc: str) -> Answer:
    """What was hidden in the session that was made at `made_utc`.

    Raises:
        InputError: there is no sealed answer, it is damaged, or it is that of another session.
    """
    answer = unseal(existing_file(path, "sealed answer"))
    if answer.made_utc != made_utc:
        raise InputError(
            f"sealed answer {path}: is that of a session made at {answer.made_utc}, not at {made_utc}"
        )
    return answer
