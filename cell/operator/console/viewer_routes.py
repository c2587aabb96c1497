"""The 3-D view of the operator's page: Rerun's web viewer and the recording, under the page's own address.

The viewer reads the recording over HTTP while it is written. By itself, the viewer would report its use to its
makers, ask for newer versions and load fonts. The Content-Security-Policy prevents this: the viewer's page can
reach only this server.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route

from foldcell.cell.operator.local_server import content_policy
from foldcell.cell.view.viewer import web_viewer_files
from foldcell.robots.errors import StorageError

PAGE = Path(__file__).with_name("viewer.html")
HEADERS = content_policy(
    "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; connect-src 'self'; img-src 'self' data: blob:;"
    " worker-src 'self' blob:; form-action 'none'"
)
SCRIPT, PROGRAM = "re_viewer.js", "re_viewer_bg.wasm"
CHUNK = 2**18
"""The recording is sent in pieces of at most this size [bytes]."""
PERIOD_S = 0.2
"""Period at which the recording is checked for more content [s]."""


def recorded_view(recording: Path) -> tuple[Path, Path] | None:
    """Return the folder of the web viewer's program and the recording to show. None if the program is not
    installed; the page works without it."""
    try:
        return web_viewer_files(), recording
    except StorageError:
        return None


def viewer_routes(prefix: str, files: Path, shown: Path, ended: Callable[[], bool]) -> list[Route]:
    """Return the routes of the 3-D view below the path `prefix`. files: folder with the files of the web viewer;
    shown: the recording; ended: whether nothing will be added to the recording any more."""

    async def page(request: Request) -> Response:
        return Response(PAGE.read_bytes(), media_type="text/html", headers=HEADERS)

    async def recording(request: Request) -> Response:
        if not shown.is_file():
            return Response(status_code=404, headers=HEADERS)
        return StreamingResponse(
            growing_file(shown, ended), media_type="application/octet-stream", headers=HEADERS
        )

    def program(name: str, kind: str) -> Route:
        async def file(request: Request) -> Response:
            return FileResponse(files / name, media_type=kind, headers=HEADERS)

        return Route(f"{prefix}{name}", file)

    return [
        Route(prefix, page),
        program(SCRIPT, "text/javascript"),
        program(PROGRAM, "application/wasm"),
        Route(f"{prefix}run.rrd", recording),
    ]


async def growing_file(path: Path, ended: Callable[[], bool]) -> AsyncIterator[bytes]:
    """Yield the content of a file, and later additions to it, until `ended`."""
    with path.open("rb") as file:
        while True:
            last = ended()  # asked before reading, so that nothing is missed
            while piece := file.read(CHUNK):
                yield piece
            if last:
                return
            await asyncio.sleep(PERIOD_S)
