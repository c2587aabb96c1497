"""Recording streams that leave no thread and no memory in the process when they end.

Rerun keeps an ended stream with its two threads until the process ends (rerun #2116), unless no reference to the
stream is left and a clean-up is requested. A blueprint that is given to `set_sinks` is never freed, because its
stream and the memory that it writes to refer to each other. This module therefore sends the blueprint's content
itself and then disconnects the blueprint's stream.
"""

from __future__ import annotations

import gc
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun import bindings  # type: ignore[attr-defined]


def begin_stream(
    application: str, sink: Any, layout: rrb.Blueprint, identity: str | None = None
) -> rr.RecordingStream:
    """Begin a stream to `sink` (rr.FileSink, rr.GrpcServerSink) with a default layout. identity: the recording's
    id."""
    stream = rr.RecordingStream(application, recording_id=identity)
    stream.set_sinks(sink)
    drawn = rr.RecordingStream._from_native(
        bindings.new_blueprint(
            application_id=application, make_default=False, make_thread_default=False, default_enabled=True
        )
    )
    drawn.set_time("blueprint", sequence=0)
    layout.to_blueprint()._log_to_stream(drawn)
    # active at once: a viewer that reads a recording while it is written would otherwise keep a layout of its own
    bindings.send_blueprint(drawn.memory_recording().storage, True, True, recording=stream.to_native())
    drawn.disconnect()
    return stream


def drop_ended_streams() -> None:
    """End the threads and free the memory of disconnected streams to which no reference is left. Waits for streams
    that are still being written."""
    gc.collect()
    bindings.flush_and_cleanup_orphaned_recordings()
