"""Revisions: saved stages of models, in files or in memory."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from palpate.estimation.base_model import ModelContext
from palpate.estimation.data.units import LARGEST_NUMBER
from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.effects import EFFECTS
from palpate.estimation.models import MODELS
from palpate.estimation.study.saved_diagnosis import read_saved, with_checksum
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.atomic_write import atomic_write

FOLDER = "revisions"
MAX_NUMBER = 999_999  # largest number that palpate creates
Sized = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
SizedError = Annotated[float, Field(ge=0.0, le=LARGEST_NUMBER)]


class SavedParameter(ParameterValue):
    """One parameter with a finite value of limited size."""

    model_config = ConfigDict(allow_inf_nan=False)

    value: Sized
    std_err: SizedError | None


class Revision(BaseModel):
    """One stage of one channel's model."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    number: int = Field(ge=0, le=MAX_NUMBER)  # number of the revision, unique within a study
    parent: int | None  # number of the previous revision; None for a base model
    channel: str  # name of the channel
    model: str  # name of the base model
    added: str  # effect added at this stage; empty for a base model or a removal
    removed: str = ""  # effect removed at this stage
    effects: list[str]  # all added effects, in order
    user_effects: list[str]  # user-defined effects among them, as FILE.py:Class
    effort_unit: str  # unit of the errors
    rmse: SizedError  # held-out error
    noise_floor: SizedError  # held-out error of a complete model
    noise_at_most: bool = False  # whether `noise_floor` is only an upper bound
    parameters: dict[str, SavedParameter]  # parameters by "effect.parameter"
    data_sha256: str  # SHA-256 of the fitted channel
    created_utc: str  # creation time
    software_version: str  # version of palpate

    @property
    def key(self) -> tuple[str, str, str]:
        """Channel, base model and SHA-256 of the data, as in `StudyChannel.saved_key`."""
        return self.channel, self.model, self.data_sha256


class Revisions:
    """Revisions of a study; several programs can safely save into the same folder.

    Args:
        folder: parent folder of the revisions; None to keep them in memory.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = None if folder is None else folder / FOLDER
        self._in_memory: list[Revision] = []

    @property
    def exists(self) -> bool:
        """Whether the folder of revisions exists."""
        return self._folder is not None and self._folder.is_dir()

    def all(self) -> tuple[Revision, ...]:
        """Return all revisions, oldest first.

        Raises:
            InputError: a file is not a revision, or the folder of revisions is a symbolic link, through which
                files would be written elsewhere.
        """
        if self._folder is None:
            return tuple(self._in_memory)
        if self._folder.is_symlink():
            raise InputError(
                f"folder {self._folder}: is a symbolic link, which is not followed; replace it with a folder"
            )
        files = self._folder.glob("[0-9]*.json") if self._folder.is_dir() else ()
        numbered = [file for file in files if file.stem.isdecimal() and file.name == _name(int(file.stem))]
        revisions = []
        for file in sorted(numbered, key=lambda file: int(file.stem)):
            try:
                revision = read_saved(file, Revision)
            except ValueError as error:
                raise _damaged(file, str(error)) from error
            if flaw := next(_flaws(revision, int(file.stem)), None):
                raise _damaged(file, flaw)
            revisions.append(revision)
        return tuple(revisions)

    def get(self, number: int) -> Revision:
        """Return one revision.

        Args:
            number: number of the revision.

        Raises:
            InputError: there is no such revision.
        """
        known = {revision.number: revision for revision in self.all()}
        if number not in known:
            listed = ", ".join(str(n) for n in known) or "none yet; omit the number to use the base model"
            raise InputError(f"no revision {number} in {self._folder or 'memory'}. Available: {listed}")
        return known[number]

    def save(self, make: Callable[[int], Revision]) -> Revision:
        """Save a revision under the next unused number.

        Args:
            make: function that builds the revision from its number.

        Raises:
            InputError: the file cannot be written.
        """
        number = max((revision.number for revision in self.all()), default=-1) + 1
        if self._folder is None:
            self._in_memory.append(make(number))
            return self._in_memory[-1]
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            while True:
                made = make(number)
                try:
                    with atomic_write(self._folder / _name(number), replace=False) as unfinished:
                        content = with_checksum(made.model_dump(mode="json"))
                        text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
                        unfinished.write_text(text + "\n", encoding="utf-8")
                except FileExistsError:  # another program has used this number
                    number += 1
                else:
                    return made
        except OSError as error:
            raise InputError(f"cannot write {self._folder}: {error.strerror or error}") from error

    def discard(self, revisions: Sequence[Revision]) -> None:
        """Remove revisions that were just saved, after a failure to save the whole set.

        Args:
            revisions: the saved revisions, the newest last.
        """
        for revision in reversed(revisions):
            if self._folder is None:
                self._in_memory.remove(revision)
            else:
                (self._folder / _name(revision.number)).unlink(missing_ok=True)


def user_effects_of(revisions: Sequence[Revision]) -> list[str]:
    """Return the user-defined effects in revisions, as FILE.py:Class, without repetition.

    Args:
        revisions: the revisions.
    """
    return list(dict.fromkeys(text for revision in revisions for text in revision.user_effects))


def _name(number: int) -> str:
    return f"{number:04d}.json"


def _damaged(file: Path, reason: str) -> InputError:
    return InputError(f"revision {file}: is damaged: {reason}; delete it to continue without it")


def _flaws(revision: Revision, number: int) -> Iterator[str]:
    """Yield errors in a revision, which may have been edited by hand."""
    if revision.number != number:
        yield f"its number is {revision.number}"
    if revision.parent is not None and not 0 <= revision.parent < number:
        yield f"its parent is {revision.parent}, which is not an earlier revision"
    if revision.model not in MODELS:
        yield MODELS.unknown(revision.model)
        return
    effects = revision.effects
    last = "" if revision.removed else "".join(effects[-1:])
    if len(set(effects)) < len(effects) or revision.added != last or revision.removed in effects:
        yield f"its effects are {', '.join(effects) or 'none'}, but it says it added '{revision.added}'"
    unknown = [name for name in effects if name not in EFFECTS]
    if len(unknown) > len(revision.user_effects):
        yield EFFECTS.unknown(unknown[-1])
    if len(unknown) < len(revision.user_effects):
        return  # a user-defined effect may have the name of another effect but different parameters
    names = {*effects, *(name.partition(".")[0] for name in revision.parameters)}
    fixed = [EFFECTS[name] for name in names if name in EFFECTS]
    saved, expected = set(revision.parameters), set[str]()
    for effect in fixed:
        own = {f"{effect.name}.{parameter.name}" for parameter in (*effect.gains, *effect.inner)}
        is_other_form = own.isdisjoint(saved) and any(name.startswith(f"{effect.name}.") for name in saved)
        expected |= set() if is_other_form else own  # see `Effect.suited_to`
    with suppress(InputError):  # the parameters of some base models depend on the arm
        base = MODELS[revision.model]().build(ModelContext())
        expected |= {*base.gains, *base.inner}
    if missing := sorted(expected - saved):
        yield f"its parameter {missing[0]} is missing"
    for name in (name for name in effects if name in EFFECTS):
        for parameter in EFFECTS[name].inner:
            saved_parameter = revision.parameters.get(f"{name}.{parameter.name}")  # None in another form
            value = parameter.lower if saved_parameter is None else saved_parameter.value
            if not parameter.lower <= value <= parameter.upper:
                bounds = f"{parameter.lower:g} to {parameter.upper:g}"
                yield f"its parameter {name}.{parameter.name} is {value:g}, outside {bounds}"
