"""Progress on stderr, drawn by rich; nothing is drawn where stderr is not a terminal.

A real arm gets words instead of a bar: drawing would take time from its control loop.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from palpate.common import console
from palpate.common.console import count, duration
from palpate.control.loop.task import Phase, TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.types import Measurement
from palpate.runs.probing import Watcher

Report = Callable[[str, float], None]  # called with the current step and the fraction of it that is done
_REFRESH_S = 0.1
_TO_MILLI = 1e3
_SHARE_DONE = {  # fraction of a run that is done when a phase begins
    Phase.FREE_AIR: 0.1,
    Phase.APPROACH: 0.25,
    Phase.LOADING: 0.4,
    Phase.HOLD: 0.5,
    Phase.UNLOADING: 0.75,
    Phase.RETRACT: 0.9,
}


@contextmanager
def diagnosis_progress(channels: Sequence[str]) -> Iterator[Report]:
    """Show the current step of a diagnosis, with a bar for each channel.

    A bar fills once for each effect found, so it cannot show the remaining time.

    Args:
        channels: names of the channels.
    """
    columns = BarColumn(bar_width=24), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console.stderr(), transient=True) as progress:
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


@contextmanager
def probing_progress(plan: ProbingPlan, *, live: bool, remark: str = "") -> Iterator[Watcher]:
    """Show the progress of the runs.

    Args:
        plan: plan that is run.
        live: whether to draw a moving bar; never with a real arm.
        remark: line to print before the bar, once the arm is ready.
    """
    runs, newest = plan.runs(), 0

    def state(measurement: Measurement, output: TaskOutput, _duration_s: float) -> tuple[float, str]:
        nonlocal newest
        newest = max(newest, output.run)
        speed_mm_s = _TO_MILLI * runs[newest].speed_m_s
        words = (
            f"run {newest + 1} of {len(runs)} at {speed_mm_s:.0f} mm/s, {measurement.time_s:.1f} s simulated"
        )
        return (newest + _SHARE_DONE.get(output.phase, 0.0)) / len(runs), words

    words = remark if live else f"probing, {count(len(runs), 'run')}; Ctrl-C brings the arm to rest"
    with progress_bar("starting", wait=True) if live else nullcontext() as bar:
        yield _RunProgress(bar, state, words)


@contextmanager
def motion_progress(what: str, *, live: bool) -> Iterator[Watcher]:
    """Show the progress of a motion.

    Args:
        what: description of the motion.
        live: whether to draw a moving bar; never with a real arm.
    """

    def state(measurement: Measurement, _output: TaskOutput, duration_s: float) -> tuple[float, str]:
        return min(measurement.time_s / duration_s, 1.0), f"{what}, {measurement.time_s:.0f} s simulated"

    words = "" if live else f"{what}; keep clear. Ctrl-C brings the arm to rest"
    with progress_bar(what) if live else nullcontext() as bar:
        yield _RunProgress(bar, state, words)


class ProgressBar:
    """One bar, drawn at each update."""

    def __init__(self, what: str) -> None:
        stderr = console.stderr()
        columns = BarColumn(bar_width=32), TextColumn("{task.description}")
        self.progress = Progress(
            *columns, console=stderr, transient=True, auto_refresh=False, disable=not stderr.is_terminal
        )
        self._task, self._share = self.progress.add_task(what, total=1.0), 0.0

    def update(self, share: float, words: str) -> None:
        """Advance the bar to a fraction, and show the current step; the bar never moves back.

        Args:
            share: fraction that is done, from 0 to 1.
            words: the current step.
        """
        self._share = max(self._share, share)
        self.progress.update(self._task, completed=self._share, description=words, refresh=True)


@contextmanager
def progress_bar(what: str, *, wait: bool = False) -> Iterator[ProgressBar]:
    """Make a bar that is shown at once or, with `wait`, when its `progress` is started.

    Args:
        what: the first step.
        wait: whether somebody else starts it.
    """
    bar = ProgressBar(what)
    if not wait:
        bar.progress.start()
    try:
        yield bar
    finally:
        bar.progress.stop()


class _RunProgress(Watcher):
    """Prints words when the arm is ready, and moves a bar, if there is one, at most every `_REFRESH_S`."""

    def __init__(
        self,
        bar: ProgressBar | None,
        state: Callable[[Measurement, TaskOutput, float], tuple[float, str]],
        words: str,
    ) -> None:
        self._bar, self._state, self._words = bar, state, words
        self._next_s = self._duration_s = 0.0

    def started(self, duration_s: float = 0.0) -> None:
        """See `Watcher.started`; a run rejected before this call prints nothing but its error on stderr."""
        self._duration_s = duration_s
        if self._words:
            console.stderr().print(self._words)
        if self._bar is not None:
            self._bar.progress.start()

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        now_s = time.monotonic()
        if self._bar is not None and now_s >= self._next_s:
            self._next_s = now_s + _REFRESH_S
            self._bar.update(*self._state(measurement, output, self._duration_s))
        return NO_ESTIMATE


@contextmanager
def sweep_progress() -> Iterator[Callable[[int, int], None]]:
    """Show the number of finished cases, and the remaining time at the mean rate so far."""
    words = TextColumn("{task.description}")
    columns = BarColumn(bar_width=32), MofNCompleteColumn(), TimeElapsedColumn(), words
    progress = Progress(*columns, console=console.stderr(), transient=True)
    task = progress.add_task("getting ready", total=None)
    begun_s, before = time.monotonic(), None

    def show(done: int, total: int) -> None:
        nonlocal before
        if before is None:  # a rejected run then prints only its error on stderr
            before = done
            if progress.console.is_terminal:  # otherwise it would print an empty line
                progress.start()
        left = "getting ready"
        if done > before:
            each_s = (time.monotonic() - begun_s) / (done - before)
            left = f"about {duration(each_s * (total - done))} left"
        progress.update(task, completed=done, total=total, description=left)

    try:
        yield show
    finally:
        if progress.live.is_started:
            progress.stop()
