"""What a supervised run has beside others: the board, the page that shows it, and the Rerun view in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cell.commands import CommandQueue
from cell.console.board import Board
from cell.console.server import operators_page
from cell.progress import ProgressLines
from cell.recorder import Recorder
from cell.recorder.live import viewer_address, web_viewer
from cell.requests import FoldRequest
from robots.ports import Stop

__all__ = ["Supervision"]


class Supervision:
    """Of one run. board: an observer; commands: the run's queue, which the board hears too."""

    def __init__(self, request: FoldRequest, run_id: str) -> None:
        self.board = Board(run_id, request.garment, request.seed, request.driver == "sim")
        self.commands = CommandQueue(self.board.heard)
        self._viewer = web_viewer() if request.record else None
        self._port = request.page_port

    @property
    def pages(self) -> tuple[str, ...]:
        """Origins that read the live stream."""
        return (self._viewer,) if self._viewer else ()

    @contextmanager
    def page(self, recorder: Recorder, stop: Stop, say: Callable[[str], None]) -> Iterator[None]:
        """The operator's page, for as long as the context lasts. Raises StorageError for a port in use."""
        live = recorder.live_url
        viewer = viewer_address(self._viewer, live) if self._viewer and live else None
        with operators_page(self.board, self.commands, stop, viewer, self._port) as address:
            say(f"operator's page: {address}")
            yield

    def also(self, lines: ProgressLines) -> tuple[Callable[[str], None], Callable[[int, int, str], None]]:
        """What is said within a state, and how far long computing is: for the lines and for the board."""

        def note(text: str) -> None:
            lines.note(text)
            self.board.note(text)

        def computing(done: int, total: int, remark: str) -> None:
            lines.computing(done, total, remark)
            self.board.computing(done, total, remark)

        return note, computing
