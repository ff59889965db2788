"""Serve the page on this machine only, and protect it from other sites.

NiceGUI compiles its components' templates in the browser and runs what the server sends by `eval`, so its
policy must allow `unsafe-eval`. All other ways to run text as code are blocked: scripts need the nonce of the
response, which only NiceGUI's own template has, and `palpate.workbench.elements` sets properties by key.
"""

import asyncio
import secrets
import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from socket import socket
from threading import Thread
from types import SimpleNamespace
from typing import TYPE_CHECKING

import jinja2
import uvicorn
from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse
from nicegui import app, client, ui, ui_run_with
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from palpate.render.notebook import PageAddress
from palpate.robot_io.errors import InputError
from palpate.workbench.elements import Plot
from palpate.workbench.processes import stop_diagnoses
from palpate.workbench.startup import CLOSED, HEADERS, LOOPBACK, STYLE, AppState, EarlyServer
from palpate.workbench.state import WorkbenchState

if TYPE_CHECKING:
    from palpate.study import Study

_OPEN = (
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' {sockets}; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'"
)
_POLICY, _UNFRAMED = "Content-Security-Policy", "frame-ancestors 'none'"
_NONCE = "nonce"  # key in a request's state
_ELSEWHERE = {"cross-site", "same-site"}  # header values of another page's request


class OwnPageOnly:
    """ASGI middleware that rejects requests of other pages, and adds the page's policy to each response.

    Args:
        app: application to serve.
        origins: addresses of the page itself, such as "http://127.0.0.1:8090".
    """

    def __init__(self, app: ASGIApp, origins: tuple[str, ...]) -> None:
        self._app, self._origins = app, origins
        self._sockets = " ".join(origin.replace("http:", "ws:") for origin in origins)
        client.templates.env.loader = _WithNonce(client.templates.env.loader)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers, is_socket = Headers(scope=scope), scope["type"] == "websocket"
        origin = headers.get("origin")
        is_foreign = origin not in self._origins
        if origin is None:  # browsers always state an origin
            is_loaded = headers.get("sec-fetch-site") in _ELSEWHERE
            is_foreign = is_socket or (is_loaded and headers.get("sec-fetch-mode") != "navigate")
        if is_foreign:
            refusal = WebSocketClose() if is_socket else PlainTextResponse("", 403)
            await refusal(scope, receive, send)
        else:
            nonce = scope.setdefault("state", {})[_NONCE] = secrets.token_urlsafe(16)
            policy = f"{CLOSED}; {_OPEN.format(sockets=self._sockets, nonce=nonce)}"

            async def send_with_policy(message: Message) -> None:
                if message["type"] == "http.response.start":
                    answer = MutableHeaders(scope=message)
                    own = answer.get(_POLICY)  # policy of a report, which is isolated from the page
                    answer.update({**HEADERS, _POLICY: f"{own}; {_UNFRAMED}" if own else policy})
                await send(message)

            await self._app(scope, receive, send_with_policy)


class _WithNonce(jinja2.BaseLoader):
    """Loader that adds the request's nonce to scripts of NiceGUI's templates, but not to inserted text."""

    def __init__(self, templates: jinja2.BaseLoader | None) -> None:
        assert templates is not None  # noqa: S101, NiceGUI loads them from a folder
        self._templates = templates

    def get_source(
        self, environment: jinja2.Environment, template: str
    ) -> tuple[str, str | None, Callable[[], bool] | None]:
        """Return one template; see `jinja2.BaseLoader`."""
        source, file, is_current = self._templates.get_source(environment, template)
        own = source.replace("<script", f'<script nonce="{{{{ request.state.{_NONCE} }}}}"')
        return own, file, is_current


_POLL_S = 0.03
_CONNECT_S = 30.0
_RESENT = 30  # messages buffered for a disconnected browser
_AWAY_S = 30.0  # time that a browser may be disconnected before the page restarts [s]


def serve(home: AppState, listening: socket) -> None:
    """Serve at an open socket until interrupted.

    Args:
        home: state of the server.
        listening: open socket.
    """

    @ui.page("/", title="palpate workbench", response_timeout=_CONNECT_S)
    async def page() -> None:
        ui.add_head_html(f"<style>{STYLE}</style>")
        ui.colors(primary="#2a6fb0")
        is_reading = bool(home.reading)
        if is_reading:  # the first page shows the raw curves
            ui.add_body_html(f'<div id="waiting">{home.waiting}</div>')
            Plot({})  # lets the browser load the plotting library
        await ui.context.client.connected(timeout=_CONNECT_S)
        while is_reading and home.reading:
            await asyncio.sleep(_POLL_S)
        # import the plotting modules while the browser loads
        from palpate.workbench.layout import lay_out_page  # noqa: PLC0415

        await lay_out_page(home)
        ui.run_javascript("document.getElementById('waiting')?.remove()")

    @app.get("/report/{key}")
    def report(key: str) -> FileResponse:
        if key not in home.reports:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        # The file contains text of a measurement. In a separate origin it cannot press buttons of the page.
        return FileResponse(home.reports[key], headers={"Content-Security-Policy": "sandbox allow-scripts"})

    app.on_shutdown(stop_diagnoses)
    if home.feed is not None:
        app.on_shutdown(home.feed.close)
    served = FastAPI()
    # A foreign page whose name points here (DNS rebinding) must not press buttons, because one powers an arm.
    host, port = listening.getsockname()
    served.add_middleware(TrustedHostMiddleware, allowed_hosts=[host, "localhost"])
    served.add_middleware(OwnPageOnly, origins=(f"http://{host}:{port}", f"http://localhost:{port}"))
    ui.run_with(
        served,
        favicon="◎",
        reconnect_timeout=_AWAY_S,
        message_history_length=_RESENT,
        gzip_middleware_factory=None,  # all traffic is local
        tailwind=False,  # Tailwind scans the page at every change
        show_welcome_message=False,
    )
    server = uvicorn.Server(uvicorn.Config(served, log_level="warning", ws="wsproto"))
    # NiceGUI searches its server among all objects of the program. These include tuples that the thread that
    # reads the data is just building, and Python then raises SystemError there.
    vars(ui_run_with)["gc"] = SimpleNamespace(get_objects=lambda: [server])
    server.run([listening])


_pages: list[str] = []  # addresses of open pages of this program


def open_page(study: "Study", port: int = 0, *, browser: bool = True) -> PageAddress:
    """Serve the page of a study in a thread of this program.

    Args:
        study: study to show.
        port: port on this machine; 0 for any free port.
        browser: whether to open the page in a browser.

    Raises:
        InputError: the port is taken, or a page is open already.
    """
    if _pages:
        raise InputError(f"workbench(): a page is already open at {_pages[0]}; close it first")
    early = EarlyServer(port)
    address = PageAddress(f"http://{LOOPBACK}:{early.port}")
    home = AppState(Path(), state=WorkbenchState(study))
    home.open = lambda path, options: WorkbenchState(type(study)(path, **options.stated()))
    Thread(target=serve, args=(home, early.release_socket()), daemon=True).start()
    _pages.append(address)
    if browser:
        Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    return address
