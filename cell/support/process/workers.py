"""Start worker processes. They end with their parent process, however it ends."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.connection import wait
from threading import Lock, Thread
from typing import Any, TypeVar

AGAIN_S = 1.0
T = TypeVar("T")


@contextmanager
def worker_pool(workers: int, tasks_each: int | None = None) -> Iterator[Executor]:
    """Yield a pool of `workers` processes. tasks_each: a process is replaced after this number of tasks; None:
    never.

    An exception within the context, including KeyboardInterrupt, ends the running tasks and the processes. A task
    that performs a run stops this run and still writes its end.
    """
    with _processes(workers) if tasks_each is None else RenewedWorkers(workers, tasks_each) as pool:
        try:
            yield pool
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                print("ending the worker processes", file=sys.stderr, flush=True)
            pool.shutdown(wait=False, cancel_futures=True)
            _end_children()
            raise


class RenewedWorkers(Executor):
    """An executor of parallel processes, each replaced after `tasks_each` tasks. If a process dies, only its own
    task fails (BrokenExecutor), and the next task gets a new process.

    `max_tasks_per_child` of the standard library cannot be used. With more waiting tasks than processes, it stops
    replacing processes and waits for ever (CPython issue 115634).
    """

    def __init__(self, workers: int, tasks_each: int) -> None:
        self._tasks_each = tasks_each
        self._threads = ThreadPoolExecutor(workers, "worker")
        self._lock = Lock()
        self._idle: list[tuple[ProcessPoolExecutor, int]] = []
        """Processes without a task, and the number of tasks that each may still perform."""
        self._closed = False

    def submit(self, fn: Callable[..., T], /, *args: Any, **options: Any) -> Future[T]:
        return self._threads.submit(self._perform, fn, *args, **options)

    def _perform(self, fn: Callable[..., T], *args: Any, **options: Any) -> T:
        with self._lock:  # shutdown must find every process that was started
            if self._closed:
                raise CancelledError
            process, left = self._idle.pop() if self._idle else (_processes(1), self._tasks_each)
            task = process.submit(fn, *args, **options)
        try:
            return task.result()
        finally:
            broken = isinstance(task.exception(), BrokenExecutor)
            with self._lock:
                keep = left > 1 and not broken and not self._closed
                if keep:
                    self._idle.append((process, left - 1))
            if not keep:
                process.shutdown()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        if not cancel_futures and wait:
            self._threads.shutdown()
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process, _ in idle:
            process.shutdown(wait)


def _processes(number: int) -> ProcessPoolExecutor:
    # spawn: a forked child would share locks of the parent's threads, numba's state and the renderer
    return ProcessPoolExecutor(number, mp_context=get_context("spawn"), initializer=_initialise)


def _end_children() -> None:
    """Terminate the child processes, repeatedly until none is left. The first signal may stop a run, whose end is
    then written. Tasks that were already handed over to a process begin afterwards, and later signals end them."""
    while children := active_children():
        for child in children:
            child.terminate()
        until = time.monotonic() + AGAIN_S
        for child in children:
            child.join(max(0.0, until - time.monotonic()))


def _initialise() -> None:
    """Set up a worker process. It ignores Ctrl-C, which reaches every process of a terminal, because the parent
    ends the workers. If the parent is gone, the worker ends itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, name="follow-parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is None:
        return
    wait([parent.sentinel])
    while True:  # the first signal may stop a run, whose end is then written
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(AGAIN_S)
