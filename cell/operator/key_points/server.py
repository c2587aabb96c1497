"""Serve the page on which a person places key points, on this machine only. Messages from pages of other sites are
refused."""

from __future__ import annotations

import asyncio
import queue
import socket
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from foldcell.cell.operator.key_points.editing import KeyPointEdit
from foldcell.cell.operator.local_server import origins, served
from foldcell.cell.support.files.encoded_picture import jpeg_file
from foldcell.cell.support.files.html_page import read_page
from foldcell.cell.support.json_values import to_json
from foldcell.robots.errors import ConfigurationError, StorageError
from foldcell.robots.ports import Array

PAGE = Path(__file__).with_name("page.html")
MAY_LOAD = "script-src 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; form-action 'none'"
QUALITY = 96
"""Quality of the picture as a JPEG. It is high because the page magnifies the picture."""
LONGEST = 2**16
"""Maximum size of a message from the page [bytes]."""
LAST_WORD_S = 5.0
"""Longest time that the last answer may take to reach the page [s]."""
Points = Mapping[str, Array]
Pixel = Annotated[float, Field(allow_inf_nan=False)]


class _Message(BaseModel):
    """A message of the page: the key points, and the action that is to follow."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    points: dict[str, tuple[Pixel, Pixel]]
    then: Literal["check", "keep", "save", "cancel"]


@dataclass(frozen=True, eq=False)
class _Task:
    """A task that the page gives to the command."""

    then: str
    points: Points
    answer: Future[dict[str, Any]] = field(default_factory=Future)
    answered: threading.Event = field(default_factory=threading.Event)
    """Set when the page has the answer."""


def edit_key_points(
    edit: KeyPointEdit,
    listener: socket.socket,
    announce: Callable[[str], None],
    keep: Callable[[Points], str],
    save: Callable[[Points], str],
    forwarded: str = "",
) -> bool:
    """Serve the page until the person has saved the garment or cancelled. Returns whether it was saved.

    listener: from `open_listener`, closed at the end. announce: is given the address. keep: writes the key points,
    name -> (2,) [px]. save: writes the garment with these key points. Both return a text about the written files
    and are called on this thread. The page shows their ConfigurationError and StorageError, and the editing goes
    on. forwarded: see `origins`. Raises StorageError if the page cannot be served.
    """
    tasks: queue.Queue[_Task] = queue.Queue()
    routes = _Page(edit, tasks, origins(listener, forwarded)).routes()
    with served(routes, MAY_LOAD, listener, "the page of the key points", "choose another --page-port") as address:
        announce(address)
        while True:
            task, written = tasks.get(), None
            try:
                if task.then != "cancel":
                    written = (save if task.then == "save" else keep)(task.points)
            except (ConfigurationError, StorageError) as e:
                task.answer.set_result({"refused": e.what, "hint": e.hint})
                continue
            ended = task.then != "keep"
            task.answer.set_result({"written": written, "ended": ended})
            if ended:
                task.answered.wait(LAST_WORD_S)
                return task.then == "save"


class _Page:
    """Answers on the routes of the page: the page itself, the picture, what is edited, and the page's messages."""

    def __init__(self, edit: KeyPointEdit, tasks: queue.Queue[_Task], own_origins: list[str]) -> None:
        self._edit, self._tasks, self._origins = edit, tasks, own_origins
        self._latest = edit.start
        """The key points of the last message. A page that is loaded again shows them."""

    def routes(self) -> list[Route]:
        return [
            Route("/", self.page),
            Route("/picture.jpg", self.picture),
            Route("/edit", self.edited),
            Route("/points", self.points, methods=["POST"]),
        ]

    # Starlette runs functions that are not coroutines in its worker threads.

    def page(self, request: Request) -> Response:
        return HTMLResponse(read_page(PAGE))

    def picture(self, request: Request) -> Response:
        return Response(jpeg_file(self._edit.rgb, QUALITY), media_type="image/jpeg")

    def edited(self, request: Request) -> Response:
        edit = self._edit
        return _json({
            "title": edit.title, "names": edit.like.keypoints, "points": self._latest, "outline": edit.outline,
            "size": [edit.measure.columns, edit.measure.rows], "about": edit.about,
        })  # fmt: skip

    async def points(self, request: Request) -> Response:
        origin = request.headers.get("origin")
        if origin not in self._origins:
            hint = f"if you forward the page's port, give the command --page-origin {origin}"
            return _json({"refused": f"the request comes from another page ({origin}): {hint}"}, 403)
        length = request.headers.get("content-length", "")
        if not length.isdecimal() or int(length) > LONGEST:
            return _json({"refused": "the message is too long"}, 413)
        try:
            message = _Message.model_validate_json(await request.body())
        except ValidationError:
            return _json({"refused": "the message is not valid"}, 400)
        self._latest = {name: np.array(place) for name, place in message.points.items()}
        task = _Task(message.then, self._latest)
        shown = await run_in_threadpool(self._edit.shown, task.points)
        if task.then == "check":
            return _json(shown)
        if task.then == "save" and any(finding.refused for finding in shown["findings"]):
            return _json({**shown, "refused": "no garment can be made of these key points"})
        self._tasks.put(task)
        answer: dict[str, Any] = await asyncio.wrap_future(task.answer)
        return _json({**shown, **answer}, then=BackgroundTask(task.answered.set))


def _json(value: Mapping[str, Any], status: int = 200, then: BackgroundTask | None = None) -> Response:
    return JSONResponse(to_json(value), status, background=then)
