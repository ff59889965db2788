"""Reads measured soft things into channels: a cell under an AFM, a muscle that is stretched."""

from pathlib import Path

import numpy as np

from estimation.channel import ChannelData, ChannelKind

from .read import channel, rows

MUSCLES = ("relaxed", "calcium_pCa4.4", "relaxed_mava_set", "calcium_pCa4.4_mava_set")


def afm_cell(folder: Path) -> ChannelData:
    """Approach and hold of all curves on one cell, evenly sampled; the retract apart, as its README does.

    Position is that of the drive. The README's indentation is that less force over the cantilever's 1.07 N/m:
    in a hold it follows the force, and says what the force is. The cell is 80 times as soft.

    The README's errors count only every fourth sample of the later hold, so they weigh the approach more.
    """
    runs: dict[str, list[dict[str, str]]] = {}
    for row in rows(folder / "runs.csv.gz"):
        runs.setdefault(row["run"], []).append(row)
    parts = []
    for number, run in enumerate(runs.values()):
        kept = [row for row in run if row["phase"] in ("approach", "hold")]
        t, x, force = _signals(kept, "piezo_m")
        parts.append(_part(t + 100.0 * number, x, force))
    return channel(ChannelKind.CONTACT, parts, "contact")


def muscle(folder: Path, condition: str) -> ChannelData:
    """Ramps of 0.1, 1, 10 and 100 s to one stretch under one condition; one run each."""
    runs: dict[str, list[dict[str, str]]] = {}
    for row in rows(folder / "runs.csv.gz"):
        if row["condition"] == condition:
            runs.setdefault(row["run"], []).append(row)
    parts = []
    for number, run in enumerate(runs.values()):
        t, x, force = _signals(run)
        parts.append(_part(t + 1000.0 * number, x, force))
    return channel(ChannelKind.CONTACT, parts, "contact")


def _signals(run: list[dict[str, str]], position: str = "displacement_m") -> list[np.ndarray]:
    keys = ("time_s", position, "force_N")
    return [np.array([float(row[key]) for row in run]) for key in keys]


def _part(t: np.ndarray, x: np.ndarray, force: np.ndarray) -> list[np.ndarray]:
    v = np.gradient(x, t)
    return [t, x, v, np.gradient(v, t), force]
