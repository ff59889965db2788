"""Answers at the page's address while what serves the page is still being imported, which takes seconds.

The first visitor sees what was measured, in a plain page; that page asks again at once, and the question
waits in the open socket, which the page's server then takes over.
"""

import socket
from base64 import b64encode
from hashlib import sha256
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingTCPServer
from threading import Thread

STYLE = (Path(__file__).parent / "workbench.css").read_text(encoding="utf-8")
_PATIENCE_S = 5.0  # with a browser that connects and asks nothing
_POLL_S = 0.02
_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>palpate workbench</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>{style}</style></head><body><div id="waiting">{body}</div>
<script>{script}</script></body></html>"""
_SCRIPT = 'addEventListener("load", () => setTimeout(() => location.reload(), 200))'

CLOSED = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
"""Content-Security-Policy: nothing is loaded but what is added to it; no other page may frame this one."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Of every answer: other pages can neither load it nor keep a handle of it."""

_POLICY = (
    f"{CLOSED}; style-src 'unsafe-inline'; img-src data:; "
    f"script-src 'sha256-{b64encode(sha256(_SCRIPT.encode()).digest()).decode()}'"
)


class EarlyServer(ThreadingTCPServer):
    """A port of this machine that is open, and whose first visitor is answered.

    Args:
        host: address that it listens at.
        port: 0 for any free one.

    Raises:
        OSError: somebody has the port.
    """

    allow_reuse_address = daemon_threads = True
    request_queue_size = 128  # all who ask before the page's server is there wait in the socket
    page = b""

    def __init__(self, host: str, port: int) -> None:
        super().__init__((host, port), _Reply)
        self.port = int(self.server_address[1])
        self._answers = False

    def answer_with(self, body: str) -> None:
        """Answer the first visitor with this HTML."""
        self.page, self._answers = _PAGE.format(body=body, style=STYLE, script=_SCRIPT).encode(), True
        Thread(target=self.serve_forever, args=(_POLL_S,), daemon=True).start()

    def release_socket(self) -> socket.socket:
        """The open socket; nobody is answered here any longer."""
        if self._answers:  # else it would wait for ever
            self.shutdown()
        return self.socket

    def handle_error(self, *_: object) -> None:
        """Leave alone who hangs up."""


class _Reply(BaseHTTPRequestHandler):
    server: EarlyServer
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        """The page, once: whoever asks after that waits for the server that comes.

        A page of an earlier server asks for other places, to be connected again: it is told to come back.
        """
        if self.headers.get("Host", "").rpartition(":")[0] not in {
            self.server.server_address[0],
            "localhost",
        }:
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
        """Say nothing of it."""
