"""The journal: acknowledged entries survive any death of the writer."""

import dataclasses
import json
import math
import os
import signal
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.journal import journal as journal_module
from foldcell.cell.journal.journal import Journal, RunJournal, performed
from foldcell.cell.support.json_values import to_json
from foldcell.robots.errors import ConfigurationError, FailureKind, InternalError, StorageError
from foldcell.robots.ports import Side

WRITER = """
import sys
from pathlib import Path
from foldcell.cell.journal.journal import Journal
run = Journal.open(Path(sys.argv[1])).begin_run(garment="medium_towel", seed=7, driver="sim")
print(run.id, flush=True)
for i in range(100_000):
    intent = run.intent(0.1 * i, "folding", "fold", {"number": i})
    print("intent", intent, flush=True)
    result = run.result(intent, 0.1 * i + 0.05, {"ok": True})
    print("result", result, flush=True)
"""


def begin(logs: Path, **over: Any) -> tuple[Journal, RunJournal]:
    journal = Journal.open(logs / "journal.db")
    return journal, journal.begin_run(**{"garment": "medium_towel", "seed": 1, "driver": "sim", **over})


def test_a_run_reads_back_as_written(tmp_path: Path) -> None:
    journal, run = begin(tmp_path, settings_hash="abc", versions={"numpy": "2.4.6"})
    run.event(0.0, "preparing", "start", {"from": "idle"})
    intent = run.intent(0.5, "looking", "look")
    run.result(intent, 0.8, {"confidence": 0.9})
    run.event(0.9, "looking", "paused")
    run.end("folded", {"robot_time_s": 61.5})
    record = journal.run(run.id)
    assert (record.garment, record.seed, record.driver, record.status) == ("medium_towel", 1, "sim", "folded")
    assert record.versions == {"numpy": "2.4.6"} and record.settings_hash == "abc" and record.pid == os.getpid()
    assert record.summary["robot_time_s"] == 61.5
    assert record.ended is not None and record.ended >= record.started
    entries = journal.entries(run.id)
    assert [e.sequence for e in entries] == [1, 2, 3, 4]
    assert [e.kind for e in entries] == ["event", "intent", "result", "event"]
    assert entries[2].answers == entries[1].sequence
    assert (entries[2].state, entries[2].name) == ("looking", "look")
    assert [e.cell_time for e in entries] == [0.0, 0.5, 0.8, 0.9]
    assert all("schema" in e.payload for e in entries)
    assert record.directory == tmp_path / run.id and record.directory.is_dir()


def test_a_traceless_reading_leaves_no_file_and_sees_what_others_write(tmp_path: Path) -> None:
    journal, run = begin(tmp_path)
    run.event(1.0, "idle", "while it is written")
    with Journal.open(journal.path, readonly=True, traceless=True) as reader:
        assert [e.name for e in reader.entries(run.id)] == ["while it is written"]
    run.end("folded")
    journal.close()
    before = sorted(p.name for p in tmp_path.iterdir())
    assert "journal.db-wal" not in before
    with Journal.open(journal.path, readonly=True, traceless=True) as reader:
        assert reader.run("last").status == "folded"
        assert sorted(p.name for p in tmp_path.iterdir()) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_a_run_is_running_until_it_ends(tmp_path: Path) -> None:
    journal, run = begin(tmp_path)
    assert journal.run("last").status == "running"
    run.end("not_folded")
    assert journal.run("last").status == "not_folded"
    assert list(run.directory.iterdir()) == []  # the run's end removes the lock file


@pytest.mark.parametrize("lines", [1, 2, 5, 40])
def test_kill_9_loses_no_acknowledged_entry(tmp_path: Path, lines: int) -> None:
    journal_file = tmp_path / "journal.db"
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(journal_file)], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    run_id = writer.stdout.readline().strip()
    acknowledged = [writer.stdout.readline().split() for _ in range(lines)]
    with Journal.open(journal_file) as journal:
        assert journal.run(run_id).status == "running"
    writer.send_signal(signal.SIGKILL)
    acknowledged += [line.split() for line in writer.stdout if line.endswith("\n")]
    writer.wait()

    with Journal.open(journal_file) as journal:
        assert journal.check() == "ok"
        record = journal.run(run_id)
        assert record.status == "interrupted" and record.ended is None
        entries = journal.entries(run_id)
        kinds = {e.sequence: e.kind for e in entries}
        for kind, sequence in acknowledged:
            assert kinds[int(sequence)] == kind
        assert len(entries) - len(acknowledged) in (0, 1)  # at most one entry was written but not yet acknowledged
        last = performed(entries)[-1]
        assert last.begun.payload["number"] == last.begun.sequence // 2
        assert (last.result is None) == (entries[-1].kind == "intent")


def test_a_run_without_its_end_is_interrupted_even_if_its_pid_is_reused(tmp_path: Path) -> None:
    """Another process may get a dead owner's pid, so the lock decides and not the pid."""
    journal, run = begin(tmp_path)
    run.abandon()
    assert journal.run(run.id).pid == os.getpid()
    assert journal.run(run.id).status == "interrupted"


def test_an_effect_that_did_not_end_has_no_result(tmp_path: Path) -> None:
    journal, run = begin(tmp_path)
    assert performed(journal.entries(run.id)) == []
    first = run.intent(0.0, "looking", "look")
    run.result(first, 0.1)
    run.intent(0.2, "grasping", "grasp", {"step": 1})
    run.event(0.3, "grasping", "noted")
    before, last = performed(journal.entries(run.id))
    assert before.name == "look" and before.ended_s == 0.1
    assert last.begun.name == "grasp" and last.begun.payload["step"] == 1
    assert last.result is None


def test_a_result_needs_an_open_intent(tmp_path: Path) -> None:
    _, run = begin(tmp_path)
    with pytest.raises(InternalError, match="no open intent"):
        run.result(1, 0.0)
    intent = run.intent(0.0, "looking", "look")
    run.result(intent, 0.1)
    with pytest.raises(InternalError, match="no open intent"):
        run.result(intent, 0.2)


def test_an_ended_run_accepts_no_more_entries(tmp_path: Path) -> None:
    journal, run = begin(tmp_path)
    run.end("folded")
    with pytest.raises(InternalError, match="too late"):
        run.event(1.0, "looking", "late")
    with pytest.raises(InternalError, match="twice"):
        run.end("fault")
    assert journal.run("last").result == "folded"


def test_entries_from_several_threads_have_no_gaps(tmp_path: Path) -> None:
    journal, run = begin(tmp_path)
    threads = [
        threading.Thread(target=lambda k=k: [run.event(0.0, "s", f"{k}-{i}") for i in range(20)]) for k in range(4)
    ]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    entries = journal.entries(run.id)
    assert [e.sequence for e in entries] == list(range(1, 81))
    for k in range(4):  # each thread's entries keep their order
        assert [e.name for e in entries if e.name.startswith(f"{k}-")] == [f"{k}-{i}" for i in range(20)]


def test_several_processes_share_a_new_journal(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from foldcell.cell.journal.journal import Journal\n"
        "run = Journal.open(Path(sys.argv[1])).begin_run(garment='g', seed=None, driver='sim')\n"
        "run.event(0.0, 's', 'e'); run.end('folded')"
    )
    path = tmp_path / "journal.db"
    writers = [subprocess.Popen([sys.executable, "-c", script, str(path)]) for _ in range(4)]
    assert [w.wait(30) for w in writers] == [0] * 4
    with Journal.open(path) as journal:
        runs = journal.runs()
    assert len({r.id for r in runs}) == 4 and all(r.status == "folded" for r in runs)


def test_runs_of_the_same_second_get_separate_folders(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.db")
    runs = [
        journal.begin_run(garment="../../evil name", seed=3, driver="sim", wall_clock=lambda: 1e9)
        for _ in range(3)
    ]
    assert [r.id for r in runs] == [
        "20010909T014640Z-evil_name-seed3",
        "20010909T014640Z-evil_name-seed3-2",
        "20010909T014640Z-evil_name-seed3-3",
    ]
    assert all(r.directory.parent == tmp_path for r in runs)


def test_runs_are_found_by_id_prefix_folder_or_last(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.db")
    with pytest.raises(ConfigurationError, match="no runs yet"):
        journal.run("last")
    a = journal.begin_run(garment="towel", seed=1, driver="sim", wall_clock=lambda: 1e9)
    b = journal.begin_run(garment="shirt", seed=1, driver="sim", wall_clock=lambda: 1.1e9)
    assert journal.run(a.id).id == journal.run(str(a.directory)).id == journal.run("20010909").id == a.id
    assert journal.run("last").id == b.id
    with pytest.raises(ConfigurationError, match="beginning of 2 runs"):
        journal.run("20")
    with pytest.raises(ConfigurationError, match=f"the last one is {b.id}"):
        journal.run("nothing")


# other files, and folders that cannot be written


def test_a_newer_journal_is_refused_and_left_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    Journal.open(path).close()
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version=99")
    connection.close()
    before = path.read_bytes()
    for readonly in (False, True):
        with pytest.raises(StorageError, match=r"newer foldcell.*schema 99"):
            Journal.open(path, readonly)
    assert path.read_bytes() == before


def test_another_programs_file_is_refused_and_left_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE bookmarks (url)")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(StorageError, match="another program"):
        Journal.open(path)
    assert path.read_bytes() == before and sorted(p.name for p in tmp_path.iterdir()) == ["journal.db"]


def test_a_file_that_is_no_database_is_refused_and_left_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    path.write_bytes(b"not a database at all " * 100)
    with pytest.raises(StorageError, match="move it aside"):
        Journal.open(path)
    assert path.read_bytes() == b"not a database at all " * 100


def test_a_missing_folder_is_refused_without_making_a_journal(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="--logs DIR"):
        Journal.open(tmp_path / "none" / "journal.db")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_a_storage_error_and_earlier_entries_are_kept(tmp_path: Path) -> None:
    journal, run = begin(tmp_path)
    run.event(0.0, "looking", "first")
    pages = journal._connection.execute("PRAGMA page_count").fetchone()[0]
    journal._connection.execute(f"PRAGMA max_page_count={pages}")  # SQLite then reports SQLITE_FULL
    with pytest.raises(StorageError, match="disk is full"):
        for i in range(1000):
            run.event(1.0, "looking", "more", {"text": "x" * 1000, "number": i})
    written = journal.entries(run.id)
    assert written[0].name == "first"
    assert [e.sequence for e in written] == list(range(1, len(written) + 1))
    journal._connection.execute("PRAGMA max_page_count=1000000")
    assert run.event(2.0, "looking", "after") == len(written) + 1  # the sequence has no gap


def test_a_run_without_a_journal_entry_leaves_no_folder(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.db")
    journal._connection.execute("PRAGMA query_only=ON")
    with pytest.raises(StorageError, match="read-only"):
        journal.begin_run(garment="g", seed=1, driver="sim")
    assert [p.name for p in tmp_path.iterdir() if p.is_dir()] == []


def test_reading_needs_no_write_permission(lockable: Any) -> None:
    journal, run = begin(lockable.folder)
    run.end("folded")
    journal.close()
    before = sorted(p.name for p in lockable.folder.iterdir())
    with lockable.read_only(), Journal.open(lockable.folder / "journal.db", readonly=True) as reader:
        assert reader.run("last").status == "folded"
        with pytest.raises(StorageError):
            reader.begin_run(garment="g", seed=1, driver="sim")
    assert sorted(p.name for p in lockable.folder.iterdir()) == before


def test_a_journal_in_a_read_only_folder_is_not_opened_for_writing(lockable: Any) -> None:
    with lockable.read_only(), pytest.raises(StorageError, match="--logs DIR"):
        Journal.open(lockable.folder / "journal.db")
    assert list(lockable.folder.iterdir()) == []
    Journal.open(lockable.folder / "journal.db").close()
    with lockable.read_only(), pytest.raises(StorageError, match="--logs DIR"):
        Journal.open(lockable.folder / "journal.db")


def test_a_journal_can_be_read_while_a_run_writes_to_it(tmp_path: Path) -> None:
    _, run = begin(tmp_path)
    run.event(0.0, "looking", "first")
    with Journal.open(tmp_path / "journal.db", readonly=True) as reader:
        assert reader.run("last").status == "running"
        run.event(0.1, "looking", "second")
        assert [e.name for e in reader.entries(run.id)] == ["first", "second"]


def test_reading_a_missing_journal_is_a_storage_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no journal"):
        Journal.open(tmp_path / "journal.db", readonly=True)
    assert list(tmp_path.iterdir()) == []


def test_every_commit_is_synchronous(tmp_path: Path) -> None:
    """With FULL, each commit reaches the disk. Otherwise a power cut would lose acknowledged entries."""
    with Journal.open(tmp_path / "journal.db") as journal:
        assert journal._connection.execute("PRAGMA synchronous").fetchone()[0] == 2
        assert journal._connection.execute("PRAGMA journal_mode").fetchone()[0] == "wal"


# payloads


@dataclasses.dataclass(frozen=True)
class Value:
    side: Side
    points: np.ndarray
    where: Path


def test_values_of_the_cell_are_converted_to_json() -> None:
    value = {
        Side.LEFT: Value(Side.RIGHT, np.array([[1.0, np.nan]]), Path("a/b")),
        "kind": FailureKind.DRIFT,
        "numbers": (np.float32(0.5), np.int64(3), np.bool_(True), math.inf),
        "set": {2, 1},
        "odd": object(),
    }
    assert to_json(value) == {
        "left": {"side": "right", "points": [[1.0, None]], "where": "a/b"},
        "kind": "drift",
        "numbers": [0.5, 3, True, None],
        "set": [1, 2],
        "odd": "<object>",
    }


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from(FailureKind),
        lambda v: st.lists(v) | st.dictionaries(st.text(), v) | st.tuples(v, v),
        max_leaves=20,
    )
)
def test_any_payload_is_written_as_standard_json(payload: object) -> None:
    text = journal_module._dumps({"payload": payload})

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    read = json.loads(text, parse_constant=refuse)["payload"]
    assert to_json(read) == to_json(payload)
