"""Serve a page on this machine only. Its address contains a secret that is made for it."""

from __future__ import annotations

import secrets
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.routing import BaseRoute

from robots.errors import StorageError

__all__ = ["local_app", "new_secret", "open_listener", "origins", "served"]

HOSTS = ["127.0.0.1", "localhost"]
START_S = 10.0


def new_secret() -> str:
    """Return a secret for the path of an address."""
    return secrets.token_urlsafe(16)


def origins(port: int, scheme: str = "http") -> list[str]:
    """Return the origins of a page that this machine serves on a port."""
    return [f"{scheme}://{host}:{port}" for host in HOSTS]


def local_app(routes: list[BaseRoute]) -> Starlette:
    """Return an application that answers only requests that name this machine as their host."""
    return Starlette(routes=routes, middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=HOSTS)])


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
    app: Starlette, listener: socket.socket, what: str, hint: str, largest_message: int = 2**16
) -> Iterator[str]:
    """Serve `app` for the duration of the context. Yields the address, as in http://127.0.0.1:8000.

    listener: from `open_listener`, closed at the end. what: names the pages in messages; hint: what to do if they
    cannot be served. largest_message: of a WebSocket [bytes]. Raises StorageError if they cannot be served.
    """
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
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join(3.0)
        listener.close()
