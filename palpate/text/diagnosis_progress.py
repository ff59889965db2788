"""Progress of a diagnosis, for the person who waits."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from estimation.diagnosis.apart import Progress as Report
from palpate import console


@contextmanager
def diagnosis_progress(channels: Sequence[str]) -> Iterator[Report]:
    """Show what is being tried, on stderr, with a bar for each channel.

    A bar fills once for each effect found, so the end is not known.
    """
    bar, clock = BarColumn(bar_width=24), TimeElapsedColumn()
    words = TextColumn("{task.description}")
    with Progress(bar, clock, words, console=console.stderr(), transient=True) as progress:
        tasks: dict[str, TaskID] = {}
        ready = progress.add_task("getting ready", total=1.0)

        def report(what: str, share: float) -> None:
            channel = what.partition(":")[0]
            if channel not in tasks:
                progress.update(ready, visible=False)
                tasks[channel] = progress.add_task(what, total=1.0)
            which = f"{channels.index(channel) + 1} of {len(channels)}, " if channel in channels else ""
            progress.update(tasks[channel], completed=share, description=f"{which}{what}")

        yield report
