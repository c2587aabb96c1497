"""One owner at a time: a second one is refused while the lock is held, and the lock is free when its owner's
process is gone."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from foldcell.cell.support.process.lock import CellBusyError, OwnerLock, is_held
from foldcell.robots.errors import ConfigurationError, StorageError

OWNER = """
import sys, time
from pathlib import Path
from foldcell.cell.support.process.lock import OwnerLock
OwnerLock(Path(sys.argv[1])).acquire()
print("held", flush=True)
time.sleep(60)
"""
OWNER_WITH_CHILD = """
import os, sys, time
from pathlib import Path
from foldcell.cell.support.process.lock import OwnerLock
lock = OwnerLock(Path(sys.argv[1])).acquire()
if os.fork() == 0:
    print(os.getpid(), flush=True)
time.sleep(60)
"""


def start(script: str, path: Path) -> tuple[subprocess.Popen, str]:
    process = subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


def test_a_second_owner_is_refused_with_the_pid_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "cell.lock"
    process, _ = start(OWNER, path)
    try:
        assert is_held(path)
        with pytest.raises(CellBusyError, match=str(process.pid)) as caught:
            OwnerLock(path).acquire()
        assert caught.value.values["pid"] == process.pid
        # a usage error for the commands, because nothing has moved
        assert isinstance(caught.value, ConfigurationError)
        assert path.read_text().strip() == str(process.pid)  # the refused owner has changed nothing
    finally:
        process.kill()
        process.wait()


def test_a_killed_owner_frees_the_cell(tmp_path: Path) -> None:
    path = tmp_path / "cell.lock"
    process, _ = start(OWNER, path)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not is_held(path)
    with OwnerLock(path):
        assert is_held(path)
        assert path.read_text().strip() == str(os.getpid())


def test_a_child_that_outlives_a_killed_owner_does_not_hold_the_cell(tmp_path: Path) -> None:
    path = tmp_path / "cell.lock"
    process, child = start(OWNER_WITH_CHILD, path)
    try:
        assert is_held(path)
        process.kill()
        process.wait()
        os.kill(int(child), 0)  # the child is alive
        assert not is_held(path)
    finally:
        os.kill(int(child), signal.SIGKILL)


def test_a_child_that_ends_does_not_free_its_parent(tmp_path: Path) -> None:
    path = tmp_path / "cell.lock"
    with OwnerLock(path):
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)
        assert is_held(path)


def test_a_released_lock_can_be_acquired_again(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "cell.lock"
    lock = OwnerLock(path).acquire()
    assert lock.acquire() is lock
    lock.release()
    lock.release()
    assert not is_held(path) and path.exists()
    with OwnerLock(path), pytest.raises(CellBusyError):
        OwnerLock(path).acquire()


def test_two_locks_in_one_process_exclude_each_other(tmp_path: Path) -> None:
    with OwnerLock(tmp_path / "l"), pytest.raises(CellBusyError, match=str(os.getpid())):
        OwnerLock(tmp_path / "l").acquire()


def test_checking_a_lock_does_not_block_its_owner(tmp_path: Path) -> None:
    """`is_held` holds a shared lock for an instant. An owner that acquires at this moment must wait and not
    fail."""
    import fcntl
    import threading

    path = tmp_path / "l"
    path.touch()
    looker = os.open(path, os.O_RDONLY)
    fcntl.flock(looker, fcntl.LOCK_SH)
    threading.Timer(0.05, lambda: fcntl.flock(looker, fcntl.LOCK_UN)).start()
    begun = time.monotonic()
    with OwnerLock(path):
        assert time.monotonic() - begun >= 0.03
    os.close(looker)


def test_a_missing_lock_file_is_not_held(tmp_path: Path) -> None:
    assert not is_held(tmp_path / "none")


def test_an_unwritable_lock_is_a_storage_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="lock file"):
        OwnerLock(tmp_path / "file" / "cell.lock").acquire()
