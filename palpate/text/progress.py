"""Progress of a probing run, for the person who waits."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskID, TextColumn

from control.loop.phases import Phase
from control.loop.task import TaskOutput
from control.probing.plan import ProbingPlan
from palpate import console
from palpate.runs.probing import NOBODY, Watcher
from palpate.words import count
from robot_io.types import Measurement

REFRESH_S = 0.1
SHARE_DONE = {  # of a run, when a phase begins
    Phase.FREE_AIR: 0.1,
    Phase.APPROACH: 0.25,
    Phase.LOADING: 0.4,
    Phase.HOLD: 0.5,
    Phase.UNLOADING: 0.75,
    Phase.RETRACT: 0.9,
}
MILLI = 1e3


@contextmanager
def probing_progress(plan: ProbingPlan, *, live: bool, remark: str = "") -> Iterator[Watcher]:
    """Show how far the runs have come, on stderr; nothing where a simulation's stderr is no terminal.

    Args:
        plan: what is going to be done.
        live: draw a bar that moves. Never with a real arm: drawing would take time from its control loop.
        remark: a line to say first, once the arm is ready.
    """
    runs = list(plan.runs())
    if not live:
        yield _Announcer(len(runs))
        return
    talk = console.stderr()
    if not talk.is_terminal:
        yield _Remark(remark) if remark else NOBODY
        return
    bar = BarColumn(bar_width=32)
    words = TextColumn("{task.description}")
    progress = Progress(bar, words, console=talk, transient=True, auto_refresh=False)
    task = progress.add_task("starting", total=len(runs))
    watcher = _Bar(progress, task, [run.speed_m_s for run in runs], remark)
    try:
        yield watcher
    finally:
        watcher.ended()


class _Remark(Watcher):
    """Says one line."""

    def __init__(self, remark: str) -> None:
        self._remark = remark

    def started(self) -> None:
        """See `Watcher.started`."""
        if self._remark:
            console.stderr().print(self._remark)


class _Announcer(Watcher):
    """Says what begins, and nothing while it lasts."""

    def __init__(self, run_count: int) -> None:
        self._run_count = run_count

    def started(self) -> None:
        """See `Watcher.started`."""
        console.stderr().print(f"probing, {count(self._run_count, 'run')}; Ctrl-C brings the arm to rest")


class _Bar(_Remark):
    """Moves a bar, at most every `REFRESH_S`."""

    def __init__(self, progress: Progress, task: TaskID, speeds_m_s: list[float], remark: str = "") -> None:
        super().__init__(remark)
        self._progress, self._task, self._speeds_m_s = progress, task, speeds_m_s
        self._next_s = 0.0
        self._run = 0
        self._completed = 0.0
        self._is_drawn = False

    def started(self) -> None:
        """See `Watcher.started`; what is refused before leaves nothing but its error on stderr."""
        super().started()
        self._progress.start()
        self._is_drawn = True

    def ended(self) -> None:
        """Take the bar away."""
        if self._is_drawn:
            self._progress.stop()

    def tick(self, measurement: Measurement, output: TaskOutput) -> None:
        """See `Watcher.tick`."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + REFRESH_S
        self._run = max(self._run, output.run)
        share = SHARE_DONE.get(output.phase, 0.0)
        speed_mm_s = MILLI * self._speeds_m_s[self._run]
        words = (
            f"run {self._run + 1} of {len(self._speeds_m_s)} at {speed_mm_s:.0f} mm/s, "
            f"{measurement.time_s:.1f} s simulated"
        )
        self._completed = max(self._completed, self._run + share)
        self._progress.update(self._task, completed=self._completed, description=words)
        self._progress.refresh()
