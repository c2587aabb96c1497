"""Serves the operator's page on this machine, and takes what the operator says to it.

The page talks over one WebSocket: it gets snapshots of the board as they change and a sign of life in between, and
sends commands. A command is put into the one queue like any other; the stop goes straight to the stop circuit.
Only who knows the page's address may speak: it holds a secret made for this run, and other sites' pages are
refused by their origin.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from cell.operator.console.run_status import RunStatus
from cell.states.commands import ANSWERS, CommandQueue
from cell.states.state_chart import marked_chart
from robots.errors import DriverError, StorageError
from robots.ports import Stop

__all__ = ["open_listener", "operators_page"]

HOSTS = ["127.0.0.1", "localhost"]
PAGE = Path(__file__).with_name("page.html")
HEADERS = {
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",  # the address is the secret
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " connect-src 'self' ws:; frame-src http://127.0.0.1:*; base-uri 'none'; form-action 'none'",
}
START_S = 10.0
LOOK_S, ALIVE_S = 0.05, 1.0
"""How often the board is looked at for news, and a sign of life is sent."""
LAST_WORD_S = 0.5
"""For which the page is still served when the run has ended, so that it gets to know."""
LONGEST = 4096
"""Bytes of a message; a command has some fifty."""
POLICY = 1008
STOP_REASON = "the operator's page"


def open_listener(port: int = 0) -> socket.socket:
    """The page's own socket, on this machine only; port 0 takes a free one. Who comes before the page is served
    has to wait, and is not refused. Raises StorageError for a port that somebody has."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
        listener.listen()
    except OSError as e:
        listener.close()
        raise StorageError(
            f"the operator's page cannot be served on port {port}: {e.strerror}", "choose another port, or 0"
        ) from e
    return listener


@contextmanager
def operators_page(
    run_status: RunStatus, commands: CommandQueue, stop: Stop, viewer: str | None, listener: socket.socket
) -> Iterator[str]:
    """The page's address for as long as the context lasts. viewer: address of the Rerun viewer to show beside it;
    listener: from `open_listener`, closed at the end. Raises StorageError when the page cannot be served."""
    secret = secrets.token_urlsafe(16)
    port = listener.getsockname()[1]
    app = _Page(run_status, commands, stop, viewer, port).app(secret)
    config = uvicorn.Config(
        app, log_level="critical", lifespan="off", timeout_graceful_shutdown=1, ws_max_size=LONGEST
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([listener],), name="operators-page", daemon=True)
    thread.start()
    try:
        _await_start(server, thread)
        yield f"http://127.0.0.1:{port}/{secret}/"
        time.sleep(LAST_WORD_S)
    finally:
        server.should_exit = True
        thread.join(3.0)
        listener.close()


def _await_start(server: uvicorn.Server, thread: threading.Thread) -> None:
    deadline = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > deadline:
            raise StorageError("the operator's page cannot be served", "try --no-page, and keys at the terminal")
        time.sleep(0.01)


class _Page:
    """The page's two routes."""

    def __init__(
        self, run_status: RunStatus, commands: CommandQueue, stop: Stop, viewer: str | None, port: int
    ) -> None:
        self._run_status, self._commands, self._stop = run_status, commands, stop
        self._viewer = viewer
        self._origins = {f"http://{host}:{port}" for host in HOSTS}

    def app(self, secret: str) -> Starlette:
        routes = [Route(f"/{secret}/", self.page), WebSocketRoute(f"/{secret}/link", self.link)]
        return Starlette(routes=routes, middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=HOSTS)])

    async def page(self, request: Request) -> HTMLResponse:
        viewer = json.dumps(self._viewer).replace("<", "\\u003c")
        page = PAGE.read_text(encoding="utf-8").replace("{{viewer}}", viewer).replace("{{chart}}", marked_chart())
        return HTMLResponse(page, headers=HEADERS)

    async def link(self, link: WebSocket) -> None:
        """One page's link. It is closed when either side of it fails: a page that hears nothing must know."""
        if link.headers.get("origin") not in self._origins:
            await link.close(POLICY)
            return
        await link.accept()
        sides = {asyncio.create_task(self._tell(link)), asyncio.create_task(self._hear(link))}
        _, open_still = await asyncio.wait(sides, return_when=asyncio.FIRST_COMPLETED)
        for side in open_still:
            side.cancel()
        await asyncio.gather(*sides, return_exceptions=True)
        with contextlib.suppress(Exception):  # it may be closed already, from either end
            await link.close()

    async def _tell(self, link: WebSocket) -> None:
        told, spoke = -1, 0.0
        while True:
            version, now = self._run_status.version, time.monotonic()
            if version != told:
                await link.send_json({"run_status": self._run_status.snapshot(), "stopped": self._stopped()})
                told, spoke = version, now
            elif now - spoke > ALIVE_S:
                await link.send_json({"stopped": self._stopped()})
                spoke = now
            await asyncio.sleep(LOOK_S)

    async def _hear(self, link: WebSocket) -> None:
        while True:
            frame = await link.receive()
            if frame["type"] == "websocket.disconnect":
                return
            try:
                answer = self._answer(frame.get("text") or "")
            except Exception:  # nothing that is said may end the link: the next word may be stop
                answer = {"refused": "no message of this page"}
            await link.send_json(answer)

    def _stopped(self) -> bool | None:
        """None where the driver cannot tell."""
        try:
            return self._stop.state().stopped
        except DriverError:
            return None

    def _answer(self, message: str) -> dict[str, Any]:
        """Do what a message says; what became of it, for the page."""
        said = json.loads(message)
        if "stop" in said:
            self._stop.trigger(STOP_REASON)
            return {"noted": "stop"}
        command = next((event for event in self._run_status.allowed() if event.value == said["say"]), None)
        if command is None:
            return {"refused": "that cannot be said now"}
        if command in ANSWERS and not self._run_status.answers(said.get("question")):
            return {"refused": "this question is no longer asked"}
        self._commands.put(command)
        return {"noted": command.value}
