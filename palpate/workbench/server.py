"""Serves the page on this machine alone, while the data is still being read."""

import asyncio
from pathlib import Path

from nicegui import app, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware

from palpate.workbench.home import Home

_STYLE = (Path(__file__).parent / "workbench.css").read_text(encoding="utf-8")
_POLL_S = 0.03
_CONNECT_S = 30.0
_AWAY_S = 30.0  # that a browser may be out of touch, on a busy machine, before the page begins anew


def serve(home: Home, host: str, port: int, *, browser: bool) -> None:
    """Serve until interrupted."""

    @ui.page("/", title="palpate workbench")
    async def page() -> None:
        ui.add_css(_STYLE)
        ui.colors(primary="#2a6fb0")
        waited = ui.label(f"{home.reading} …").classes("q-pa-lg quiet")
        await ui.context.client.connected(timeout=_CONNECT_S)
        while home.reading:
            await asyncio.sleep(_POLL_S)
        # with all that draws, while the browser is loading
        from palpate.workbench.compose import compose  # noqa: PLC0415

        waited.delete()
        await compose(home)

    # A foreign page whose name points here (DNS rebinding) must not press buttons: one powers an arm.
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[host, "localhost"])
    app.on_shutdown(_end)
    ui.run(
        host=host,
        port=port,
        show=browser,
        reload=False,
        show_welcome_message=False,
        favicon="◎",
        reconnect_timeout=_AWAY_S,
        tailwind=False,  # it looks through the page at every change
        uvicorn_logging_level="warning",
    )


def _end() -> None:
    from palpate.workbench.ahead import close_all  # noqa: PLC0415, as above

    close_all()
