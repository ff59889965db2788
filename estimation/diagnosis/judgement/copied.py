"""Whether runs are copies of each other: held out, a copy tells nothing that is not known already."""

from estimation.channel import ChannelData
from estimation.signals.blocks import rows_of_runs


def copied(data: ChannelData) -> str | None:
    """Which run is another one's copy, number for number; None if none is.

    Times may differ. No sensor with noise reads the same twice over a whole run.
    """
    seen: dict[tuple[bytes, bytes], int] = {}
    for rows in rows_of_runs(data.run):
        run = int(data.run[rows[0]])
        first = seen.setdefault((data.effort[rows].tobytes(), data.position[rows].tobytes()), run)
        if first != run:
            return (
                f"run {run} is a copy of run {first}, number for number, and says nothing of its own; leave "
                "it out, or record it again"
            )
    return None
