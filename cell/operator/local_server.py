"""Serve pages on this machine only.

The address of the pages contains a new secret. The pages load nothing from elsewhere, and no other page can embed
them or learn their address.
"""

from __future__ import annotations

import secrets
import socket
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.routing import BaseRoute, Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from foldcell.robots.errors import StorageError

HOSTS = ["127.0.0.1", "localhost"]
START_S = 10.0
HEADERS = {
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",  # the address contains the secret
}


def content_policy(may: str) -> dict[str, str]:
    """Return the header that states what a page may load and send. may: directives of Content-Security-Policy;
    anything else is forbidden, except the page's own styles."""
    own = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'"
    return {"Content-Security-Policy": f"{own}; {may}"}


def origins(listener: socket.socket, forwarded: str = "") -> list[str]:
    """Return the origins of a page that is served at the listener's port. forwarded: a further one, which the
    user named because a forwarded port or a proxy leads to the page; empty for none."""
    own = [f"http://{host}:{listener.getsockname()[1]}" for host in HOSTS]
    return [*own, forwarded] if forwarded else own


class _WithHeaders:
    """Adds headers to every answer that does not state them itself."""

    def __init__(self, app: ASGIApp, headers: Mapping[str, str]) -> None:
        self._app, self._headers = app, headers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def complete(message: Message) -> None:
            if message["type"] == "http.response.start":
                stated = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    stated.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, complete)


def open_listener(port: int = 0) -> socket.socket:
    """Open the page's socket, on this machine only. Port 0 chooses a free port. Clients that connect before the
    page is served wait. Raises StorageError if the port is in use."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
        listener.listen()
    except OSError as e:
        listener.close()
        raise StorageError(
            f"the page cannot be served on port {port}: {e.strerror}", "choose another port, or 0"
        ) from e
    return listener


@contextmanager
def served(
    routes: Sequence[BaseRoute], may: str, listener: socket.socket, what: str, hint: str,
    largest_message: int = 2**16,
) -> Iterator[str]:  # fmt: skip
    """Serve `routes` for the duration of the context. Yields the address that precedes their paths, as in
    http://127.0.0.1:8000/SECRET/. Only requests that name this machine as their host are answered.

    may: what the pages may load and send, see `content_policy`. listener: from `open_listener`, closed at the end.
    what: names the pages in messages; hint: what to do if they cannot be served. largest_message: maximum size of
    a WebSocket message [bytes]. Raises StorageError if they cannot be served.
    """
    secret = secrets.token_urlsafe(16)
    app = Starlette(
        routes=[Mount(f"/{secret}", routes=routes)],
        middleware=[
            Middleware(_WithHeaders, headers={**HEADERS, **content_policy(may)}),
            Middleware(TrustedHostMiddleware, allowed_hosts=HOSTS),
        ],
    )
    config = uvicorn.Config(
        app, log_level="critical", lifespan="off", timeout_graceful_shutdown=1, ws_max_size=largest_message
    )
    server = uvicorn.Server(config)
    port = listener.getsockname()[1]
    thread = threading.Thread(target=server.run, args=([listener],), name=what, daemon=True)
    thread.start()
    try:
        deadline = time.monotonic() + START_S
        while not server.started:
            if not thread.is_alive() or time.monotonic() > deadline:
                raise StorageError(f"{what} cannot be served", hint)
            time.sleep(0.01)
        yield f"http://127.0.0.1:{port}/{secret}/"
    finally:
        server.should_exit = True
        thread.join(3.0)
        listener.close()
