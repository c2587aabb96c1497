"""Saves the figures of a benchmark as soon as they are measured, so that it can be interrupted and continued.

Saved figures are valid as long as the sources that they depend on are unchanged.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from foldcell.cell.support.files.whole_file import write_whole

ROOT = Path(__file__).resolve().parents[1]


def fingerprint(folders: Sequence[str], *files: Path, **how: Any) -> str:
    """Compute a hash of the sources in folders of the repository, of files, and of the measurement's options."""
    sources = [path for folder in folders for path in sorted((ROOT / folder).rglob("*"))]
    digest = hashlib.sha256(json.dumps(how, sort_keys=True).encode())
    for path in [*(path for path in sources if path.suffix in (".py", ".yaml")), *files]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class Kept:
    """A file of saved figures, by (fingerprint, part). A damaged file is ignored and overwritten."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._all: dict[str, Any] = {}
        if path is not None:
            try:
                self._all = dict(json.loads(path.read_text(encoding="utf-8")))
            except (OSError, ValueError, TypeError):
                self._all = {}

    def get(self, key: str, part: str) -> Any:
        """Return the saved figures, or None."""
        return self._all.get(f"{key}/{part}")

    def put(self, key: str, part: str, value: Mapping[str, Any] | list[Any]) -> None:
        """Save figures. Raises StorageError if the file cannot be written."""
        self._all[f"{key}/{part}"] = value
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._path, json.dumps(self._all, indent=1) + "\n")
