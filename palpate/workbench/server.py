"""Serves the page on this machine alone, while the data is still being read."""

import asyncio
from http import HTTPStatus
from socket import socket
from types import SimpleNamespace

import uvicorn
from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse
from nicegui import app, ui, ui_run_with
from starlette.middleware.trustedhost import TrustedHostMiddleware

from palpate.workbench.early_server import STYLE
from palpate.workbench.home import Home
from palpate.workbench.plot import Plot
from palpate.workbench.protection import OwnPageOnly

_POLL_S = 0.03
_CONNECT_S = 30.0
_RESENT = 30  # messages, with their curves, that are kept for a browser that was out of touch
_AWAY_S = 30.0  # that a browser may be out of touch, on a busy machine, before the page begins anew


def serve(home: Home, listening: socket) -> None:
    """Serve at an open socket until interrupted."""

    @ui.page("/", title="palpate workbench", response_timeout=_CONNECT_S)
    async def page() -> None:
        ui.add_head_html(f"<style>{STYLE}</style>")
        ui.colors(primary="#2a6fb0")
        if home.reading:
            await _wait(home)
        else:
            await ui.context.client.connected(timeout=_CONNECT_S)
        # with all that draws, while the browser is loading
        from palpate.workbench.compose import compose  # noqa: PLC0415

        await compose(home)
        ui.run_javascript("document.getElementById('waiting')?.remove()")

    @app.get("/report/{key}")
    def report(key: str) -> FileResponse:
        if key not in home.reports:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        # The file holds text of a measurement: in an origin of its own, it cannot press buttons of the page.
        return FileResponse(home.reports[key], headers={"Content-Security-Policy": "sandbox allow-scripts"})

    app.on_shutdown(lambda: _end(home))
    served = FastAPI()
    # A foreign page whose name points here (DNS rebinding) must not press buttons: one powers an arm.
    host, port = listening.getsockname()
    served.add_middleware(TrustedHostMiddleware, allowed_hosts=[host, "localhost"])
    served.add_middleware(OwnPageOnly, origins=(f"http://{host}:{port}", f"http://localhost:{port}"))
    ui.run_with(
        served,
        favicon="◎",
        reconnect_timeout=_AWAY_S,
        message_history_length=_RESENT,
        gzip_middleware_factory=None,  # nothing leaves this machine
        tailwind=False,  # it looks through the page at every change
        show_welcome_message=False,
    )
    server = uvicorn.Server(uvicorn.Config(served, log_level="warning", ws="wsproto"))
    # NiceGUI looks for its server among all objects of the program. That holds tuples which the thread that
    # reads the data is just building, and Python then raises SystemError there.
    vars(ui_run_with)["gc"] = SimpleNamespace(get_objects=lambda: [server])
    server.run([listening])


async def _wait(home: Home) -> None:
    """Show what was measured, in the page as it is first sent, until the data can be worked with."""
    ui.add_body_html(f'<div id="waiting">{home.waiting}</div>')
    Plot({})  # for the browser to load what draws
    await ui.context.client.connected(timeout=_CONNECT_S)
    while home.reading:
        await asyncio.sleep(_POLL_S)


def _end(home: Home) -> None:
    from palpate.workbench.ahead import close_all  # noqa: PLC0415, as above

    close_all()
    if home.feed is not None:
        home.feed.close()
