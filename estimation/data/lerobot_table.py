"""A LeRobot data set's arrays as columns: `observation.state`, `action` ... of each joint."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

_TIME, _EPISODE, _STATE = "timestamp", "episode_index", "observation.state"
_CALLED = {  # arrays by the quantity that they hold; an action is what was asked for, and no channel's
    _STATE: "position",
    "observation.position": "position",
    "observation.velocity": "velocity",
    "observation.effort": "torque",
    "observation.torque": "torque",
    "observation.current": "current",
    "action": "action",
}
_MOST_JOINTS = 64
_MOST_INFO_BYTES = 1 << 20


def is_lerobot(table: pa.Table) -> bool:
    """Whether a Parquet file is an episode of a LeRobot data set."""
    return {_TIME, _STATE} <= set(table.column_names)


def flat_table(table: pa.Table, path: Path) -> tuple[pa.Table, tuple[str, ...]]:
    """Each array's elements as columns of their own, time and run by palpate's names, and words on it.

    The data set says no units: of positions and torques the user does. Arrays whose length changes from row
    to row are left out.

    Args:
        table: as the Parquet file holds it, n rows.
        path: of the file, beside whose folders the data set's description lies.

    Returns:
        A table of n rows, one number a cell; and words on it for people.
    """
    columns: dict[str, Any] = {"time_s": table.column(_TIME)}
    if _EPISODE in table.column_names:
        columns["run"] = table.column(_EPISODE)
    for name in table.column_names:
        column = table.column(name)
        if not _is_list(column.type):
            continue
        rows = column.combine_chunks()
        widths = pc.unique(pc.list_value_length(rows)).to_pylist()
        if len(widths) != 1 or widths[0] is None or not 0 < widths[0] <= _MOST_JOINTS:
            continue
        values = np.asarray(rows.flatten()).reshape(-1, widths[0])
        called = _CALLED.get(name, name)
        columns |= {f"{called}_{joint + 1}": values[:, joint] for joint in range(widths[0])}
    names = _joint_names(path)
    words = ("LeRobot data set", *([f"joints {', '.join(names)}"] if names else []))
    return pa.table(columns), words


def _is_list(kind: pa.DataType) -> bool:
    of = pa.types
    return bool(of.is_list(kind) or of.is_large_list(kind) or of.is_fixed_size_list(kind))


def _joint_names(path: Path) -> list[str]:
    """What the data set calls its joints; empty where its description is not there or says nothing."""
    for folder in path.absolute().parents[:4]:
        info = folder / "meta" / "info.json"
        if info.is_file() and info.stat().st_size < _MOST_INFO_BYTES:
            return _names_in(info)
    return []


def _names_in(info: Path) -> list[str]:
    try:
        said = json.loads(info.read_text(encoding="utf-8"))
        names = said["features"][_STATE]["names"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
    if isinstance(names, Mapping):
        names = next(iter(names.values()), [])
    return [str(name)[:60] for name in names[:_MOST_JOINTS]] if isinstance(names, list) else []
