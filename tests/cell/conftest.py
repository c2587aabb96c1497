"""One recorded run of the simulated cell, shared by all tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from foldcell.cell.journal.journal import Entry, Journal, JournalRun
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.transition_table import Effect, Event
from tests.runs import Onlooker, fold_request

SETTINGS = {"optimiser": {"simulations": 2, "use_library": False}, "recorder": {"key_frames": 3}}
"""Only a few simulations, on two threads, and three pictures of each fold. Other tests check that the search
finds the optimum."""
SEED = 7416
"""A thick fabric: where the hands grasp 10 mm inside the edge, the closing pads push it into a pleat, and the run
fails."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A finished run with its result, its journal and its folder."""

    request: FoldRequest
    result: RunRecord
    onlooker: Onlooker
    record: JournalRun
    entries: tuple[Entry, ...]

    @property
    def folder(self) -> Path:
        return self.record.directory


def see(folder: Path, onlooker: Onlooker, **options: bool) -> Seen:
    request = fold_request(folder, SETTINGS, garment="small_towel", seed=SEED, **options)
    result = onlooker.fold(request)
    with Journal.open(request.logs / "journal.db", readonly=True) as journal:
        record = journal.run("last")
        return Seen(request, result, onlooker, record, tuple(journal.entries(record.id)))


@pytest.fixture(scope="session")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Seen]:
    """A small towel folded twice, with recording, report and scorer."""
    yield see(tmp_path_factory.mktemp("seen"), Onlooker(), record=True, record_truth=True)


@pytest.fixture(scope="session")
def unseen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """The same run with the same seed, without recording, scorer and ground truth. The second fold is not made."""
    ending = {Effect.APPROACH: lambda ports, commands, n: n == 2 and commands.put(Event.ABORT)}
    return see(tmp_path_factory.mktemp("unseen"), Onlooker(before=ending), record=False, record_truth=False)
