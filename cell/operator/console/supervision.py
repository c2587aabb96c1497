"""Supervise a run with the operator's page, which links to the 3-D view of the recording."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cell.operator.console.live_view import LiveView
from cell.operator.console.run_status import RunStatus
from cell.operator.console.server import operators_page
from cell.states.commands import CommandQueue
from cell.states.fold_request import FoldRequest
from cell.view.viewing.web_viewer import web_viewer_files
from robots.errors import StorageError
from robots.ports import Stop

__all__ = ["Supervision"]


class Supervision:
    """Supervision of one run. run_status: the status that the page shows; live_view: its picture; commands: the
    run's queue, which gets the commands from the page."""

    def __init__(
        self,
        request: FoldRequest,
        run_status: RunStatus,
        live_view: LiveView,
        commands: CommandQueue,
        listener: socket.socket,
        recording: Path,
    ) -> None:
        """recording: the file `run.rrd` of the run, for the 3-D view."""
        self._run_status, self._commands = run_status, commands
        self.live_view = live_view
        self._listener = listener
        self._viewer = _viewer(recording) if request.record else None

    @contextmanager
    def page(self, stop: Stop, say: Callable[[str], None]) -> Iterator[None]:
        """Serve the operator's page for the duration of the context. Raises StorageError as `operators_page`
        does."""
        try:
            with operators_page(
                self._run_status, self.live_view, self._commands, stop, self._viewer, self._listener
            ) as address:
                say(f"operator's page: {address}")
                yield
        finally:
            self.live_view.close()


def _viewer(recording: Path) -> tuple[Path, Path] | None:
    try:
        return web_viewer_files(), recording
    except StorageError:  # the page works without the 3-D view
        return None
