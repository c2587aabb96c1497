"""The place of a checkpoint in a run's folder."""

from __future__ import annotations

from pathlib import Path

CHECKPOINT, CONTEXT = "checkpoint", "context"
"""Names of the checkpoint's folder in a run's folder, and of the file with the context in that folder."""


def has_checkpoint(run: Path) -> bool:
    """Whether the run with this folder has a checkpoint."""
    return (run / CHECKPOINT / CONTEXT).is_file()
