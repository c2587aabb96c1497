"""Which files of a logs folder the dashboard hands out."""

from __future__ import annotations

from pathlib import Path

__all__ = ["served_file"]

SERVED = frozenset({".html", ".jpg", ".jpeg", ".png", ".webp", ".mp4", ".webm", ".rrd"})
"""Reports, pictures, films and recordings. Journals, settings and locks are not handed out."""


def served_file(logs: Path, path: str) -> Path | None:
    """Return the file at `path`, relative to the logs folder; None if it is not to be handed out.

    Symbolic links and `..` are followed first: what counts is where the file really lies.
    """
    try:
        root = logs.resolve(strict=True)
        found = (root / path).resolve(strict=True)
        inside = found.is_relative_to(root) and found.is_file()
    except (OSError, ValueError, RuntimeError):
        return None
    hidden = inside and any(part.startswith(".") for part in found.relative_to(root).parts)
    return found if inside and not hidden and found.suffix.lower() in SERVED else None
