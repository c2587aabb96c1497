"""Lock files. They ensure that a cell has one owner at a time, and a run's lock shows that its process is alive.

The lock is a kernel lock (`flock`). It ends with the process that holds it, however that process ends, so that a
stale file never blocks a cell. A forked child immediately releases its copy of the lock. A renderer that outlives
a killed executive therefore does not hold the cell. The file contains the owner's pid, which is used in messages
only.
"""

from __future__ import annotations

import fcntl
import os
import time
import weakref
from pathlib import Path
from types import TracebackType
from typing import Self

from foldcell.robots.errors import ConfigurationError, StorageError

_PATIENCE_S = 0.2
"""`acquire` retries for this time [s], because `is_held` also takes the lock for a moment."""


class CellBusyError(ConfigurationError):
    """Another process holds the lock, and `values["pid"]` is its pid. Nothing was moved or written."""


class OwnerLock:
    """An exclusive lock on `path`, held from `acquire` to `release` or to the end of the process.

    `acquire` raises CellBusyError if another owner holds it, StorageError if the file cannot be created.
    """

    def __init__(
        self, path: Path, what: str = "the cell", otherwise: str = ", or give this run another --logs DIR"
    ) -> None:
        """what: name of the locked thing, for messages; otherwise: text for the hint that names an alternative to
        waiting."""
        self.path = path
        self.what, self.otherwise = what, otherwise
        self._file: int | None = None

    def acquire(self) -> Self:
        if self._file is not None:
            return self
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as e:
            raise StorageError(
                f"cannot create the lock file {self.path}: {e.strerror}",
                "choose another folder with --logs DIR or FOLDCELL_LOGS",
                path=str(self.path),
            ) from e
        try:
            self._lock(file)
            os.ftruncate(file, 0)
            os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        except BaseException:
            os.close(file)
            raise
        self._file = file
        _HELD.add(self)
        return self

    def release(self) -> None:
        """Release the lock. The file stays: removing it would allow two owners."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
            _HELD.discard(self)

    def __enter__(self) -> Self:
        return self.acquire()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def _lock(self, file: int) -> None:
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as e:
                if time.monotonic() < deadline:
                    time.sleep(0.01)
                    continue
                pid = _pid(file)
                raise CellBusyError(
                    f"{self.what} is in use by process {pid or 'unknown'} ({self.path})",
                    "wait for it or stop it"
                    + (f" (kill -TERM {pid} makes the cell safe first)" if pid else "")
                    + self.otherwise,
                    pid=pid,
                    path=str(self.path),
                ) from e


def is_held(path: Path) -> bool:
    """Whether a process holds the lock now; False if there is no such file."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def _pid(file: int) -> int | None:
    text = os.pread(file, 32, 0).decode("ascii", "replace").strip()
    return int(text) if text.isdigit() else None


_HELD: weakref.WeakSet[OwnerLock] = weakref.WeakSet()


def _release_in_child() -> None:
    for lock in list(_HELD):
        lock.release()


os.register_at_fork(after_in_child=_release_in_child)
