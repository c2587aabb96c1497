"""Losses of a run's recording and transcript, as text for the terminal and the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["recording_losses"]


def recording_losses(recording: Mapping[str, Any]) -> tuple[str, ...]:
    """Return messages about lost entries; empty if nothing was lost. recording: `FoldResult.recording` of the run.

    Entries that only a live viewer missed are in the file and do not count as lost.
    """
    lines = [str(error) for error in recording.get("errors") or ()]
    dropped = recording.get("dropped") or 0
    if dropped:
        lines.append(f"{dropped} entries of the recording, which arrived faster than they could be written")
    return tuple(lines)
