"""Stores the entries of unfinished library builds beside the library, so that a build can continue."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from foldcell.cell.config.trajectory_library.library_file import alone_with, write_text
from foldcell.robots.errors import StorageError
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT
from foldcell.skills.trajectory.trajectory_library import Library, LibraryEntry, from_json, to_json


class UnfinishedBuild:
    """The entries built so far for some garments. The file may also hold entries of builds for other garments;
    these stay.

    lift_height: height of the straight lift before each arc [m]. Damaged entries are treated as not built, and so
    are the entries of a garment whose plan or lift height has changed.
    """

    def __init__(self, library: Path, garments: Iterable[Garment], lift_height: float = LIFT_HEIGHT) -> None:
        self.path = library.with_name(library.name + ".part")
        self._plans = {garment.name: _digest(garment, lift_height) for garment in garments}
        there, plans = _load(self.path)
        same = {name for name, plan in self._plans.items() if plans.get(name) == plan}
        self.library = Library(tuple(e for e in there.entries if e.garment in same))

    def keep(self, entry: LibraryEntry) -> None:
        """Save an entry. Raises StorageError."""
        self.library = self.library.with_entry(entry)
        self._write(self.library.entries)

    def end(self) -> None:
        """Remove the entries of these garments. Call it after the library itself is written."""
        self.library = Library()
        with suppress(StorageError):  # if they remain, a later build reuses them, with the same result
            self._write(())

    def _write(self, own: tuple[LibraryEntry, ...]) -> None:
        with alone_with(self.path):
            there, plans = _load(self.path)
            entries = (*own, *(e for e in there.entries if e.garment not in self._plans))
            if not entries:
                with suppress(OSError):
                    self.path.unlink(missing_ok=True)
                return
            data = json.loads(to_json(Library(entries)))
            write_text(self.path, json.dumps({**data, "plans": {**plans, **self._plans}}, indent=1) + "\n")


def _load(path: Path) -> tuple[Library, dict[str, str]]:
    """Return the valid entries, and for each garment's name the digest of its plan."""
    try:
        text = path.read_text(encoding="utf-8")
        plans = json.loads(text)["plans"]
        return from_json(text)[0], {str(name): str(plan) for name, plan in plans.items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return Library(), {}


def _digest(garment: Garment, lift_height: float) -> str:
    """Return a digest of everything that determines a garment's fold plan and its start pose."""
    plan = (garment.plan, garment.layers, garment.keypoints, garment.template.tolist(), garment.poses, lift_height)
    return hashlib.sha256(repr(plan).encode()).hexdigest()
