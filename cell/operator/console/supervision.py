"""Supervise a run with the operator's page, which contains the Rerun view."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cell.operator.console.live_view import LiveView
from cell.operator.console.run_status import RunStatus
from cell.operator.console.server import operators_page
from cell.recording.rerun import Recorder
from cell.recording.rerun.live import viewer_address, web_viewer
from cell.states.commands import CommandQueue
from cell.states.fold_request import FoldRequest
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
    ) -> None:
        self._run_status, self._commands = run_status, commands
        self.live_view = live_view
        self._listener = listener
        self._viewer = web_viewer() if request.record else None

    @contextmanager
    def page(self, recorder: Recorder, stop: Stop, say: Callable[[str], None]) -> Iterator[None]:
        """Serve the operator's page for the duration of the context. Raises StorageError as `operators_page`
        does."""
        live = recorder.live_url
        viewer = viewer_address(self._viewer, live) if self._viewer and live else None
        with operators_page(
            self._run_status, self.live_view, self._commands, stop, viewer, self._listener
        ) as address:
            say(f"operator's page: {address}")
            yield
