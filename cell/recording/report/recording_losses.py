"""What a run's recording and transcript lack, in words for the terminal and the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["recording_losses"]


def recording_losses(recording: Mapping[str, Any]) -> tuple[str, ...]:
    """recording: as in a run's result. Empty where all was kept; what a live viewer missed is in the file."""
    lines = [str(error) for error in recording.get("errors") or ()]
    dropped = recording.get("dropped") or 0
    if dropped:
        lines.append(f"{dropped} entries of the recording: they came faster than they could be written")
    return tuple(lines)
