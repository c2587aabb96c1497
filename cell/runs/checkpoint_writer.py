"""Going on with a run that was interrupted: what it believed, its simulated world, and where it is entered again.

After each effect the run's context is written to a checkpoint, with the simulated world beside it
(`CheckpointWriter`). The journal says which effect was under way (`interrupted_run`). The executive that resumes
gets the context and nothing of the world: it opens the hands, parks the arms, and looks again.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.hardware.driver import is_simulated
from cell.recording.checkpoint.run_checkpoint import CHECKPOINT, read_checkpoint, write_checkpoint
from cell.recording.frame_store import FRAMES, FrameStore
from cell.recording.journal import Journal
from cell.runs.reentry import reentered, reentry_event
from cell.runs.request_file import load_request
from cell.runs.resumable import check_resumable, last_begun
from cell.states.fold_request import FoldRequest
from cell.states.run_context import RunContext
from cell.states.transition_table import State
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError, StorageError

__all__ = ["CheckpointWriter", "Interrupted", "interrupted_run"]

WORLD = "world.npz"


@dataclass(frozen=True, eq=False)
class Interrupted:
    """A run to be gone on with. context: what it believed, and where it is entered again; world: the simulated one
    as it stood, else None."""

    run: str
    request: FoldRequest
    context: RunContext
    world: bytes | None


class CheckpointWriter:
    """Puts down what a run is gone on with from. world: gives the simulated one as it stands, None on hardware."""

    def __init__(self, folder: Path, world: Callable[[], bytes] | None) -> None:
        self._folder, self._world = folder, world
        self._frames = FrameStore(folder / FRAMES)

    def keep(self, context: RunContext) -> None:
        """On disk when the call returns. Raises StorageError."""
        if self._world is not None:
            write_whole(self._folder / WORLD, self._world())
        write_checkpoint(self._folder / CHECKPOINT, context, self._frames)

    def forget(self) -> None:
        """There is nothing to go on with any more. What cannot be removed stays."""
        with suppress(OSError):
            (self._folder / WORLD).unlink(missing_ok=True)
        shutil.rmtree(self._folder / CHECKPOINT, ignore_errors=True)


def interrupted_run(journal: Journal, name: str, logs: Path, **changes: Any) -> Interrupted:
    """The run `name` as it can be gone on with (`last`: one that was refused before it did anything does not
    count); changes: of its request. Raises ConfigurationError for a run that
    cannot be, StorageError for one whose files are damaged."""
    record = journal.run(last_begun(journal) if name == "last" else name)
    check_resumable(journal, record.id)
    request = load_request(record.directory, logs, **changes)
    asked = request.settings.fingerprint(), request.seed, request.driver
    if asked != (record.settings_hash, record.seed, record.driver):
        raise ConfigurationError(
            f"settings or request of the run {record.id} are not those that the journal knows",
            f"put {record.directory / 'cell.yaml'} back as it was, or start a new run",
        )
    context = read_checkpoint(record.directory / CHECKPOINT, FrameStore(record.directory / FRAMES))
    if context.through:
        raise ConfigurationError(
            f"the run {record.id} is through its plan, and left folds out",
            "lay the garment flat and start a new one",
        )
    event = reentry_event([State(entry.state) for entry in journal.entries(record.id)], context)
    world = _world(record.directory / WORLD) if is_simulated(record.driver) else None
    return Interrupted(record.id, request, reentered(context, event), world)


def _world(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise StorageError(
            f"the simulated world {path} cannot be read: {e.strerror}", "start a new run", path=str(path)
        ) from None
