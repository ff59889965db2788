"""Progress of a diagnosis, for the person who waits."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from estimation.diagnosis.chain import Progress as Report
from palpate import console


@contextmanager
def diagnosis_progress(channels: Sequence[str]) -> Iterator[Report]:
    """Show what is being tried, on stderr; one round a channel and effect found, so the end is not known."""
    bar, clock = BarColumn(bar_width=24), TimeElapsedColumn()
    words = TextColumn("{task.description}")
    with Progress(bar, clock, words, console=console.stderr(), transient=True) as progress:
        task = progress.add_task("getting ready", total=1.0)

        def report(what: str, share: float) -> None:
            channel = what.partition(":")[0]
            which = f"{channels.index(channel) + 1} of {len(channels)}, " if channel in channels else ""
            progress.update(task, completed=share, description=f"{which}{what}")

        yield report
