"""Perform runs of random garments with random faults for hours, and measure the resources that their processes
hold."""

from __future__ import annotations

import functools
import json
import os
import random
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foldcell.cell.campaigns.hil.script import Action
from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.campaigns.trials.perform_trial import perform_trial
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.simulation import TRAITS, FaultKind
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.process.workers import worker_pool
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import Side

SAMPLES = "endurance.jsonl"
SETTLED = 10
"""After this number of runs, a process has loaded and compiled everything. Growth is measured from that run on."""
MOMENTS = (State.LOOKING, State.APPROACHING, State.GRASPING, State.LIFTING, State.FOLDING, State.INSPECTING)


@dataclass(frozen=True)
class EnduranceRun:
    """One run and the resources of its process afterwards. fault: kind of the run's fault, or empty. number:
    number of the run in its process, from 1. handles: open file handles. memory_mib: resident memory [MiB]."""

    garment: str
    seed: int
    fault: str
    result: str
    error: str
    seconds: float = 0.0
    process: int = 0
    number: int = 0
    threads: int = 0
    handles: int = 0
    memory_mib: float = 0.0


@dataclass(frozen=True)
class Growth:
    """Growth of one process between its run number SETTLED and its last run. runs: number of its runs. threads,
    handles: increase of their number. memory: relative growth of the largest resident memory."""

    process: int
    runs: int
    threads: int
    handles: int
    memory: float


def random_requests(garments: Sequence[str], settings: CellSettings, seed: int) -> Iterator[TrialRequest]:
    """Yield an endless sequence of runs of random garments. On average every second run has one random fault. The
    same seed gives the same runs."""
    generator = random.Random(seed)
    values = settings.model_dump(mode="json", by_alias=True)
    number = 0
    while True:
        number += 1
        actions = (_fault(generator),) if generator.random() < 0.5 else ()
        garment, run_seed = generator.choice(list(garments)), generator.randrange(2**31)
        yield TrialRequest(f"run{number}", garment, run_seed, "sim", "xpbd", values, actions)


def endure(
    requests: Iterator[TrialRequest],
    folder: Path,
    hours: float,
    runs_each: int | None,
    report: Callable[[EnduranceRun], None],
) -> list[EnduranceRun]:
    """Perform runs one after the other until `hours` have passed. Returns them. Each run is appended to SAMPLES
    when it has ended.

    runs_each: a worker process is replaced after this number of runs; None: one process performs all runs. A
    process that dies is replaced. No recordings are kept.
    """
    until = time.monotonic() + 3600.0 * hours
    runs: list[EnduranceRun] = []
    work = functools.partial(_measured, str(folder))
    # runs_each None: the process is replaced after a number of runs that is never reached
    with worker_pool(1, runs_each or 10**9) as pool, (folder / SAMPLES).open("a", encoding="utf-8") as samples:
        while time.monotonic() < until:
            request = next(requests)
            try:
                run = pool.submit(work, request).result()
            except StorageError:
                raise
            except Exception as e:  # the process died; the next run gets a new process
                run = _ended(Trial(request, None, f"{type(e).__name__}: {e}", performed=False))
            runs.append(run)
            samples.write(json.dumps(asdict(run)) + "\n")
            samples.flush()
            os.fsync(samples.fileno())
            report(run)
    return runs


def growths(runs: Sequence[EnduranceRun]) -> list[Growth]:
    """Return the growth of each process that performed more than SETTLED runs."""
    found = []
    for process in dict.fromkeys(r.process for r in runs if r.process):
        own = [r for r in runs if r.process == process]
        if len(own) > SETTLED:
            first, last = own[SETTLED - 1], own[-1]
            memory = max(r.memory_mib for r in own[SETTLED:]) / first.memory_mib - 1.0
            found.append(
                Growth(process, len(own), last.threads - first.threads, last.handles - first.handles, memory)
            )
    return found


def _fault(generator: random.Random) -> dict[str, Any]:
    kind = generator.choice([k for k in FaultKind if k is not FaultKind.NO_GARMENT])
    fault: dict[str, Any] = {"kind": kind.value}
    if TRAITS[kind].sided:
        fault["side"] = generator.choice(list(Side)).value
    if TRAITS[kind].duration is not None:
        fault["duration_s"] = round(generator.uniform(0.2, 20.0), 1)
    moment = {"state": generator.choice(MOMENTS).value, "after_s": round(generator.uniform(0.0, 1.0), 2)}
    return Action.model_validate({"when": moment, "fault": fault}).model_dump(mode="json", exclude_none=True)


_PERFORMED = 0
"""Number of runs that this process has begun."""


def _measured(folder: str, request: TrialRequest) -> EnduranceRun:
    """Perform the run, then measure the threads, handles and memory of the process. Called in a worker process."""
    global _PERFORMED
    _PERFORMED += 1
    began = time.monotonic()
    trial = perform_trial(request, Path(folder) / request.folder, "none")
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return _ended(
        trial,
        time.monotonic() - began,
        os.getpid(),
        _PERFORMED,
        int(status["Threads"]),
        len(os.listdir("/proc/self/fd")),
        int(status["VmRSS"].split()[0]) / 1024.0,
    )


def _ended(trial: Trial, *measured: Any) -> EnduranceRun:
    request = trial.request
    fault = str(request.actions[0]["fault"]["kind"]) if request.actions else ""
    return EnduranceRun(request.garment, request.seed, fault, trial.result, trial.error, *measured)
