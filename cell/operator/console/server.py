"""Serve the operator's page on this machine and receive the operator's commands.

The page has one WebSocket. Over it, the page receives a snapshot of the run's status after each change and
keep-alive messages in between, and sends commands. A command is put into the run's queue like any other command. A
stop triggers the stop circuit directly. Links from pages of other sites are refused because of their origin.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from foldcell.cell.operator.console.live_view import LiveView
from foldcell.cell.operator.console.messages import (
    ControlMessage,
    EditMessage,
    JudgeMessage,
    StopMessage,
    read_message,
)
from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.console.viewer_routes import viewer_routes
from foldcell.cell.operator.local_server import origins, served
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.states.commands import ANSWERS, CommandQueue
from foldcell.cell.states.state_chart import marked_chart
from foldcell.cell.states.transition_table import Event
from foldcell.cell.support.files.html_page import read_page
from foldcell.robots.errors import DriverError
from foldcell.robots.ports import Stop

PAGE = Path(__file__).with_name("page.html")
VIEWER = "viewer/"
"""Path of the 3-D view, relative to the page."""
MAY_LOAD = "script-src 'unsafe-inline'; img-src 'self' data:; connect-src 'self' {sockets}; form-action 'none'"
LOOK_S, ALIVE_S = 0.05, 0.3
"""LOOK_S: period at which the status is checked for changes. ALIVE_S: longest time between two messages [s]."""
LAST_WORD_S = 0.5
"""The page is served for this time after the run's end, so that the browser receives the last status [s]."""
LONGEST = 4096
"""Maximum size of a message from the page [bytes]. A command has about fifty."""
POLICY = 1008
STOP_REASON = "the operator's page"


@contextmanager
def operators_page(
    run_status: RunStatus,
    live_view: LiveView,
    commands: CommandQueue,
    stop: Stop,
    viewer: tuple[Path, Path] | None,
    listener: socket.socket,
    forwarded: str = "",
) -> Iterator[str]:
    """Serve the page for the duration of the context, then close the live view. Yields the page's address.

    viewer: folder with the program files of Rerun's web viewer, and the recording that it shows; None: no 3-D
    view. listener: from `open_listener`, closed at the end. forwarded: see
    `origins`. Raises StorageError if the page cannot be served.
    """
    ended = threading.Event()
    view = viewer_routes(f"/{VIEWER}", *viewer, ended.is_set) if viewer else []
    page = _Page(run_status, live_view, commands, stop, view, origins(listener, forwarded))
    may, hint = (
        MAY_LOAD.format(sockets=" ".join("ws" + at.removeprefix("http") for at in origins(listener, forwarded))),
        "use --no-page and keys at the terminal",
    )
    with served(page.routes(), may, listener, "the operator's page", hint, LONGEST) as address:
        try:
            yield address
            ended.set()
            time.sleep(LAST_WORD_S)
        finally:
            ended.set()
            live_view.close()


class _Page:
    """Answers on the routes of the page: the page, its WebSocket, the operator's picture, and the 3-D view."""

    def __init__(
        self,
        run_status: RunStatus,
        live_view: LiveView,
        commands: CommandQueue,
        stop: Stop,
        viewer: list[Route],
        own_origins: list[str],
    ) -> None:
        self._run_status, self._live_view, self._commands, self._stop = run_status, live_view, commands, stop
        self._viewer, self._origins = viewer, own_origins
        self._in_control: str | None = None
        self._links: Counter[str] = Counter()

    def routes(self) -> list[BaseRoute]:
        own = [Route("/", self.page), Route("/picture.jpg", self.picture), WebSocketRoute("/link", self.link)]
        return [*own, *self._viewer]

    async def page(self, request: Request) -> HTMLResponse:
        viewer = json.dumps(VIEWER if self._viewer else None)
        page = read_page(PAGE).replace("{{viewer}}", viewer).replace("{{chart}}", marked_chart())
        page = page.replace("{{origins}}", json.dumps(self._origins))
        return HTMLResponse(page)

    async def picture(self, request: Request) -> Response:
        """Return the operator's picture of this moment."""
        drawn = await run_in_threadpool(self._live_view.jpeg)
        if drawn is None:
            return Response(status_code=404)
        number, content = drawn
        return Response(content, media_type="image/jpeg", headers={"X-Picture": str(number)})

    async def link(self, link: WebSocket) -> None:
        """Serve the WebSocket of one open page. The socket is closed if sending or receiving fails, so that the
        page notices the failure."""
        if link.headers.get("origin") not in self._origins:
            await link.close(POLICY)
            return
        await link.accept()
        page = link.query_params.get("page", "")
        self._links[page] += 1
        if self._in_control is None:  # the first page has control, until another one takes it
            self._in_control = page
        tasks = {asyncio.create_task(self._send(link, page)), asyncio.create_task(self._receive(link, page))}
        _, pending = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._links[page] -= 1
        if self._in_control == page and not self._links[page]:
            self._in_control = None
        with contextlib.suppress(Exception):  # either end may have closed it already
            await link.close()

    async def _send(self, link: WebSocket, page: str) -> None:
        sent_version, sent_picture, sent_at, sent_control = -1, -1, 0.0, ""
        while True:
            version, now, picture = self._run_status.version, time.monotonic(), self._live_view.about()
            number, control = -1 if picture is None else picture["number"], self._control(page)
            news = {"picture": picture, "stopped": self._stopped(), "control": control}
            if version != sent_version:
                changes = self._live_view.changes()
                await link.send_json({"run_status": {**self._run_status.snapshot(), "changes": changes}, **news})
                sent_version, sent_picture, sent_at, sent_control = version, number, now, control
            elif (number, control) != (sent_picture, sent_control) or now - sent_at > ALIVE_S:
                await link.send_json(news)
                sent_picture, sent_at, sent_control = number, now, control
            await asyncio.sleep(LOOK_S)

    async def _receive(self, link: WebSocket, page: str) -> None:
        while True:
            frame = await link.receive()
            if frame["type"] == "websocket.disconnect":
                return
            try:
                answer = self._answer(frame.get("text") or frame.get("bytes") or "", page)
            except Exception as e:  # an error must not close the link: the next message may be a stop
                answer = {"refused": f"the message could not be carried out: {e}"}
            await link.send_json(answer)

    def _stopped(self) -> bool | None:
        """Whether the stop is triggered; None if the driver cannot read it."""
        try:
            return self._stop.state().stopped
        except DriverError:
            return None

    def _control(self, page: str) -> str:
        if self._in_control is None:
            return "free"
        return "yours" if self._in_control == page else "other"

    def _answer(self, text: str | bytes, page: str) -> dict[str, Any]:
        """Carry out a message (cell/operator/console/messages.py). Returns the answer for the page."""
        message = read_message(text)
        if message is None:
            return {"refused": "the message is not valid"}
        if isinstance(message, StopMessage):
            self._stop.trigger(STOP_REASON)
            return {"noted": "stop"}
        if isinstance(message, ControlMessage):
            self._in_control = page
            self._run_status.note("another page has taken control")
            return {"control": "yours"}
        if self._in_control != page:
            return {"refused": "another page has control: take control first", "control": self._control(page)}
        if isinstance(message, EditMessage):
            return self._edited(message, page)
        if isinstance(message, JudgeMessage):
            judgement = Judgement(message.judge.passed, message.judge.why.strip())
            if self._run_status.judged(message.question, judgement):
                return {"noted": "verdict"}
            return {"refused": "the garment is not judged now"}
        command = next((event for event in self._run_status.allowed() if event.value == message.say), None)
        if command is None:
            return {"refused": "this command is not possible now"}
        if command in ANSWERS and not self._run_status.answers(message.question):
            return {"refused": "this question is no longer open"}
        self._commands.put(command)
        return {"noted": command.value}

    def _edited(self, message: EditMessage, page: str) -> dict[str, Any]:
        """Pass a change of the plan on to the executive, which checks it."""
        if self._live_view.changes() is None:
            return {"refused": "there is no plan now that can be changed"}
        if not self._run_status.answers(message.question):
            return {"refused": "this question is no longer open"}
        edit = self._live_view.edit(message.edit, f"page {page[:6]}")
        if edit is None:
            return {"refused": "this place is not on the table"}
        self._commands.put(Event.EDIT, edit)
        return {"noted": Event.EDIT.value}
