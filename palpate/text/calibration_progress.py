"""Progress of a calibration, for the person who waits."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn

from control.loop.task import TaskOutput
from palpate import console
from palpate.runs.probing import NOBODY, Watcher
from robot_io.types import Measurement

REFRESH_S = 0.1
MakeWatcher = Callable[[float], Watcher]


@contextmanager
def motion_progress(what: str, *, live: bool) -> Iterator[MakeWatcher]:
    """Show how far a motion has come, on stderr.

    Args:
        what: is being done.
        live: draw a bar that moves. Never with a real arm: drawing would take time from its control loop.
    """
    if not live:
        yield lambda _duration_s: _Announcer(what)
        return
    with _bar(what) as update:
        yield lambda duration_s: _Mover(update, what, duration_s) if update else NOBODY


@contextmanager
def weighing_progress(count: int, *, live: bool) -> Iterator[Callable[[float], None] | None]:
    """Show how many weights have been read, on stderr; with hardware the prompts say it."""
    if not live:
        yield None
        return
    with _bar("weighing") as update:
        yield (lambda share: update(share, f"weight {round(share * count)} of {count}")) if update else None


@contextmanager
def _bar(what: str) -> Iterator[Callable[[float, str], None] | None]:
    """A bar that is told its share and words; None where stderr is no terminal."""
    talk = console.stderr()
    if not talk.is_terminal:
        yield None
        return
    columns = BarColumn(bar_width=32), TextColumn("{task.description}")
    with Progress(*columns, console=talk, transient=True, auto_refresh=False) as progress:
        task = progress.add_task(what, total=1.0)

        def update(share: float, words: str) -> None:
            progress.update(task, completed=share, description=words)
            progress.refresh()

        yield update


class _Announcer(Watcher):
    def __init__(self, what: str) -> None:
        self._what = what

    def started(self) -> None:
        """See `Watcher.started`."""
        console.stderr().print(f"{self._what}; keep clear. Ctrl-C brings the arm to rest")


class _Mover(Watcher):
    def __init__(self, update: Callable[[float, str], None], what: str, duration_s: float) -> None:
        self._update, self._what, self._duration_s = update, what, duration_s
        self._next_s = 0.0

    def tick(self, measurement: Measurement, output: TaskOutput) -> None:
        """See `Watcher.tick`."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + REFRESH_S
            share = min(measurement.time_s / self._duration_s, 1.0)
            self._update(share, f"{self._what}, {measurement.time_s:.0f} s simulated")
