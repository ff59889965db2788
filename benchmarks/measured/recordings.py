"""Published sets listed in sets.yaml: recordings, their simple models, and the answers in their READMEs."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from palpate.estimation.channel import ChannelData
from palpate.estimation.effects import EFFECTS
from palpate.estimation.model import Model

from . import read

_TABLE = yaml.safe_load(Path(__file__).with_name("sets.yaml").read_text("utf-8"))
SETS: dict[str, dict[str, Any]] = _TABLE["sets"]


@dataclass(frozen=True)
class Expected:
    """What the literature says about one channel."""

    needed: tuple[frozenset[str], ...]  # groups; at least one name of each group must be found
    allowed: frozenset[str]  # further names that are not wrong
    ladder: tuple[float, ...]  # held-out errors of the README, from the simple model to its best
    said: str  # summary of the README


@dataclass(frozen=True)
class Recording:
    """One measured set, or an independent part of it."""

    name: str  # name of the recording
    channels: list[ChannelData]  # channels that are diagnosed together
    models: list[Model]  # simple model of each
    expected: list[Expected]  # expected answer for each
    unit: str = ""  # unit of the effort if it is neither a force nor a torque


def recordings(folder: Path) -> Iterator[Recording]:
    """Read the recordings of a set from a folder that has the set's name."""
    for entry in SETS[folder.name]["recordings"]:
        function, *arguments = entry["read"]
        content = getattr(read, function)(folder, *arguments)
        if isinstance(content, ChannelData):
            base, *effects = entry["base"]
            content = [content], [Model(base, tuple(EFFECTS[effect]() for effect in effects))]
        expected = [_expected(**channel) for channel in entry["expected"]]
        yield Recording(entry["name"], *content, expected, entry.get("unit", ""))


def _expected(needed: list[str], allowed: list[str], ladder: list[float], said: str) -> Expected:
    groups = {name: frozenset(effects) for name, effects in _TABLE["groups"].items()}
    sets = [[groups.get(name, frozenset({name})) for name in names] for names in (needed, allowed)]
    return Expected(tuple(sets[0]), frozenset().union(*sets[1]), tuple(ladder), said)
