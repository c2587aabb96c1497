"""Runs that are killed after a durable write: what is reported, what counts as lost, and what the page counts."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.kill_points import boundaries, met, page
from benchmarks.kills.durable_writes import DurableWrite, read_writes
from benchmarks.kills.outcome import Outcome, Resumed, lost, place_of, resume_event
from foldcell.cell.journal.journal import Entry, Journal, JournalRun

PASSED = Resumed(0, {"result": "folded", "score": {"passed": True}}, "look_again")

DIES = """
import os, sys
from pathlib import Path
from benchmarks.kills import durable_writes
from foldcell.cell.commands import main as command
from foldcell.cell.journal.journal import Journal
from foldcell.cell.runs.checkpoint_writer import CheckpointWriter
from foldcell.cell.states.run_context import RunContext

def run(line):
    with Journal.open(Path(line[0]) / "journal.db") as journal:
        run = journal.begin_run(garment="small_towel", seed=1, driver="sim")
        run.event(0.0, "preparing", "start", {"from": "idle"})
        intent = run.intent(0.5, state="preparing", effect="prepare")
        CheckpointWriter(run.directory, lambda: b"the world").keep(RunContext())
        run.result(intent, 1.0, payload={"event": "done"})
        run.end("folded", {"score": {"passed": True}})
        return 0

command.main = run
for last in sys.argv[2:]:
    folder = Path(sys.argv[1], last)
    folder.mkdir()
    child = os.fork()
    if child == 0:
        os._exit(durable_writes.main([str(folder / "writes"), last, str(folder)]))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
"""Performs a short run in place of a fold, seven durable writes, for each of the given last writes, each time in
another process with a folder of its own. Python starts once. Prints the exit codes."""
WHATS = ["run", "entry", "entry", "world", "context", "entry", "end"]
LASTS = (0, 2, 4, 6, 7)
KilledRun = tuple[int, list[DurableWrite], JournalRun, list[Entry]]


@pytest.fixture(scope="module")
def killed_runs(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, KilledRun]:
    """The short run, killed after each durable write of LASTS: exit code, reports and journal."""
    folder = tmp_path_factory.mktemp("killed")
    line = [sys.executable, "-c", DIES, str(folder), *map(str, LASTS)]
    codes = subprocess.run(line, timeout=120, check=True, capture_output=True, text=True).stdout.split()
    return {last: (int(code), *_left(folder / str(last))) for last, code in zip(LASTS, codes, strict=True)}


def _left(folder: Path) -> tuple[list[DurableWrite], JournalRun, list[Entry]]:
    with Journal.open(folder / "journal.db", readonly=True) as journal:
        run = journal.run("last")
        return read_writes(folder / "writes"), run, journal.entries(run.id)


@pytest.mark.parametrize("last", [2, 4, 6, 7])
def test_a_run_dies_right_after_the_chosen_write_and_nothing_acknowledged_is_lost(
    killed_runs: Mapping[int, KilledRun], last: int
) -> None:
    code, writes, run, entries = killed_runs[last]
    assert code == -signal.SIGKILL
    assert [w.what for w in writes] == WHATS[:last]
    assert len(entries) == WHATS[:last].count("entry")
    assert (run.directory / "world.npz").exists() == ("world" in WHATS[:last])
    assert (run.directory / "checkpoint" / "context").exists() == ("context" in WHATS[:last])
    assert lost(writes, run, entries) == []


def test_a_run_that_is_not_killed_reports_all_its_writes(killed_runs: Mapping[int, KilledRun]) -> None:
    code, writes, run, entries = killed_runs[0]
    assert (code, [w.what for w in writes], run.status) == (0, WHATS, "folded")
    assert [w.place[1:] for w in writes if w.what == "entry"] == [
        (1, "event", "preparing", "start"), (2, "intent", "preparing", "prepare"),
        (3, "result", "preparing", "prepare"),
    ]  # fmt: skip
    assert lost(writes, run, entries) == []


def entry(sequence: int, kind: str, state: str, name: str, answers: int | None = None, **payload: Any) -> Entry:
    return Entry(sequence, 0.0, 0.0, state, kind, name, answers, {"schema": 1, **payload})


def write(of: Entry) -> DurableWrite:
    payload = {key: value for key, value in of.payload.items() if key != "schema"}
    return DurableWrite("entry", of.sequence, of.kind, of.state, of.name, payload)


RUN = JournalRun("r", "small_towel", 5, "sim", {}, "", 1, 0.0, None, None, {}, "interrupted", Path("r"))
ENTRIES = [
    entry(1, "event", "preparing", "start", **{"from": "idle"}),
    entry(2, "intent", "preparing", "prepare", step=0),
    entry(3, "result", "preparing", "prepare", 2, event="done"),
    entry(4, "event", "photographing", "done"),
]
WRITES = [DurableWrite("run"), *map(write, ENTRIES[:2]), DurableWrite("world"), DurableWrite("context"),
          *map(write, ENTRIES[2:])]  # fmt: skip


def test_entries_that_were_not_acknowledged_may_be_in_the_journal() -> None:
    assert lost(WRITES[:-1], RUN, ENTRIES) == []


@pytest.mark.parametrize(
    ("run", "entries", "why"),
    [
        (RUN, ENTRIES[:3], "entry 4 (event done) is missing"),
        (RUN, [*ENTRIES[:3], replace(ENTRIES[3], state="folding")], "entry 4 (event done) differs"),
        (
            RUN,
            [ENTRIES[0], replace(ENTRIES[1], payload={"step": 1}), *ENTRIES[2:]],
            "entry 2 (intent prepare) differs",
        ),
        (RUN, [*ENTRIES, replace(ENTRIES[3], sequence=6)], "gaps"),
        (
            RUN,
            [*ENTRIES, entry(5, "intent", "folding", "fold"), entry(6, "intent", "folding", "fold")],
            "one effect",
        ),
        (replace(RUN, status="running"), ENTRIES, "listed as running"),
    ],
)
def test_what_the_journal_lacks_is_named(run: JournalRun, entries: list[Entry], why: str) -> None:
    (reason,) = lost(WRITES, run, entries)
    assert why in reason


def test_a_lost_result_of_the_run_is_named() -> None:
    assert lost([*WRITES, DurableWrite("end")], RUN, ENTRIES) == ["the run's result is missing"]


def test_the_place_of_a_kill_is_described() -> None:
    places = [place_of(WRITES[: n + 1]) for n in range(len(WRITES))]
    assert places == [
        "the run's row", "event `start` to preparing", "intent `prepare`",
        "checkpoint's world after prepare (intent)", "checkpoint's context after prepare (intent)",
        "result `prepare`", "event `done` to photographing",
    ]  # fmt: skip
    assert place_of([WRITES[0], DurableWrite("context")]) == "checkpoint's context before the first effect"


def test_the_resume_event_leads_out_of_resuming() -> None:
    entries = [
        entry(1, "event", "idle", "resumed_from", run="r"),
        entry(2, "event", "resuming", "reenter", **{"from": "idle"}),
        entry(3, "event", "looking", "look_again", **{"from": "resuming"}),
    ]
    assert resume_event(entries) == "look_again"
    assert resume_event(entries[:2]) == "" == resume_event(entries[1:])


@pytest.mark.parametrize(
    ("run", "entries", "resumed", "end", "passed"),
    [
        (RUN, ENTRIES, PASSED, "folded, passed", True),
        (RUN, ENTRIES, Resumed(0, {"result": "folded", "score": {"passed": False}}), "folded, not passed", False),
        (RUN, ENTRIES, Resumed(2, {"result": "not_folded", "failure": {"what": "unseen"}}), "not folded, unseen",
         False),
        (RUN, ENTRIES, Resumed(64, {}, said="no checkpoint"), "exit code 64: no checkpoint", False),
        (RUN, [], Resumed(64, {}, said="no checkpoint"), "nothing begun", None),
        (replace(RUN, result="folded", summary={"score": {"passed": True}}), ENTRIES, Resumed(64, {}),
         "folded before the kill, passed", None),
    ],
)  # fmt: skip
def test_the_end_of_a_killed_run_is_judged(
    run: JournalRun, entries: list[Entry], resumed: Resumed, end: str, passed: bool | None
) -> None:
    found = Outcome.of(3, WRITES[:3], run, entries, [], resumed, 1.0)
    assert (found.end, found.passed) == (end, passed)


def test_every_kth_boundary_is_chosen_with_the_first_and_the_last() -> None:
    assert boundaries(10, 4) == [1, 5, 9, 10]
    assert boundaries(3, 1) == [1, 2, 3]


def outcomes(passed: int, failed: int) -> list[Outcome]:
    one = Outcome.of(3, WRITES[:3], RUN, ENTRIES, [], PASSED, 1.0)
    return [replace(one, number=n + 1, passed=n < passed) for n in range(passed + failed)]


def test_the_measure_needs_every_entry_and_95_percent_of_the_resumed_runs() -> None:
    assert met(outcomes(19, 1)) and not met(outcomes(18, 1))
    assert not met([])
    assert met([*outcomes(19, 1), replace(outcomes(1, 0)[0], passed=None)]), "nothing to resume counts neither way"
    assert not met([*outcomes(20, 0), replace(outcomes(1, 0)[0], lost=["entry 4 is missing"])])


def test_the_page_shows_each_boundary_and_the_shares() -> None:
    found = [*outcomes(3, 1), Outcome.of(8, [*WRITES, DurableWrite("end")], RUN, ENTRIES, [], PASSED, 1.0)]
    text = page(found, WRITES, "small_towel, seed 5", "the command")
    assert "- Nothing lost: 4 of 5 (37.6 to 96.4 %)" in text
    assert "- Resumed and passed: 4 of 5 (37.6 to 96.4 %)" in text
    assert "**NO**: the run's result is missing" in text
    assert text.count("| 1 | intent `prepare` | photographing | yes | look_again | folded, passed |") == 1
