"""Reads measured soft things into channels: a cell under an AFM, a muscle that is stretched."""

from pathlib import Path

from palpate.estimation.channel import ChannelData, ChannelKind

from .read import channel, part, runs, signals

MUSCLES = ("relaxed", "calcium_pCa4.4", "relaxed_mava_set", "calcium_pCa4.4_mava_set")


def afm_cell(folder: Path) -> ChannelData:
    """Approach and hold of all curves on one cell, evenly sampled; the retract apart, as its README does.

    Position is that of the drive. The README's indentation is that less force over the cantilever's 1.07 N/m:
    in a hold it follows the force, and says what the force is. The cell is 80 times as soft.

    The README's errors count only every fourth sample of the later hold, so they weigh the approach more.
    """
    parts = []
    for number, run in enumerate(runs(folder).values()):
        kept = [row for row in run if row["phase"] in ("approach", "hold")]
        t, x, force = signals(kept, "time_s", "piezo_m", "force_N")
        parts.append(part(t + 100.0 * number, x, force))
    return channel(ChannelKind.CONTACT, parts, "contact")


def muscle(folder: Path, condition: str) -> ChannelData:
    """Ramps of 0.1, 1, 10 and 100 s to one stretch under one condition; one run each."""
    parts = []
    for number, run in enumerate(runs(folder, condition=condition).values()):
        t, x, force = signals(run, "time_s", "displacement_m", "force_N")
        parts.append(part(t + 1000.0 * number, x, force))
    return channel(ChannelKind.CONTACT, parts, "contact")
