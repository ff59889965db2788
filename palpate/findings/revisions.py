"""Stages of a model, kept as files, so that one can go back to any of them."""

import math
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from pydantic import ValidationError

from estimation.revision import Revision
from palpate.files import output_folder, write_new_text
from palpate.findings.kept_revision import KeptParameter, KeptRevision
from palpate.findings.revision_check import flaw
from robot_io.errors import InputError

__all__ = ["KeptParameter", "KeptRevision", "RevisionShelf"]

FOLDER = "revisions"


class RevisionShelf:
    """The revisions of one session.

    Args:
        folder: the session's derived folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / FOLDER

    @property
    def is_there(self) -> bool:
        """Whether any revision was ever kept here."""
        return self._folder.is_dir()

    def all(self) -> list[KeptRevision]:
        """Every revision, oldest first.

        Raises:
            InputError: a file is not a revision.
        """
        files = self._folder.glob("[0-9]*.json") if self._folder.is_dir() else ()
        own = [file for file in files if file.stem.isdecimal() and file.name == _name(int(file.stem))]
        return [_read(file) for file in sorted(own, key=lambda file: int(file.stem))]

    def get(self, number: int) -> KeptRevision:
        """One revision.

        Raises:
            InputError: there is no such revision.
        """
        known = {revision.number: revision for revision in self.all()}
        if number not in known:
            there = ", ".join(str(n) for n in known) or "none yet"
            raise InputError(f"no revision {number} in {self._folder}. There are: {there}")
        return known[number]

    def latest(self, channel: str, model: str | None = None) -> KeptRevision | None:
        """The newest revision of a channel, if there is one.

        Args:
            channel: its name.
            model: only those that start from this base model.
        """
        found = [r for r in self.all() if r.channel == channel and model in {None, r.model}]
        return found[-1] if found else None

    def keep(
        self,
        channel: str,
        effort_unit: str,
        stages: Iterable[Revision],
        *,
        parent: KeptRevision | None,
        user_effects: dict[str, str],
    ) -> list[KeptRevision]:
        """Keep stages, each added to the one before; those that are kept already are left out.

        Args:
            channel: its name.
            effort_unit: unit of the errors.
            stages: from the base model on.
            parent: the revision that they continue; None to begin with the base model.
            user_effects: FILE.py:Class by name of effects of the user's own.

        Raises:
            InputError: they cannot be written.
        """
        everything = self.all()
        number = max((revision.number for revision in everything), default=-1)
        kept: list[KeptRevision] = []
        effects: list[str] = []
        for stage in stages:
            effects = [*effects, stage.added] if stage.added else effects
            parent = parent or _base(everything, channel, stage)
            if parent is not None and len(effects) <= len(parent.effects):
                continue
            before = kept[-1] if kept else parent
            own = [user_effects[name] for name in effects if name in user_effects]
            revision = self._write(_revision(number + 1, before, channel, effort_unit, stage, effects, own))
            number = revision.number
            kept.append(revision)
        return kept

    def _write(self, revision: KeptRevision) -> KeptRevision:
        """Write it, by a later number where another program has just taken that one."""
        output_folder(self._folder)
        while not write_new_text(
            self._folder / _name(revision.number), revision.model_dump_json(indent=2) + "\n"
        ):
            revision = revision.model_copy(update={"number": revision.number + 1})
        return revision


def _name(number: int) -> str:
    return f"{number:04d}.json"


def _base(revisions: list[KeptRevision], channel: str, stage: Revision) -> KeptRevision | None:
    """The base model of a channel, where it is kept already with this outcome."""
    same = [
        revision
        for revision in revisions
        if (revision.channel, revision.model, revision.rmse) == (channel, stage.model.name, stage.rmse)
        and not revision.effects
    ]
    return same[0] if same else None


def _revision(  # noqa: PLR0917, one argument a fact that is kept
    number: int,
    before: KeptRevision | None,
    channel: str,
    effort_unit: str,
    stage: Revision,
    effects: list[str],
    user_effects: list[str],
) -> KeptRevision:
    parameters = {
        name: KeptParameter(
            value=p.value, std_err=p.std_err if math.isfinite(p.std_err) else None, unit=p.unit
        )
        for name, p in stage.parameters.items()
    }
    return KeptRevision(
        number=number,
        parent=None if before is None else before.number,
        channel=channel,
        model=stage.model.name,
        added=stage.added,
        effects=effects,
        user_effects=user_effects,
        effort_unit=effort_unit,
        rmse=stage.rmse,
        noise_floor=stage.noise_floor,
        parameters=parameters,
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        software_version=version("palpate"),
    )


def _read(file: Path) -> KeptRevision:
    if not file.is_file():  # a pipe might never end
        raise _damaged(file, "it is no regular file")
    try:
        revision = KeptRevision.model_validate_json(file.read_text(encoding="utf-8"))
    except ValidationError as error:
        first = error.errors()[0]
        raise _damaged(file, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise _damaged(file, "it cannot be read") from error
    if wrong := flaw(revision, int(file.stem)):
        raise _damaged(file, wrong)
    return revision


def _damaged(file: Path, why: str) -> InputError:
    return InputError(f"revision {file}: is damaged: {why}; delete it to go on without it")
