"""Worker processes end with their parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor
from multiprocessing import active_children
from pathlib import Path

import pytest

from foldcell.cell.support.process import workers
from foldcell.cell.support.process.signals import BY_SIGNAL
from foldcell.cell.support.process.workers import worker_pool

MAKER = """
import sys, time
from pathlib import Path
from foldcell.cell.support.process.signals import Terminated, unwinding
from foldcell.cell.support.process.workers import worker_pool

if __name__ == "__main__":
    with unwinding():
        try:
            with worker_pool(1, *map(int, sys.argv[2:])) as pool:
                task = "import os, time; open(%r, 'w').write(str(os.getpid())); time.sleep(100)"
                pool.submit(exec, task % sys.argv[1]).result()
        except Terminated as e:
            sys.exit(128 + e.number)
"""


def alive(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("number", "code", "each"),
    [(signal.SIGKILL, -signal.SIGKILL, ()), (signal.SIGKILL, -signal.SIGKILL, ("8",)),
     (signal.SIGTERM, BY_SIGNAL + signal.SIGTERM, ("8",)), (signal.SIGHUP, BY_SIGNAL + signal.SIGHUP, ())],
)  # fmt: skip
def test_no_worker_is_left_behind(tmp_path: Path, number: int, code: int, each: tuple[str, ...]) -> None:
    script, told = tmp_path / "maker.py", tmp_path / "pid"
    script.write_text(MAKER)
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a child inherits an ignored SIGHUP, as under nohup
    maker = subprocess.Popen([sys.executable, str(script), str(told), *each], env=environment)
    signal.signal(signal.SIGHUP, before)
    until = time.monotonic() + 30.0
    while not (told.exists() and told.read_text()) and time.monotonic() < until:
        time.sleep(0.05)
    worker = int(told.read_text())
    assert alive(worker)
    maker.send_signal(number)
    assert maker.wait(20.0) == code
    until = time.monotonic() + 10.0
    while alive(worker) and time.monotonic() < until:
        time.sleep(0.05)
    assert not alive(worker)


RUN = """
import os, signal, time
open(os.path.join({folder!r}, "begun-{number}"), "w").close()
asked = []
before = signal.signal(signal.SIGTERM, lambda *_: asked.append(1))  # as a run with an open cell
until = time.monotonic() + 5.0
while not asked and time.monotonic() < until:
    time.sleep(0.02)
signal.signal(signal.SIGTERM, before)
open(os.path.join({folder!r}, ("stopped" if asked else "whole") + "-{number}"), "w").close()
"""


@pytest.mark.parametrize("each", [None, 8])
def test_queued_tasks_are_not_done_after_an_interruption(tmp_path: Path, each: int | None) -> None:
    """The running task is interrupted in an orderly way, and queued tasks are dropped."""

    def ended(how: str) -> list[str]:
        return sorted(path.name for path in tmp_path.glob(f"{how}-*"))

    with pytest.raises(KeyboardInterrupt), worker_pool(1, each) as pool:
        for number in range(4):
            pool.submit(exec, RUN.format(folder=str(tmp_path), number=number), {})
        until = time.monotonic() + 30.0
        while not ended("begun") and time.monotonic() < until:
            time.sleep(0.02)
        time.sleep(0.1)
        raise KeyboardInterrupt
    assert "stopped-0" in ended("stopped") and ended("whole") == []
    assert not active_children()


COMPILING = """
import time
from foldcell.cell.support.process.signals import taking_signals
from foldcell.skills.compiled import _on_a_thread
from tests.fakes import FakeCell

def compile_now(signature):
    open({begun!r}, "w").close()
    time.sleep(600.0)

with taking_signals() as interrupts, interrupts.stop(FakeCell().ports(), asked=False):
    _on_a_thread(compile_now)("i8(i8)")
"""


@pytest.mark.timeout(60)
def test_a_worker_with_an_open_cell_ends_while_it_compiles(tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    with pytest.raises(KeyboardInterrupt), worker_pool(1, 8) as pool:
        pool.submit(exec, COMPILING.format(begun=str(begun)), {})
        while not begun.exists():
            time.sleep(0.02)
        raise KeyboardInterrupt
    assert not active_children()


@pytest.mark.parametrize("each", [None, 1, 3])
@pytest.mark.timeout(60)
def test_tasks_run_in_another_process(each: int | None) -> None:
    """There are more tasks than processes, and processes are replaced."""
    with worker_pool(2, each) as pool:
        pids = list(pool.map(_pid, range(14)))
    assert os.getpid() not in pids
    if each is not None:
        assert max(pids.count(pid) for pid in pids) <= each


@pytest.mark.timeout(60)
def test_a_dead_process_fails_only_its_own_task() -> None:
    with worker_pool(2, 4) as pool:
        tasks = [pool.submit(_die if k == 3 else _pid, k) for k in range(9)]
        failed = [k for k, task in enumerate(tasks) if isinstance(task.exception(), BrokenExecutor)]
    assert failed == [3]


def _die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _pid(_: int) -> int:
    return os.getpid()


def test_an_interruption_is_acknowledged_before_the_workers_have_ended(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []
    monkeypatch.setattr(workers, "_end_children", lambda: said.append(capsys.readouterr().err))
    with pytest.raises(KeyboardInterrupt), worker_pool(1):
        raise KeyboardInterrupt
    assert said == ["ending the worker processes\n"]
