"""The live stream: a second recording stream on a separate thread, which never delays the run.

The stream is a server and never connects to a viewer. A stream that connects to a viewer can delay the end of the
process while the viewer hangs. If the viewer accepts the connection and stays silent, the process never ends.
Viewers can connect to the server at any time and then receive the stored entries.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

import rerun as rr
from rerun.error_utils import catch_and_log_exceptions

from foldcell.cell.view.blueprint import layout
from foldcell.cell.view.bounded_worker import BoundedWorker
from foldcell.cell.view.entries.entry import Entry
from foldcell.cell.view.streams import begin_stream
from foldcell.cell.view.viewer import HOST, free_port

OnError = Callable[[BaseException], None]

QUEUE = 400
"""Number of entries that may wait for a slow viewer: about five seconds of a run."""
CLOSE_S = 2.0
MEMORY = "512MiB"
"""Largest memory in which the server stores entries for viewers that connect later."""


class LiveStream:
    """Serves entries to viewers. If the queue is full, it drops entries and counts them."""

    def __init__(self, application: str, run_id: str, floor: float, on_error: OnError) -> None:
        self._port = free_port()
        self.url = f"rerun+http://{HOST}:{self._port}/proxy"
        self._identity = (application, run_id)
        self._floor = floor
        self._stream: rr.RecordingStream | None = None
        self._worker: BoundedWorker[Entry] = BoundedWorker(
            "recorder-live", self._write, on_error, QUEUE, self._connect, self._leave
        )

    def offer(self, entry: Entry) -> None:
        self._worker.offer(entry, essential=entry.essential)

    def close(self) -> int:
        """Close the stream within CLOSE_S. Returns the number of dropped entries."""
        self._worker.close(CLOSE_S)
        return self._worker.dropped

    # on the worker's thread: connecting, writing and disconnecting can each block for seconds

    def _connect(self) -> None:
        with socket.socket() as s:  # if Rerun cannot listen, it only writes that to its log
            s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            s.bind((HOST, self._port))
        sink = rr.GrpcServerSink(bind_ip=HOST, port=self._port, server_memory_limit=MEMORY)
        stream = begin_stream(self._identity[0], sink, layout(self._floor), self._identity[1])
        stream.send_recording_name(self._identity[1])
        self._stream = stream

    def _write(self, entry: Entry) -> None:
        if self._stream is not None:
            with catch_and_log_exceptions(strict=True):
                entry.write(self._stream)

    def _leave(self) -> None:
        if self._stream is not None:
            self._stream.disconnect()
