"""Processes for work beside this one's. They end with it, however it ends: none goes on folding for nobody."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.connection import wait
from threading import Thread

__all__ = ["worker_pool"]

AGAIN_S = 1.0


@contextmanager
def worker_pool(workers: int, tasks_each: int | None = None) -> Iterator[Executor]:
    """So many processes. tasks_each: after so many tasks a process is replaced. What is raised within, an
    interruption too, ends the work under way: a run is stopped and written to its end."""
    # spawn: a forked child would share the parent's threads' locks, numba's state and the renderer
    context = get_context("spawn")
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_follow, max_tasks_per_child=tasks_each
    ) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():
                worker.terminate()
            raise


def _follow() -> None:
    """Ctrl-C reaches every process of a terminal: the one that asked for the work ends it. Where that one is gone,
    the worker ends itself: nothing else would."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, name="follow-parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is None:
        return
    wait([parent.sentinel])
    while True:  # the first may stop a run, which is then written to its end
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(AGAIN_S)
