"""A probing that still goes on: the page follows the session file, and the control loop waits for nothing.

The session's writer is a process of its own; what it has written in whole chunks is read back here.
"""

import asyncio
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence
from itertools import count, cycle
from pathlib import Path

import numpy as np
from nicegui import ui

from control.loop.tick_record import STREAM_NAME
from palpate.render import palette
from palpate.render.thinning import peaks
from palpate.workbench.curves import axis, curve, layout_of, picked
from palpate.workbench.elements import Figure, Plot, heading
from palpate.workbench.foxglove_feed import Feed, online_residual
from robot_io.errors import PalpateError
from robot_io.session import Follower, Samples, Session

PERIOD_S = 0.5
SPAN_S = 12.0  # that is shown
_POINTS = 600  # of a curve
_LAST = 30_000  # ticks that are kept


def newest_growing(folder: Path) -> Path | None:
    """The newest session of a folder, if it is still being written."""
    files = sorted(folder.glob("*.mcap"), key=lambda file: file.stat().st_mtime)
    if not files:
        return None
    try:
        return files[-1] if Session.open(files[-1]).truncated else None
    except PalpateError:
        return None


def live_figure(ticks: Samples) -> Figure:
    """Force with its residual, torques, and online estimates over the last seconds."""
    time_s = ticks["time_s"]
    last = time_s > time_s[-1] - SPAN_S if len(time_s) else np.zeros(0, dtype=np.bool_)
    torques = ticks.vector("torque_measured_nm")[last].T
    joints = zip(count(1), torques, cycle(palette.JOINTS), strict=False)
    curves = [
        ("force [N]", ticks["force_n"][last], palette.MEASURED, "y"),
        ("residual of the estimates [N]", online_residual(ticks)[last], palette.TRUTH, "y"),
        *((f"torque {n} [N m]", y, color, "y2") for n, y, color in joints),
        ("k [N/m]", ticks["stiffness_n_m"][last], palette.MODEL, "y3"),
        ("c [N s/m]", ticks["damping_n_s_m"][last], palette.FLOOR, "y4"),
    ]
    traces = []
    for name, y, color, place in curves:
        rows = peaks(y, _POINTS)
        x, drawn = picked(time_s[last], rows), picked(y, rows)
        traces.append(curve(name, x, drawn, color, 1.3, name.rpartition("[")[2][:-1], yaxis=place))
    layout = layout_of(
        460,
        margin={"l": 56, "r": 50, "t": 10, "b": 40},
        uirevision="live",
        legend={"orientation": "h", "y": -0.12},
        xaxis=axis("time [s]", anchor="y3"),
        yaxis=axis("force [N]", domain=[0.68, 1.0]),
        yaxis2=axis("torque [N m]", domain=[0.34, 0.62]),
        yaxis3=axis("k [N/m]", domain=[0.0, 0.28]),
        yaxis4=axis("c [N s/m]", overlaying="y3", side="right", showgrid=False),
    )
    return {"data": traces, "layout": layout}


class Live:
    """Follows one session until it is complete; then it is opened."""

    def __init__(
        self, session: Path, done: Callable[[Path], Awaitable[None]], feed: Feed | None = None
    ) -> None:
        self._session, self._done, self._feed = session, done, feed
        self._reading, self._follower = False, Follower(session, STREAM_NAME, _LAST)

    def build(self) -> None:
        """Put the elements."""
        with ui.element("section").classes("card"):
            heading(f"Live: {self._session.name}")
            self._words = ui.label("waiting for the first chunk").classes("quiet").mark("live")
            self._plot = Plot({"data": [], "layout": {"height": 460}})
        self._timer = ui.timer(PERIOD_S, self._follow)

    async def _follow(self) -> None:
        follower = self._follower
        if self._reading or not self._session.exists():
            return
        self._reading, before = True, follower.count
        try:
            ticks = await asyncio.to_thread(self._read)
        except PalpateError as error:
            self._timer.deactivate()
            self._words.set_text(str(error))
            return
        finally:
            self._reading = False
        if ticks is not None and follower.count > before:
            run = int(ticks["run"].max()) + 1
            self._words.set_text(f"{ticks['time_s'][-1]:.1f} s, run {run}, {follower.count} ticks")
            self._plot.replace(live_figure(ticks))
        if follower.complete:
            self._timer.deactivate()
            await self._done(self._session)

    def _read(self) -> Samples | None:
        ticks = self._follower.read()
        if ticks is not None and len(ticks) and self._feed is not None:
            self._feed.send(self._session, ticks)
        return ticks


async def ran(arguments: Sequence[str], hear: Callable[[str], object]) -> str:
    """Run a palpate command in a process of its own; if this is cancelled, as Ctrl-C in a terminal ends it.

    Args:
        arguments: of `palpate`; nobody is there to be asked.
        hear: called with each line that it prints.

    Returns:
        What it said wrong, in one line; empty if it did what it should.
    """
    process = await asyncio.create_subprocess_exec(
        *[sys.executable, "-P", "-m", "palpate.main", *arguments],
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,  # else it is interrupted twice where the terminal does that too
    )
    assert process.stdout is not None  # noqa: S101, asked for above
    assert process.stderr is not None  # noqa: S101, asked for above
    errors = asyncio.create_task(process.stderr.read())
    try:
        async for line in process.stdout:
            hear(line.decode(errors="replace").rstrip())
        said = (await errors).decode(errors="replace").strip()
        return "" if await process.wait() == 0 else (said.splitlines() or ["it failed"])[-1]
    except asyncio.CancelledError:  # the server ends: an arm is brought to rest first, and its session closed
        process.send_signal(signal.SIGINT)
        await process.wait()
        raise
