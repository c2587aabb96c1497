"""Write the checkpoint of a run, and prepare an interrupted run for resuming.

`CheckpointWriter` writes the run's context after each effect, and the simulated world to a file beside it.
`interrupted_run` finds in the journal where a run was interrupted. The executive of the resumed run gets the
context but nothing of the simulated world: it opens the hands, parks the arms and takes a new picture.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.journal.checkpoint_file import CHECKPOINT
from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.journal.journal import Journal
from foldcell.cell.journal.run_checkpoint import read_checkpoint, write_checkpoint
from foldcell.cell.runs.reentry import reentered, reentry_event
from foldcell.cell.runs.request_file import load_request
from foldcell.cell.runs.resumable import check_resumable, last_begun
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import ConfigurationError, StorageError

WORLD = "world.npz"


@dataclass(frozen=True, eq=False)
class Interrupted:
    """A run to resume. context: the saved context, which also holds the event to resume with; world: the saved
    simulated world, None on hardware."""

    run: str
    request: FoldRequest
    context: RunContext
    world: bytes | None


class CheckpointWriter:
    """Writes the checkpoint of a run. world: returns the state of the simulated world; None on hardware. frames:
    the run's frame store, if others write to it too."""

    def __init__(self, folder: Path, world: Callable[[], bytes] | None, frames: FrameStore | None = None) -> None:
        self._folder, self._world = folder, world
        self._frames = frames or FrameStore(folder / FRAMES)

    def keep(self, context: RunContext) -> None:
        """Write the checkpoint. It is on disk when the call returns. Raises StorageError."""
        if self._world is not None:
            write_whole(self._folder / WORLD, self._world())
        write_checkpoint(self._folder / CHECKPOINT, context, self._frames)

    def forget(self) -> None:
        """Remove the checkpoint of a run that cannot be resumed any more. Files that cannot be removed stay."""
        with suppress(OSError):
            (self._folder / WORLD).unlink(missing_ok=True)
        shutil.rmtree(self._folder / CHECKPOINT, ignore_errors=True)


def interrupted_run(journal: Journal, name: str, logs: Path, **changes: Any) -> Interrupted:
    """Read the run to resume. name: id of the run, or `last` for the newest run that began an effect; changes:
    values that replace those of its request.

    Raises ConfigurationError for a run that cannot be resumed, StorageError if its files are damaged.
    """
    record = journal.run(last_begun(journal) if name == "last" else name)
    check_resumable(journal, record.id)
    request = load_request(record.directory, logs, **changes)
    kept = request.settings.fingerprint(), request.seed, request.driver
    if kept != (record.settings_hash, record.seed, record.driver):
        raise ConfigurationError(
            f"settings or request of the run {record.id} do not match the journal",
            f"restore {record.directory / 'cell.yaml'}, or start a new run",
        )
    context = read_checkpoint(record.directory / CHECKPOINT, FrameStore(record.directory / FRAMES))
    if context.through:
        raise ConfigurationError(
            f"the run {record.id} has finished its plan, with folds skipped",
            "lay the garment flat and start a new one",
        )
    states = [State(entry.state) for entry in journal.entries(record.id)]
    event = reentry_event(states, context)
    world = _read_world(record.directory / WORLD) if is_simulated(record.driver) else None
    return Interrupted(record.id, request, reentered(states, context, event), world)


def _read_world(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise StorageError(
            f"the simulated world {path} cannot be read: {e.strerror}", "start a new run", path=str(path)
        ) from None
