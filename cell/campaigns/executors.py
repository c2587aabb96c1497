"""Executors of campaigns: worker processes of this machine, or a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foldcell.cell.campaigns.trials.store import cpu_model, program_versions
from foldcell.cell.support.process.workers import worker_pool
from foldcell.robots.errors import ConfigurationError

RUNS_EACH = 8
"""A worker process of this machine is replaced after this number of runs, so that its memory use stays limited."""
MEMORY_EACH = 2**30
"""Memory that the process of a run takes at least, once it has simulated a fold [bytes]."""
PATIENCE_S = 15.0


def process_died(error: BaseException) -> bool:
    """Whether the exception of a task means that its worker process died."""
    return isinstance(error, BrokenExecutor | CancelledError)


@dataclass(frozen=True)
class Workers:
    """The workers that perform the tasks of a campaign. executor: any executor of `concurrent.futures`. count:
    number of tasks that run in parallel. died(error): whether the exception of a task means that its worker
    process died. notes: messages for the user."""

    executor: Executor
    count: int
    died: Callable[[BaseException], bool] = process_died
    notes: tuple[str, ...] = ()


def chosen_workers(
    count: int | None, cluster: str | None, folder: Path, tasks_each: int | None = None
) -> AbstractContextManager[Workers]:
    """Return the workers that a user asked for: those of the cluster at address `cluster`, `count` processes of
    this machine, or by default one process per core. tasks_each: a process of this machine is replaced after this
    number of tasks; None: never.

    Raises ConfigurationError if both `count` and `cluster` are given, or if the memory is too small for `count`
    processes.
    """
    if cluster is None:
        cores = len(os.sched_getaffinity(0))
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        if count is not None and count > max(cores, memory // MEMORY_EACH):
            raise ConfigurationError(
                f"--workers {count}: this machine has memory for {memory // MEMORY_EACH} runs at a time",
                f"give at most that; more than its {cores} cores bring nothing",
            )
        return local_workers(count or cores, tasks_each)
    if count is not None:
        raise ConfigurationError("--workers with --cluster", "the cluster's workers decide how many run at a time")
    return cluster_workers(cluster, folder)


@contextmanager
def local_workers(count: int, tasks_each: int | None = RUNS_EACH) -> Iterator[Workers]:
    """Start `count` worker processes on this machine. An exception within the context ends the running tasks."""
    with worker_pool(count, tasks_each) as pool:
        yield Workers(pool, count)


@contextmanager
def cluster_workers(address: str, folder: Path) -> Iterator[Workers]:
    """Connect to the workers of the Dask scheduler at `address`, e.g. tcp://head:8786.

    The workers must run the same program, one task at a time, and have `folder` at the same path. This function
    checks these conditions first. Raises ConfigurationError.
    """
    try:
        from distributed import CancelledError as TaskLost
        from distributed import Client, KilledWorker
    except ImportError:
        raise ConfigurationError(
            "--cluster needs the package distributed", "install it: pip install 'foldcell[cluster]'"
        ) from None
    try:
        client: Any = Client(address, timeout=PATIENCE_S)  # type: ignore[no-untyped-call]
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except (OSError, ValueError, TimeoutError) as e:
        raise ConfigurationError(
            f"no Dask scheduler with workers answers at {address}: {e}",
            "start one (dask scheduler) and workers (dask worker ADDRESS --nthreads 1), or check the address",
        ) from None
    with client:
        threads = {
            name: worker["nthreads"] for name, worker in client.scheduler_info(n_workers=-1)["workers"].items()
        }
        several = [name for name, count in threads.items() if count != 1]
        if several:
            raise ConfigurationError(
                f"{len(several)} workers perform several tasks at a time ({several[0]})",
                "start the workers with --nthreads 1, and one process for each core",
            )
        try:
            seen = client.run(_examine, str(folder))
        except Exception as e:  # whatever the workers raise, e.g. if they lack the program
            raise ConfigurationError(
                f"the workers cannot be examined: {type(e).__name__}: {e}", "install foldcell where they run"
            ) from None
        own = program_versions()
        for worker, (there, versions, _) in seen.items():
            if not there:
                raise ConfigurationError(
                    f"the worker {worker} does not see the folder {folder}",
                    "give a --logs DIR that all machines share",
                )
            other = [
                f"{name} {versions.get(name)} (here {own[name]})"
                for name in own
                if versions.get(name) != own[name]
            ]
            if other:
                raise ConfigurationError(
                    f"the worker {worker} runs another program: {', '.join(other)}",
                    "install the same version there and start the worker again",
                )
        models = sorted({cpu for _, _, cpu in seen.values()} | {cpu_model()})
        note = "processors differ, so the last digits of results may: " + ", ".join(models)
        yield Workers(
            client.get_executor(pure=False),
            len(threads),
            lambda error: process_died(error) or isinstance(error, KilledWorker | TaskLost),
            (note,) if len(models) > 1 else (),
        )


def _examine(folder: str) -> tuple[bool, dict[str, str], str]:
    """Return whether a worker sees the folder, the versions of its program, and its processor. Called on the
    worker."""
    return Path(folder).is_dir(), program_versions(), cpu_model()
