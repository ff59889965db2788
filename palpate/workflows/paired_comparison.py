"""Puts two measurements, or two models of one, side by side, and writes what comes of it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from estimation.study.channels import ALL_CHANNELS
from estimation.study.paired_comparison import Grown, side_by_side
from estimation.study.revisions import Revision
from palpate.common.files import output_folder, whole_set
from palpate.render.build import REPORT, as_json, result_view
from palpate.render.paired import PairView, as_data, sides_view
from palpate.study import Study
from palpate.workflows.data_options import DataArguments
from robot_io.errors import InputError

RESULT, RECORDING = "comparison.json", "sides.rrd"
NAMES = (RESULT, REPORT, RECORDING)  # of what `write_pair` may write


class ComparedPair:
    """Two studies that are compared.

    Args:
        data: the first, and how both are read.
        other: file of the second; None for the same.
        models: base models of both; None for what suits.
        channel: only this one; None for all that both have.
        revisions: of both, whose models are compared instead; without one of the second, the models of the
            first are fitted to it as well.
        folder: where the revisions of the first, and of another model of it, are kept if not as usual.

    Raises:
        InputError: one of them cannot be used, or they have nothing in common.
    """

    def __init__(
        self,
        data: DataArguments,
        path: Path | None,
        models: tuple[str | None, str | None],
        channel: str | None,
        *,
        revisions: tuple[Sequence[int], Sequence[int]] = ((), ()),
        folder: Path | None = None,
    ) -> None:
        files = (data.file, path or data.file)
        first = data.study(models[0], folder)
        second = replace(data, file=files[1]).study(models[1] or models[0], None if path else folder)
        kept = chosen_revisions(first, revisions[0])
        grown = _grown(first, kept), _grown(second, chosen_revisions(second, revisions[1]) or kept)
        self.files = files
        self.names = _names(first, second, grown)
        found = side_by_side(first, second, self.names, grown)
        self.sides = [one for one in found if channel in {None, ALL_CHANNELS, one.channel}]
        if not self.sides:
            there = ", ".join(one.channel for one in found)
            raise InputError(f"--channel {channel}: not in both. Both have: {there}")
        if all(side.is_same_data and side.first.model == side.second.model for side in self.sides):
            raise InputError(
                f"{files[1]}: is the same measurement as {files[0]}, with the same model: name another file, "
                "or another model of it with --other-model or --other-revision"
            )
        self._studies = (first, second)

    def view(self, commands: Sequence[str] = ()) -> PairView:
        """What every medium draws."""
        first, second = self._studies
        channels = [
            sides_view(
                side,
                (
                    result_view(
                        first.result(side.first.channel, side.first.effects, reason=side.first.reason)
                    ),
                    result_view(
                        second.result(side.second.channel, side.second.effects, reason=side.second.reason)
                    ),
                ),
            )
            for side in self.sides
        ]
        return PairView(self.names, tuple(channels), tuple(commands))

    def as_data(self) -> dict[str, Any]:
        """The comparison as plain data; the keys are stable."""
        return {
            "files": [str(file) for file in self.files],
            "channels": [as_data(side) for side in self.sides],
        }


def chosen_revisions(study: Study, numbers: Sequence[int]) -> list[Revision]:
    """The revisions of these numbers. InputError: one is not there, or two are of one channel."""
    kept = [study.revision(number) for number in dict.fromkeys(numbers)]
    names = [one.channel for one in kept]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f"--revision: several of channel '{min(twice)}'; compare one after the other")
    return kept


def _grown(study: Study, kept: Sequence[Revision]) -> Grown:
    """The models of revisions in a study, or its base models where there are none."""
    return [(study.channel_of(one), one.effects) for one in kept] or [
        (channel, ()) for channel in study.channels
    ]


def write_pair(folder: Path, pair: ComparedPair, view: PairView) -> dict[str, Path]:
    """Write result, report and recording; all of them appear, or none. Returns them by what they are.

    Raises:
        InputError: a file cannot be written.
    """
    # what draws takes longer to import than all else
    from palpate.render.paired_report import document, record_pair  # noqa: PLC0415

    output_folder(folder)
    texts = {folder / RESULT: as_json(pair.as_data()), folder / REPORT: document(view)}
    with whole_set(texts):
        record_pair(view, folder / RECORDING)
    return {"result": folder / RESULT, "report": folder / REPORT, "recording": folder / RECORDING}


def _names(first: Study, second: Study, grown: tuple[Grown, Grown]) -> tuple[str, str]:
    """What tells the two apart: their files, with as many folders as needed, or else their models."""
    paths = [study.source.path for study in (first, second)]
    if paths[0] is None or paths[1] is None or paths[0].resolve() == paths[1].resolve():
        both = {c.name for c, _ in grown[0]} & {c.name for c, _ in grown[1]}
        shared = ([(c, e) for c, e in one if c.name in both] for one in grown)
        a, b = (", ".join(dict.fromkeys(" + ".join([c.model.name, *e]) for c, e in one)) for one in shared)
        return f"{first.source.name}: {a}", f"{second.source.name}: {b}"
    if paths[0].name != paths[1].name:
        return paths[0].name, paths[1].name
    return str(paths[0]), str(paths[1])
