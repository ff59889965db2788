"""Live view of a session that is still being written, also in Foxglove, and the command that writes it."""

import asyncio
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence
from itertools import count, cycle
from pathlib import Path
from threading import Lock

import numpy as np
from nicegui import ui

from palpate.control.loop.tick_record import STREAM_NAME
from palpate.render import palette
from palpate.render.thinning import peak_rows
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.session import Samples, Session, SessionTail
from palpate.robot_io.types import FloatArray
from palpate.workbench.elements import Figure, Plot, axis, curve, heading, layout_of
from palpate.workbench.plots import picked

TOPIC = "/probing"
_NUMBERS = {
    "force_n": "measured force [N]",
    "residual_n": "residual of the online estimates [N]",
    "stiffness_n_m": "online estimate of k [N/m]",
    "damping_n_s_m": "online estimate of c [N s/m]",
}
_SCHEMA = {
    "title": "palpate.Probing",
    "type": "object",
    "properties": {
        **{name: {"type": "number", "description": text} for name, text in _NUMBERS.items()},
        "torque_nm": {"type": "array", "items": {"type": "number"}, "description": "of each joint [N m]"},
    },
}
_MOST_WAITING = 30_000  # messages buffered for a slow viewer
_NS = 1e9


class FoxgloveFeed:
    """A Foxglove WebSocket server; it sends each tick once, at its time in the session.

    Args:
        host: address to listen on.
        port: port; 0 for any free port.

    Raises:
        ModuleNotFoundError: the Foxglove SDK is not installed.
        InputError: the port is not available.
    """

    def __init__(self, host: str, port: int) -> None:
        import foxglove  # noqa: PLC0415, an extra

        try:
            self._server = foxglove.start_server(
                name="palpate", host=host, port=port, message_backlog_size=_MOST_WAITING
            )
        except (OSError, RuntimeError) as error:
            message = (
                f"--foxglove {port}: in use, or not permitted; choose another port, or 0 for any free one"
            )
            raise InputError(message) from error
        self._channel = foxglove.Channel(TOPIC, schema=_SCHEMA)
        self.port = int(self._server.port)
        self._lock = Lock()  # pages follow a session in separate threads
        self._sent: dict[Path, float] = {}  # time up to which each session was sent [s]

    @property
    def is_watched(self) -> bool:
        """Whether there is a subscriber."""
        return bool(self._channel.has_sinks())

    def send(self, session: Path, ticks: Samples) -> None:
        """Send ticks that were not sent before; do nothing without subscribers.

        Args:
            session: session that is being written.
            ticks: newest ticks of it.
        """
        if not self.is_watched:
            return
        time_s = ticks["time_s"]
        with self._lock:
            new = time_s > self._sent.get(session, -np.inf)
            if not new.any():
                return
            self._sent[session] = float(time_s.max())
            columns = {n: online_residual(ticks) if n == "residual_n" else ticks[n] for n in _NUMBERS}
            torques = ticks.vector("torque_measured_nm")
            for row in np.flatnonzero(new):
                # unknown values are left out, because JSON has no NaN
                message: dict[str, object] = {
                    name: float(values[row]) for name, values in columns.items() if np.isfinite(values[row])
                }
                if np.isfinite(torques[row]).all():
                    message["torque_nm"] = torques[row].tolist()
                self._channel.log(message, log_time=int(time_s[row] * _NS))

    def close(self) -> None:
        """Stop the server."""
        self._channel.close()
        self._server.stop()


def online_residual(ticks: Samples) -> FloatArray:
    """Return measured force minus estimated force, shape (n,) [N]; NaN without an online estimate.

        F = max(k x + c v, 0) below the surface, 0 above it;    x depth, v speed along the press direction

    Args:
        ticks: samples of the stream "tick", with the estimate of each tick.
    """
    along = np.sum(ticks["tip_position_world_m"] * ticks["press_direction_world"], axis=1)
    speed = np.sum(ticks["tip_velocity_world_m_s"] * ticks["press_direction_world"], axis=1)
    depth = along - ticks["surface_m"]
    expected = np.where(depth > 0.0, ticks["stiffness_n_m"] * depth + ticks["damping_n_s_m"] * speed, 0.0)
    left: FloatArray = ticks["force_n"] - np.maximum(expected, 0.0)
    return left


PERIOD_S = 0.5
SPAN_S = 12.0  # duration that is shown
_POINTS = 600  # points of a curve
_LAST = 30_000  # number of stored ticks


def newest_growing(folder: Path) -> Path | None:
    """Return the newest session of a folder, if it is still being written."""
    files = sorted(folder.glob("*.mcap"), key=lambda file: file.stat().st_mtime)
    if not files:
        return None
    try:
        return files[-1] if Session.open(files[-1]).truncated else None
    except PalpateError:
        return None


def live_figure(ticks: Samples) -> Figure:
    """Draw force with residual, torques, and online estimates over the last seconds.

    Args:
        ticks: ticks of the session that is being written.
    """
    time_s = ticks["time_s"]
    last = time_s > time_s[-1] - SPAN_S if len(time_s) else np.zeros(0, dtype=np.bool_)
    torques = ticks.vector("torque_measured_nm")[last].T
    joints = zip(count(1), torques, cycle(palette.JOINTS), strict=False)
    curves = [
        ("force [N]", ticks["force_n"][last], palette.MEASURED, "y"),
        ("residual of the estimates [N]", online_residual(ticks)[last], palette.TRUTH, "y"),
        *((f"torque {n} [N m]", y, color, "y2") for n, y, color in joints),
        ("k [N/m]", ticks["stiffness_n_m"][last], palette.MODEL, "y3"),
        ("c [N s/m]", ticks["damping_n_s_m"][last], palette.NOISE, "y4"),
    ]
    traces = []
    for name, y, color, place in curves:
        rows = peak_rows(y, _POINTS)
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


def live_view(
    session: Path, done: Callable[[Path], Awaitable[None]], feed: FoxgloveFeed | None = None
) -> None:
    """Create a card that follows a session until it is complete.

    Args:
        session: session that is being written, or soon will be.
        done: called with the session once it is complete.
        feed: also sends its ticks to Foxglove.
    """
    tail, is_reading = SessionTail(session, STREAM_NAME, _LAST), False
    with ui.element("section").classes("card"):
        heading(f"Live: {session.name}")
        words = ui.label("waiting for the first chunk").classes("quiet").mark("live")
        plot = Plot({"data": [], "layout": {"height": 460}})

    async def follow() -> None:
        nonlocal is_reading
        if is_reading or not session.exists():
            return
        is_reading, before = True, tail.count
        try:
            ticks = await asyncio.to_thread(tail.read)
            if ticks is not None and len(ticks) and feed is not None:
                await asyncio.to_thread(feed.send, session, ticks)
        except PalpateError as error:
            timer.deactivate()
            words.set_text(str(error))
            return
        finally:
            is_reading = False
        if ticks is not None and tail.count > before:
            run = int(ticks["run"].max()) + 1
            words.set_text(f"{ticks['time_s'][-1]:.1f} s, run {run}, {tail.count} ticks")
            plot.replace(live_figure(ticks))
        if tail.complete:
            timer.deactivate()
            await done(session)

    timer = ui.timer(PERIOD_S, follow)


async def run_command(arguments: Sequence[str], on_line: Callable[[str], object]) -> str:
    """Run a palpate command in a process; canceling ends it as Ctrl-C would.

    Args:
        arguments: arguments of `palpate`; it cannot ask questions.
        on_line: called with each printed line.

    Returns:
        The command's error in one line; empty on success.
    """
    process = await asyncio.create_subprocess_exec(
        *[sys.executable, "-P", "-m", "palpate.main", *arguments],
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,  # otherwise a terminal's Ctrl-C would interrupt it twice
    )
    assert process.stdout is not None  # noqa: S101, asked for above
    assert process.stderr is not None  # noqa: S101, asked for above
    errors = asyncio.create_task(process.stderr.read())
    try:
        async for line in process.stdout:
            on_line(line.decode(errors="replace").rstrip())
        message = (await errors).decode(errors="replace").strip()
        return "" if await process.wait() == 0 else (message.splitlines() or ["it failed"])[-1]
    except asyncio.CancelledError:  # the server ends: wait until the arm rests and its session is closed
        process.send_signal(signal.SIGINT)
        await process.wait()
        raise
