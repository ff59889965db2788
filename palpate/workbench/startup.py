"""State of the server, and its responses while the page's library is imported (some seconds)."""

import socket
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from secrets import token_urlsafe
from socketserver import ThreadingTCPServer
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np

from palpate.estimation.data.import_options import ImportOptions
from palpate.render import palette
from palpate.render.thinning import peak_rows
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.session import Session
from palpate.robot_io.types import FloatArray

if TYPE_CHECKING:
    from palpate.workbench.live import FoxgloveFeed
    from palpate.workbench.state import WorkbenchState


@dataclass
class AppState:
    """State of the server."""

    folder: Path  # folder whose sessions are offered
    file: Path | None = None  # requested file; None if there is none
    riddle: bool = False  # whether an effect was hidden for the user to find
    state: "WorkbenchState | None" = None  # state of the workbench, once data have been read
    raw: str = ""  # drawing of a session's measurements; empty for other files
    reserved: set[Path] = field(default_factory=set)  # paths that tabs are about to write
    reading: str = ""  # file being read; empty afterwards
    error: str = ""  # why it could not be read
    reports: dict[str, Path] = field(default_factory=dict)  # reports written from the page, by key
    feed: "FoxgloveFeed | None" = None  # server for Foxglove, if requested
    open: "Callable[[Path, ImportOptions], WorkbenchState] | None" = None  # opens a file

    @property
    def waiting(self) -> str:
        """HTML that is shown while data is being read."""
        return f'<p class="quiet">{escape(self.reading or "opening")} …</p>{self.raw}'

    def serve_report(self, path: Path) -> str:
        """Serve a report to the browser; return its unguessable address."""
        key = token_urlsafe(16)
        self.reports[key] = path
        return f"/report/{key}"

    def read(self, make: "Callable[[], WorkbenchState]", what: str) -> None:
        """Read data in another thread; meanwhile the page shows the raw curves.

        Args:
            make: reads the data.
            what: description of the data.
        """

        def run() -> None:
            try:
                self.state = make()
            except PalpateError as error:
                self.error = str(error)
            finally:
                self.reading = ""

        self.reading = what
        Thread(target=run, daemon=True).start()


STYLE = (Path(__file__).parent / "workbench.css").read_text(encoding="utf-8")
LOOPBACK = "127.0.0.1"
_PATIENCE_S = 5.0  # timeout for a browser that connects without a request
_POLL_S = 0.02
_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>palpate workbench</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>{style}</style></head><body><div id="waiting">{body}</div>
<script>{script}</script></body></html>"""
_SCRIPT = 'addEventListener("load", () => setTimeout(() => location.reload(), 200))'

CLOSED = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
"""Content-Security-Policy that blocks everything not added to it, and framing by other pages."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every response: other pages can neither load it nor keep a reference to it."""

_POLICY = (
    f"{CLOSED}; style-src 'unsafe-inline'; img-src data:; "
    f"script-src 'sha256-{b64encode(sha256(_SCRIPT.encode()).digest()).decode()}'"
)


class EarlyServer(ThreadingTCPServer):
    """Server on an open port of this machine that answers its first visitor.

    Args:
        port: port on this machine; 0 for any free port.

    Raises:
        InputError: the port is in use, or there is none of this number.
    """

    allow_reuse_address = daemon_threads = True
    request_queue_size = 128  # visitors wait in the socket's queue until the page's server starts
    page = b""

    def __init__(self, port: int) -> None:
        try:
            super().__init__((LOOPBACK, port), _Reply)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", "") or error
            message = f"--port {port}: {reason}; choose another port, or 0 for any free one"
            raise InputError(message) from error
        self.port = int(self.server_address[1])
        self._answers = False

    def answer_with(self, body: str) -> None:
        """Answer the first visitor with this HTML."""
        self.page, self._answers = _PAGE.format(body=body, style=STYLE, script=_SCRIPT).encode(), True
        Thread(target=self.serve_forever, args=(_POLL_S,), daemon=True).start()

    def release_socket(self) -> socket.socket:
        """Stop answering, and return the open socket."""
        if self._answers:  # otherwise shutdown would wait forever
            self.shutdown()
        return self.socket

    def handle_error(self, *_: object) -> None:
        """Ignore visitors that disconnect."""


class _Reply(BaseHTTPRequestHandler):
    server: EarlyServer
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        """Answer the page once; later visitors wait for the real server.

        A page of an earlier server requests other paths to reconnect; it is told to retry later.
        """
        hosts = {self.server.server_address[0], "localhost"}
        if self.headers.get("Host", "").rpartition(":")[0] not in hosts:
            self.send_error(HTTPStatus.BAD_REQUEST, "Invalid host header")  # see `palpate.workbench.server`
            return
        if self.path.partition("?")[0] != "/":
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Cache-Control", "no-store")
        for name, value in {**HEADERS, "Content-Security-Policy": _POLICY}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(self.server.page)
        self.server.shutdown()

    def log_message(self, *_: object) -> None:
        """Log nothing."""


_TICKS = "tick"
_MOST_POINTS = 600  # of a curve


def thumbnail_svg(
    x: FloatArray, curves: Sequence[tuple[FloatArray, str]], width: int = 72, height: int = 44
) -> str:
    """Draw curves (n,) over x (n,) as a small SVG without axes.

    Args:
        x: shape (n,).
        curves: values (n,) and color of each.
        width: width [px].
        height: height [px].
    """
    every = np.concatenate([y for y, _ in curves])
    low, high = float(every.min()), float(every.max())
    left, right = float(x.min()), float(x.max())
    paths = []
    for y, color in curves:
        across = 2 + (width - 4) * (x - left) / ((right - left) or 1.0)
        down = height - 2 - (height - 4) * (y - low) / ((high - low) or 1.0)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))
        paths.append(f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="1.4"/>')
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'<svg {size} aria-hidden="true">{"".join(paths)}</svg>'


def raw_curves(file: Path) -> str:
    """Draw a probing's measured force and torques over time; empty for other files.

    Args:
        file: session or data file.

    Raises:
        SessionError: the file is a session that cannot be read.
    """
    if file.suffix != ".mcap":
        return ""
    opened = Session.open(file)
    if _TICKS not in opened.stream_names or not len(ticks := opened.samples(_TICKS)):
        return ""
    time_s, torques = ticks["time_s"], ticks.vector("torque_measured_nm").T
    colors = [palette.JOINTS[n % len(palette.JOINTS)] for n in range(len(torques))]
    return _panel("force [N]", time_s, [(ticks["force_n"], palette.MEASURED)]) + _panel(
        "joint torques [N m]", time_s, list(zip(torques, colors, strict=True))
    )


def _panel(title: str, time_s: FloatArray, curves: Sequence[tuple[FloatArray, str]]) -> str:
    rows = np.unique(np.concatenate([peak_rows(y, _MOST_POINTS) for y, _ in curves]))
    rows = rows[np.isfinite([y[rows] for y, _ in curves]).all(axis=0)]
    if not len(rows):
        return ""
    shown = [(y[rows], color) for y, color in curves]
    low, high = min(y.min() for y, _ in shown), max(y.max() for y, _ in shown)
    caption = f"{title} from {low:.3g} to {high:.3g}, over {np.ptp(time_s[rows]):.1f} s, as measured"
    return f"<h2>{caption}</h2>{thumbnail_svg(time_s[rows], shown, 1000, 200)}"
