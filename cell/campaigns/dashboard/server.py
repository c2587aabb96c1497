"""Serve the history of a logs folder on this machine.

The pages have no scripts. Nothing in the folder is changed, so that a cell may run in it meanwhile.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import Route

from foldcell.cell.campaigns.dashboard.comparison import compare_runs
from foldcell.cell.campaigns.dashboard.entries import RunEntry
from foldcell.cell.campaigns.dashboard.history import History
from foldcell.cell.campaigns.dashboard.run_filter import RunFilter, page_of
from foldcell.cell.operator.local_server import served
from foldcell.cell.record.words import plain, seconds, value_in_words
from foldcell.cell.support.files.html_page import page_template

MAY_LOAD = "img-src 'self' data:; media-src 'self' data:; form-action 'self'"
SERVED = frozenset({".html", ".jpg", ".jpeg", ".png", ".webp", ".mp4", ".webm", ".rrd"})
"""Types of the files that are served: reports, pictures, films and recordings. Journals, settings and locks are
not served."""
REPORT, LAST_PICTURE = "report.html", "last.jpg"


def served_history(logs: Path, listener: socket.socket) -> AbstractContextManager[str]:
    """Serve the pages for the duration of the context, which yields their address.

    listener: from `open_listener`, closed at the end. Raises StorageError if the pages cannot be served.
    """
    return served(_Pages(logs).routes(), MAY_LOAD, listener, "the dashboard", "choose another --port, or 0")


class _Pages:
    """Answers on three routes: the list, two runs side by side, and the files of the logs folder."""

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._history = History(logs)

    def routes(self) -> list[Route]:
        return [
            Route("/", self.runs), Route("/compare", self.compare), Route("/files/{path:path}", self.file),
        ]  # fmt: skip

    # Starlette runs these functions in its worker threads, because they are not coroutines.

    def runs(self, request: Request) -> Response:
        content, wanted = self._history.read(), RunFilter.of_query(request.query_params)
        selected = wanted.selected(content.runs)
        shown, page, pages = page_of(selected, wanted.page)
        return self._page(
            "runs.html", logs=str(self._logs), content=content, wanted=wanted,
            chosen=content.by_key.get(wanted.chosen),
            results=wanted.results(content.runs), garments=_several(r.name for r in content.runs),
            failures=_several(r.failure for r in content.runs), names=_several(r.campaign for r in content.runs),
            runs=[(run, self._has(run, REPORT), self._has(run, LAST_PICTURE)) for run in shown],
            found=len(selected), page=page, pages=pages, read_at=time.time(), pair=_pair,
        )  # fmt: skip

    def compare(self, request: Request) -> Response:
        by_key = self._history.read().by_key
        names = [request.query_params.get(name, "") for name in ("first", "second")]
        found = [by_key.get(name) for name in names]
        if found[0] is None or found[1] is None:
            missing = [name for name, run in zip(names, found, strict=True) if run is None]
            return self._page("missing.html", status=404, missing=missing)
        first, second = found[0], found[1]
        return self._page(
            "comparison.html", first=first, second=second, comparison=compare_runs(first, second), pair=_pair,
            reports=[self._has(run, REPORT) for run in (first, second)],
        )  # fmt: skip

    def file(self, request: Request) -> Response:
        found = _served_file(self._logs, request.path_params["path"])
        if found is None:
            return Response("there is no such file, or it is not handed out\n", 404, media_type="text/plain")
        return FileResponse(found)

    def _has(self, run: RunEntry, name: str) -> bool:
        return (run.folder / name).is_file()

    def _page(self, template: str, status: int = 200, **values: Any) -> HTMLResponse:
        page = page_template(
            Path(__file__).with_name(template), path=quote, words=plain, when=_when, seconds=seconds,
            value=value_in_words,
        )  # fmt: skip
        return HTMLResponse(page.render(values), status)


def _several(names: Iterator[str]) -> list[str]:
    return sorted({name for name in names if name})


def _pair(first: RunEntry, second: RunEntry) -> str:
    return urlencode({"first": first.key, "second": second.key})


def _when(started: float | None, layout: str = "%Y-%m-%d %H:%M:%S") -> str:
    return "" if started is None else time.strftime(layout, time.localtime(started))


def _served_file(logs: Path, path: str) -> Path | None:
    """Return the file at `path`, relative to the logs folder; None if it must not be served.

    Symbolic links and `..` are resolved first, so that the file's real location decides.
    """
    try:
        root = logs.resolve(strict=True)
        found = (root / path).resolve(strict=True)
        inside = found.is_relative_to(root) and found.is_file()
    except (OSError, ValueError, RuntimeError):
        return None
    hidden = inside and any(part.startswith(".") for part in found.relative_to(root).parts)
    return found if inside and not hidden and found.suffix.lower() in SERVED else None
