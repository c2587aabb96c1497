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
from starlette.websockets import WebSocket, WebSocketDisconnect

from cell.commands import CommandQueue
from cell.console.board import ANSWERS, Board
from cell.states import Event
from robots.errors import StorageError
from robots.ports import Stop

__all__ = ["operators_page"]

HOSTS = ["127.0.0.1", "localhost"]
PAGE = Path(__file__).with_name("page.html")
LOOK_S, ALIVE_S = 0.05, 1.0
"""How often the board is looked at for news, and a sign of life is sent."""
LAST_WORD_S = 0.5
"""For which the page is still served when the run has ended, so that it gets to know."""
LONGEST = 4096
"""Bytes of a message; a command has some fifty."""
POLICY = 1008
STOP_REASON = "the operator's page"


@contextmanager
def operators_page(
    board: Board, commands: CommandQueue, stop: Stop, viewer: str | None, port: int = 0
) -> Iterator[str]:
    """The page's address for as long as the context lasts. viewer: address of the Rerun viewer to show beside it;
    port: 0 takes a free one. Raises StorageError for a port that somebody has."""
    listener = _listener(port)
    secret = secrets.token_urlsafe(16)
    origin = listener.getsockname()[1]
    app = _Page(board, commands, stop, viewer, origin).app(secret)
    config = uvicorn.Config(
        app, log_level="error", lifespan="off", timeout_graceful_shutdown=1, ws_max_size=LONGEST
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([listener],), name="operators-page", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{origin}/{secret}/"
        time.sleep(LAST_WORD_S)
    finally:
        server.should_exit = True
        thread.join(3.0)
        listener.close()


def _listener(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
        listener.listen()  # who comes before the server runs has to wait, and is not refused
    except OSError as e:
        listener.close()
        raise StorageError(
            f"the operator's page cannot be served on port {port}: {e.strerror}", "choose another port, or 0"
        ) from e
    return listener


class _Page:
    """The page's two routes."""

    def __init__(self, board: Board, commands: CommandQueue, stop: Stop, viewer: str | None, port: int) -> None:
        self._board, self._commands, self._stop = board, commands, stop
        self._viewer = viewer
        self._origins = {f"http://{host}:{port}" for host in HOSTS}

    def app(self, secret: str) -> Starlette:
        routes = [Route(f"/{secret}/", self.page), WebSocketRoute(f"/{secret}/link", self.link)]
        return Starlette(routes=routes, middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=HOSTS)])

    async def page(self, request: Request) -> HTMLResponse:
        text = PAGE.read_text(encoding="utf-8").replace("{{viewer}}", json.dumps(self._viewer))
        return HTMLResponse(text, headers={"Cache-Control": "no-store", "X-Frame-Options": "DENY"})

    async def link(self, socket: WebSocket) -> None:
        if socket.headers.get("origin") not in self._origins:
            await socket.close(POLICY)
            return
        await socket.accept()
        telling = asyncio.create_task(self._tell(socket))
        try:
            while True:
                await socket.send_json(self._answer(await socket.receive_text()))
        except (WebSocketDisconnect, RuntimeError):  # the page was closed, or was closed on
            pass
        finally:
            telling.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await telling

    async def _tell(self, socket: WebSocket) -> None:
        told, spoke = -1, 0.0
        while True:
            version, now = self._board.version, time.monotonic()
            if version != told:
                await socket.send_json({"board": self._board.snapshot(), "stopped": self._stop.state().stopped})
                told, spoke = version, now
            elif now - spoke > ALIVE_S:
                await socket.send_json({"stopped": self._stop.state().stopped})
                spoke = now
            await asyncio.sleep(LOOK_S)

    def _answer(self, message: str) -> dict[str, Any]:
        """Do what a message says; what became of it, for the page. Nothing that it could hold raises."""
        try:
            said = json.loads(message)
        except ValueError:
            said = None
        if not isinstance(said, dict):
            return {"refused": "no message of this page"}
        if "stop" in said:
            self._stop.trigger(STOP_REASON)
            return {"noted": "stop"}
        word = said.get("say")
        command = next((event for event in self._board.allowed() if event.value == word), None)
        if command is None:
            return {"refused": f"'{word}' cannot be said now"}
        if command in ANSWERS and not self._board.answers(said.get("question")):
            return {"refused": "this question is no longer asked"}
        self._commands.put(Event(command))
        return {"noted": command.value}
