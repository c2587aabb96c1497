"""Going on with a run that was interrupted: what it believed, its simulated world, and where it is entered again.

While a run goes its belief is put down after each effect, and the simulated world beside it (`Keeper`). What was
under way is read from the ledger (`interrupted_run`). The executive that goes on gets its belief and nothing of
the world: it lets go, parks, and has to look again.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cell.hardware.driver import is_simulated
from cell.recording.checkpoint.run_checkpoint import BELIEF, read_belief, write_belief
from cell.recording.frame_store import FRAMES, FrameStore
from cell.recording.journal import Journal
from cell.runs.request_file import load_request
from cell.runs.resumable import check_resumable, last_begun
from cell.states.fold_request import FoldRequest
from cell.states.run_context import RunContext
from cell.states.transition_table import REENTRIES, Event, State
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError, StorageError

__all__ = ["Interrupted", "Keeper", "interrupted_run", "reentry"]

WORLD = "world.npz"


@dataclass(frozen=True, eq=False)
class Interrupted:
    """A run to be gone on with. context: what it believed, and where it is entered again; world: the simulated one
    as it stood, else None."""

    run: str
    request: FoldRequest
    context: RunContext
    world: bytes | None


class Keeper:
    """Puts down what a run is gone on with from. world: gives the simulated one as it stands, None on hardware."""

    def __init__(self, folder: Path, world: Callable[[], bytes] | None) -> None:
        self._folder, self._world = folder, world
        self._frames = FrameStore(folder / FRAMES)

    def keep(self, context: RunContext) -> None:
        """On disk when the call returns. Raises StorageError."""
        if self._world is not None:
            write_whole(self._folder / WORLD, self._world())
        write_belief(self._folder / BELIEF, context, self._frames)

    def forget(self) -> None:
        """There is nothing to go on with any more. What cannot be removed stays."""
        with suppress(OSError):
            (self._folder / WORLD).unlink(missing_ok=True)
        shutil.rmtree(self._folder / BELIEF, ignore_errors=True)


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
            f"settings or request of the run {record.id} are not those that the ledger knows",
            f"put {record.directory / 'cell.yaml'} back as it was, or start a new run",
        )
    context = read_belief(record.directory / BELIEF, FrameStore(record.directory / FRAMES))
    if context.through:
        raise ConfigurationError(
            f"the run {record.id} is through its plan, and left folds out",
            "lay the garment flat and start a new one",
        )
    event = reentry([State(entry.state) for entry in journal.entries(record.id)], context)
    fresh = RunContext() if event is Event.START_OVER else context
    world = _world(record.directory / WORLD) if is_simulated(record.driver) else None
    return Interrupted(record.id, request, _entered(fresh, event), world)


def reentry(states: Sequence[State], context: RunContext) -> Event:
    """Where a run that passed through `states` and believes `context` is entered again."""
    known = [REENTRIES[state] for state in states if state in REENTRIES]
    event = known[-1] if known else context.reentry or Event.START_OVER  # itself gone on with, but no further
    if event is Event.LOOK_AFTER and context.fold.attempt is None:  # judged already, the next fold not begun
        return Event.LOOK_AGAIN
    return event


def _entered(context: RunContext, event: Event) -> RunContext:
    """The belief of who goes on: nothing is held, waited for or failed any more."""
    fold = replace(context.fold, held={}, zeros={})
    if fold.attempt:  # carried also where the release was begun, and not ended
        fold = replace(fold, attempt=replace(fold.attempt, carried=event is Event.LOOK_AFTER))
    return replace(context, reentry=event, fold=fold, failure=None, waited_s=0.0)


def _world(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise StorageError(
            f"the simulated world {path} cannot be read: {e.strerror}", "start a new run", path=str(path)
        ) from None
