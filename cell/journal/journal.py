"""The journal: every run and its actions, in one SQLite file that survives `kill -9` at any instant.

An effect (for example a picture, a motion, a grasp) is written as an intent before it begins and as a result after
it ends. Each entry is a separate transaction and is on disk when the call returns. A reader therefore never finds
the result of an effect that did not happen, and at most one effect of a run has no result.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from foldcell.cell.support.files.paths import new_folder
from foldcell.cell.support.json_values import to_json
from foldcell.cell.support.process.lock import OwnerLock, is_held
from foldcell.robots.errors import CellError, ConfigurationError, InternalError, StorageError

SCHEMA_VERSION = 1
PAYLOAD_SCHEMA = 1
APPLICATION_ID = 0x466F4C64  # "FoLd": marks the file as a journal of foldcell
OWNER_FILE = ".owner"
NOT_BEGUN = "not_begun"
"""Result of a run that did not begin, because its cell could not be opened."""
BUSY_S = 10.0

_TABLES = """
CREATE TABLE runs (
    id TEXT PRIMARY KEY,
    garment TEXT NOT NULL,
    seed INTEGER,
    driver TEXT NOT NULL,
    versions TEXT NOT NULL,          -- JSON: package -> version
    settings_hash TEXT NOT NULL,
    pid INTEGER NOT NULL,
    started REAL NOT NULL,           -- seconds since 1970, wall clock
    ended REAL,
    result TEXT,                     -- folded, not_folded, fault; done, not_done; not_begun
    summary TEXT                     -- JSON
);
CREATE TABLE events (
    run TEXT NOT NULL REFERENCES runs(id),
    sequence INTEGER NOT NULL,       -- from 1, without gaps
    cell_time REAL NOT NULL,         -- seconds of the cell's clock
    wall_time REAL NOT NULL,         -- seconds since 1970
    state TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('event', 'intent', 'result')),
    name TEXT NOT NULL,
    answers INTEGER,                 -- of a result: the sequence of its intent
    payload TEXT NOT NULL,           -- JSON with 'schema'
    PRIMARY KEY (run, sequence)
) WITHOUT ROWID;
CREATE UNIQUE INDEX one_result ON events (run, answers) WHERE answers IS NOT NULL;
"""


@dataclass(frozen=True)
class Entry:
    """One entry of a run. cell_time and wall_time [s]; kind: event, intent or result."""

    sequence: int
    cell_time: float
    wall_time: float
    state: str
    kind: str
    name: str
    answers: int | None
    payload: Mapping[str, Any]


@dataclass(frozen=True)
class Intent:
    """An effect.

    state: in which it was performed. fold: index of the fold. attempt: number of adjustments that recoveries had
    made to this fold. begun_s, ended_s: cell times [s]; ended_s is None if the run ended during the effect. event:
    with which it ended. failure, what: kind of the failure with which it ended, and this failure in words; None if
    it did not fail. begun, result: the entries written before it began and after it ended.
    """

    name: str
    state: str
    fold: int | None
    attempt: int | None
    begun_s: float
    ended_s: float | None
    event: str | None
    failure: str | None
    what: str | None
    begun: Entry
    result: Entry | None

    @classmethod
    def of(cls, begun: Entry, result: Entry | None) -> Self:
        outcome = result.payload if result else {}
        return cls(
            name=begun.name,
            state=begun.state,
            fold=begun.payload.get("step"),
            attempt=begun.payload.get("attempt"),
            begun_s=begun.cell_time,
            ended_s=result.cell_time if result else None,
            event=outcome.get("event"),
            failure=outcome.get("kind"),
            what=outcome.get("what"),
            begun=begun,
            result=result,
        )


@dataclass(frozen=True)
class JournalRun:
    """The journal's row of a run. summary: the run's record as JSON (`cell.record.run_record`), or other figures
    with which it ended; empty before the end. status: the run's result, or `running`, or `interrupted` if the
    process ended before the run."""

    id: str
    garment: str
    seed: int | None
    driver: str
    versions: Mapping[str, str]
    settings_hash: str
    pid: int
    started: float
    ended: float | None
    result: str | None
    summary: Mapping[str, Any]
    status: str
    directory: Path


class Journal:
    """The journal file of one logs folder. Create it with `open`; several processes may have it open."""

    def __init__(self, path: Path, connection: sqlite3.Connection, readonly: bool) -> None:
        self.path = path
        self.readonly = readonly
        self._connection = connection
        self._mutex = threading.RLock()

    @classmethod
    def open(cls, path: Path, readonly: bool = False, traceless: bool = False) -> Self:
        """Open the journal. Create it if it is missing, unless `readonly`.

        traceless: with `readonly`, leave no file of SQLite beside a journal that nobody writes now. Only for one
        short reading: a process that begins to write meanwhile is not noticed.

        Raises StorageError if it cannot be read or written, is no journal, or was written by a newer version.
        A file of another program is never changed.
        """
        try:
            connection = _connect_readonly(path, traceless) if readonly else _connect(path)
        except (sqlite3.Error, ValueError) as e:
            raise _storage_error(path, e) from e
        return cls(path, connection, readonly)

    def close(self) -> None:
        with self._mutex:
            self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # writing

    def begin_run(
        self,
        *,
        garment: str,
        seed: int | None,
        driver: str,
        settings_hash: str = "",
        versions: Mapping[str, str] | None = None,
        wall_clock: Callable[[], float] = time.time,
    ) -> RunJournal:
        """Begin a run: create its folder beside the journal, its row, and the lock that its process holds.

        The run's id is the name of its folder. If this raises StorageError, neither row nor folder remains.
        """
        started = wall_clock()
        folder = _make_run_folder(self.path.parent, garment, seed, started)
        owner = OwnerLock(folder / OWNER_FILE, "the run")
        try:
            owner.acquire()
            self._write(
                "INSERT INTO runs (id, garment, seed, driver, versions, settings_hash, pid, started)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (folder.name, garment, seed, driver, _dumps(versions or {}), settings_hash, os.getpid(), started),
            )
        except BaseException:
            owner.release()
            (folder / OWNER_FILE).unlink(missing_ok=True)
            folder.rmdir()
            raise
        return RunJournal(self, folder, owner, wall_clock)

    def _write(self, sql: str, values: tuple[Any, ...]) -> int:
        """Execute one statement as one transaction on disk. Returns the number of changed rows."""
        with self._mutex, self._errors():
            return self._connection.execute(sql, values).rowcount

    # reading

    def runs(self) -> list[JournalRun]:
        """All runs in the order in which they began, each with its present status."""
        rows = self._read("SELECT * FROM runs ORDER BY rowid", ())
        return [self._record(row) for row in rows]

    def run(self, name: str) -> JournalRun:
        """The run called `name`: an id, its first characters, a folder, or `last`.

        Raises ConfigurationError if there is no such run, or more than one.
        """
        runs = self.runs()
        if not runs:
            raise ConfigurationError(f"there are no runs yet in {self.path.parent}", "foldcell fold makes one")
        if name == "last":
            return runs[-1]
        wanted = Path(name).name  # the path of a run's folder is accepted too
        found = [r for r in runs if r.id == wanted] or [r for r in runs if wanted and r.id.startswith(wanted)]
        if len(found) == 1:
            return found[0]
        if not found:
            raise ConfigurationError(
                f"there is no run '{name}' in {self.path.parent}",
                f"the last one is {runs[-1].id}; see foldcell runs",
            )
        raise ConfigurationError(
            f"'{name}' is the beginning of {len(found)} runs", "for example " + ", ".join(r.id for r in found[:5])
        )

    def entries(self, run: str) -> list[Entry]:
        """Return all entries of a run in order."""
        rows = self._read("SELECT * FROM events WHERE run = ? ORDER BY sequence", (run,))
        return [self._entry(row) for row in rows]

    def named(self, name: str) -> list[tuple[str, Entry]]:
        """Return (run id, entry) for all entries with this name, in the order in which the runs began."""
        rows = self._read(
            "SELECT events.* FROM events JOIN runs ON events.run = runs.id WHERE name = ?"
            " ORDER BY runs.rowid, sequence",
            (name,),
        )
        return [(row["run"], self._entry(row)) for row in rows]

    def began_to_act(self, run: str) -> bool:
        """Whether a run has begun an effect, i.e. whether its cell was opened."""
        return bool(self._read("SELECT 1 FROM events WHERE run = ? AND kind = 'intent' LIMIT 1", (run,)))

    def check(self) -> str:
        """SQLite's own check of the file: 'ok', or a description of the damage."""
        return str(self._read("PRAGMA quick_check", ())[0][0])

    def _read(self, sql: str, values: tuple[Any, ...]) -> list[sqlite3.Row]:
        with self._mutex, self._errors(), self._intact():
            return self._connection.execute(sql, values).fetchall()

    def _entry(self, row: sqlite3.Row) -> Entry:
        fields = {name: row[name] for name in _ENTRY_COLUMNS}
        with self._intact():
            return Entry(**fields, payload=json.loads(row["payload"]))

    def _record(self, row: sqlite3.Row) -> JournalRun:
        folder = self.path.parent / row["id"]
        status = row["result"] or ("running" if is_held(folder / OWNER_FILE) else "interrupted")
        if status == "interrupted":  # the run may have ended after its row was read
            now = self._read("SELECT * FROM runs WHERE id = ?", (row["id"],))
            row, status = (now[0], now[0]["result"] or status) if now else (row, status)
        with self._intact():
            versions = json.loads(row["versions"])
            summary = json.loads(row["summary"]) if row["summary"] else {}
        return JournalRun(
            id=row["id"],
            garment=row["garment"],
            seed=row["seed"],
            driver=row["driver"],
            versions=versions,
            settings_hash=row["settings_hash"],
            pid=row["pid"],
            started=row["started"],
            ended=row["ended"],
            result=row["result"],
            summary=summary,
            status=status,
            directory=folder,
        )

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.IntegrityError as e:
            raise InternalError(f"the journal refused an entry: {e}") from e
        except sqlite3.Error as e:
            raise _storage_error(self.path, e) from e

    @contextmanager
    def _intact(self) -> Iterator[None]:
        """Report text that is no UTF-8 or no JSON as damage of the file."""
        try:
            yield
        except ValueError as e:
            raise _storage_error(self.path, e) from e


def performed(entries: Sequence[Entry]) -> list[Intent]:
    """Return the effects among a run's entries, in order. An effect that did not end has no result."""
    results = {e.answers: e for e in entries if e.kind == "result"}
    return [Intent.of(e, results.get(e.sequence)) for e in entries if e.kind == "intent"]


class RunJournal:
    """Writes the entries of one run. Every method returns when its entry is on disk. Thread-safe.

    A StorageError means that the entry may be missing: stop the run and make the cell safe.
    """

    def __init__(
        self,
        journal: Journal,
        directory: Path,
        owner: OwnerLock,
        wall_clock: Callable[[], float],
    ) -> None:
        self.id = directory.name
        self.directory = directory
        self._journal = journal
        self._owner = owner
        self._wall_clock = wall_clock
        self._sequence = 0
        self._open_intents: dict[int, tuple[str, str]] = {}
        self._ended = False
        self._mutex = threading.Lock()

    def event(self, t: float, state: str, name: str, payload: Mapping[str, Any] | None = None) -> int:
        """Record an event at cell time `t` [s]: a transition or a decision. Returns its sequence number."""
        return self._append("event", t, state, name, payload)

    def intent(self, t: float, state: str, effect: str, payload: Mapping[str, Any] | None = None) -> int:
        """Record that an effect is about to begin. Returns the id to pass to `result`."""
        return self._append("intent", t, state, effect, payload)

    def result(self, intent: int, t: float, payload: Mapping[str, Any] | None = None) -> int:
        """Record the result of the effect `intent`. Raises InternalError if this intent is not open."""
        if intent not in self._open_intents:
            raise InternalError(f"run {self.id}: there is no open intent {intent}")
        state, effect = self._open_intents[intent]
        return self._append("result", t, state, effect, payload, intent)

    def end(self, result: str, summary: Mapping[str, Any] | None = None) -> None:
        """End the run with its result and figures, and release the lock. Raises InternalError if called again."""
        with self._mutex:
            if self._ended:
                raise InternalError(f"run {self.id} was ended twice")
            changed = self._journal._write(
                "UPDATE runs SET ended = ?, result = ?, summary = ? WHERE id = ? AND ended IS NULL",
                (self._wall_clock(), result, _dumps({"schema": PAYLOAD_SCHEMA, **(summary or {})}), self.id),
            )
            if changed != 1:
                raise StorageError(
                    f"the run {self.id} is no longer open in the journal", "was the journal replaced?"
                )
            self._ended = True
        self._owner.release()
        (self.directory / OWNER_FILE).unlink(missing_ok=True)

    def refuse(self, reason: CellError) -> None:
        """End a run without entries as `not_begun`, with this reason. Abandon a run that has entries."""
        if not self._sequence and not self._ended:
            with suppress(StorageError):
                return self.end(NOT_BEGUN, {"reason": {"what": reason.what, "hint": reason.hint}})
        self.abandon()

    def abandon(self) -> None:
        """Release the lock without ending the run, which then counts as interrupted."""
        self._owner.release()

    def _append(
        self,
        kind: str,
        t: float,
        state: str,
        name: str,
        payload: Mapping[str, Any] | None,
        answers: int | None = None,
    ) -> int:
        text = _dumps({"schema": PAYLOAD_SCHEMA, **(payload or {})})
        state, name = str(state), str(name)
        with self._mutex:
            if self._ended:
                raise InternalError(f"run {self.id} has ended: '{name}' is too late")
            sequence = self._sequence + 1
            self._journal._write(
                "INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (self.id, sequence, float(t), self._wall_clock(), state, kind, name, answers, text),
            )
            self._sequence = sequence
            if kind == "intent":
                self._open_intents[sequence] = (state, name)
            elif answers is not None:
                del self._open_intents[answers]
        return sequence


def _dumps(value: Mapping[str, Any]) -> str:
    return json.dumps(to_json(value), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


_ENTRY_COLUMNS = tuple(f.name for f in dataclasses.fields(Entry) if f.name != "payload")


# files


def _sqlite(path: Path, mode: str) -> sqlite3.Connection:
    """Open the file. mode: parameters of SQLite's address of a file."""
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?{mode}", uri=True, isolation_level=None, check_same_thread=False,
        timeout=BUSY_S,
    )  # fmt: skip
    connection.row_factory = sqlite3.Row
    return connection


def _connect(path: Path) -> sqlite3.Connection:
    connection = _sqlite(path, "mode=rwc")
    try:
        version = _check_version(connection, path)  # before the file is changed
        _retry_busy(lambda: connection.execute("PRAGMA journal_mode=WAL"))
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("PRAGMA foreign_keys=ON")
        if version == 0:  # only a new file needs the write lock, for which the wait can be long
            _make_tables(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def _make_tables(connection: sqlite3.Connection, path: Path) -> None:
    connection.execute("BEGIN IMMEDIATE")  # if several processes open a new file, only one creates the tables
    try:
        if _check_version(connection, path) == 0:
            for statement in filter(str.strip, _TABLES.split(";\n")):
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id={APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


def _connect_readonly(path: Path, traceless: bool) -> sqlite3.Connection:
    """Connect for reading only. This also works in a read-only folder, where SQLite cannot create WAL files."""
    if not path.is_file():
        hint = "this folder has no run yet: 'foldcell fold' makes one, and --logs DIR names another folder"
        raise StorageError(f"there is no journal {path}", hint, path=str(path))
    wal = path.with_name(path.name + "-wal")
    modes, immutable = ["mode=ro"], "mode=ro&immutable=1"
    if traceless and not wal.exists():
        modes = [immutable]
    elif not wal.exists() or wal.stat().st_size == 0:
        modes.append(immutable)  # without a WAL the main file is complete
    for mode in modes:
        connection = _sqlite(path, mode)
        try:
            if _check_version(connection, path) == 0:
                raise StorageError(f"{path} is empty: it is no journal", "move it aside", path=str(path))
            return connection
        except BaseException as e:
            connection.close()
            if mode == modes[-1] or not isinstance(e, sqlite3.OperationalError):
                raise
    raise AssertionError


def _check_version(connection: sqlite3.Connection, path: Path) -> int:
    """The schema version; 0 for an empty file. Raises StorageError for a file of another program or of a newer
    version."""
    # count the tables first, because another process may create tables and ids between these statements
    tables = int(connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])
    application = int(connection.execute("PRAGMA application_id").fetchone()[0])
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version == 0 and application == 0 and tables == 0:
        return 0
    if application != APPLICATION_ID:
        raise StorageError(
            f"{path} is a SQLite file of another program, not a journal",
            "choose another --logs DIR",
            path=str(path),
        )
    if version > SCHEMA_VERSION:
        raise StorageError(
            f"{path} was written by a newer foldcell (schema {version}; this one reads {SCHEMA_VERSION})",
            "update foldcell, or choose another --logs DIR",
            path=str(path),
        )
    return version


def _retry_busy(action: Callable[[], object]) -> None:
    """Repeat `action` while the file is busy. The switch to WAL does not wait for other processes by itself."""
    deadline = time.monotonic() + BUSY_S
    while True:
        try:
            action()
            return
        except sqlite3.OperationalError as e:
            if e.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def _make_run_folder(logs: Path, garment: str, seed: int | None, started: float) -> Path:
    """Create a folder with a name like `20261120T235416Z-medium_towel-seed3`."""
    stamp = datetime.fromtimestamp(started, UTC).strftime("%Y%m%dT%H%M%SZ")
    word = "".join(c if c.isalnum() or c in "_-" else "_" for c in Path(garment).stem)[:40] or "garment"
    return new_folder(logs, f"{stamp}-{word}" + (f"-seed{seed}" if seed is not None else ""))


def _storage_error(path: Path, error: sqlite3.Error | ValueError) -> StorageError:
    if isinstance(error, ValueError):  # bytes that are no UTF-8, or a text that is no JSON
        return StorageError(
            f"the journal {path} is damaged: {error}", "keep a copy and move it aside", path=str(path)
        )
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    hint = {
        sqlite3.SQLITE_FULL: "the disk is full: free some space, or choose another --logs DIR",
        sqlite3.SQLITE_READONLY: "the folder or the file is read-only: choose another --logs DIR or FOLDCELL_LOGS",
        sqlite3.SQLITE_CANTOPEN: "the folder cannot be written: choose another --logs DIR or FOLDCELL_LOGS",
        sqlite3.SQLITE_NOTADB: "it is no SQLite file: move it aside",
        sqlite3.SQLITE_CORRUPT: "the file is damaged: keep a copy and move it aside",
        sqlite3.SQLITE_BUSY: "another process keeps the journal locked",
    }.get(code, "check the disk")
    return StorageError(f"the journal {path}: {error}", hint, path=str(path), sqlite=code)
