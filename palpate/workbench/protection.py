"""What keeps the page to its own browser tab: no other site reaches the server, and no text becomes a script.

NiceGUI compiles its components' templates in the browser and runs what the server sends by `eval`, so its
policy must allow `unsafe-eval`. All other ways from text to code are closed: scripts need the nonce of this
answer, which only NiceGUI's own template gets, and `palpate.workbench.elements` sets properties by key.
"""

import secrets
from collections.abc import Callable

import jinja2
from nicegui import client
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from palpate.workbench.early_server import CLOSED, HEADERS

_OPEN = (
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' {sockets}; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'"
)
_POLICY, _UNFRAMED = "Content-Security-Policy", "frame-ancestors 'none'"
_NONCE = "nonce"  # key in a request's state
_ELSEWHERE = {"cross-site", "same-site"}  # as a browser says of a request that another page makes


class OwnPageOnly:
    """ASGI middleware: refuses what another page asks for, and gives each answer the page's policy.

    Args:
        app: what is served.
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
        elif self._is_foreign(Headers(scope=scope), is_socket=scope["type"] == "websocket"):
            refusal = WebSocketClose() if scope["type"] == "websocket" else PlainTextResponse("", 403)
            await refusal(scope, receive, send)
        else:
            nonce = scope.setdefault("state", {})[_NONCE] = secrets.token_urlsafe(16)
            await self._app(scope, receive, self._protected(send, nonce))

    def _is_foreign(self, headers: Headers, *, is_socket: bool) -> bool:
        """Whether another page asks; without an origin, nobody opens a socket."""
        origin = headers.get("origin")
        if origin is None:
            loaded = headers.get("sec-fetch-site") in _ELSEWHERE
            return is_socket or (loaded and headers.get("sec-fetch-mode") != "navigate")
        return origin not in self._origins

    def _protected(self, send: Send, nonce: str) -> Send:
        policy = f"{CLOSED}; {_OPEN.format(sockets=self._sockets, nonce=nonce)}"

        async def protected(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                own = headers.get(_POLICY)  # of a report, which is kept from the page itself
                headers.update({**HEADERS, _POLICY: f"{own}; {_UNFRAMED}" if own else policy})
            await send(message)

        return protected


class _WithNonce(jinja2.BaseLoader):
    """NiceGUI's templates with the nonce of the request in their own scripts; what is filled in has none."""

    def __init__(self, templates: jinja2.BaseLoader | None) -> None:
        assert templates is not None  # noqa: S101, NiceGUI loads them from a folder
        self._templates = templates

    def get_source(
        self, environment: jinja2.Environment, template: str
    ) -> tuple[str, str | None, Callable[[], bool] | None]:
        """One template; see `jinja2.BaseLoader`."""
        source, file, is_current = self._templates.get_source(environment, template)
        own = source.replace("<script", f'<script nonce="{{{{ request.state.{_NONCE} }}}}"')
        return own, file, is_current
