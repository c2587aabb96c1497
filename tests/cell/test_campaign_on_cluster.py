"""A campaign on a real Dask scheduler with two worker processes, one of which is killed in the midst."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.campaigns.executors import cluster_workers, local_workers
from foldcell.cell.campaigns.perform_campaign import perform_campaign
from foldcell.cell.campaigns.trials.campaign import read_campaign
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.config.cell_settings import load_settings
from foldcell.robots.errors import ConfigurationError

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
CAMPAIGN = """
garments: [small_towel]
keep: none
variants:
  no_garment:
    do: [{fault: {kind: no_garment}}]
    cell: {recovery: {patience: 0}}
"""
UNLIKE = ("wall_time_s", "run_dir", "recording")


def outcome(trial: Trial) -> dict[str, Any]:
    """The values of the record that depend on the request alone."""
    assert trial.record is not None, trial.error
    return {name: value for name, value in trial.record.as_json().items() if name not in UNLIKE}


def ended(trial: Trial) -> float:
    assert trial.record is not None, trial.error
    return (Path(trial.record.run_dir) / "result.json").stat().st_mtime


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and its two workers."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{s.getsockname()[1]}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3"}

    def start(*line: str) -> subprocess.Popen[bytes]:
        with (tmp_path / "dask.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "distributed.cli." + line[0], *line[1:]],
                stdout=log, stderr=log, env=environment, cwd=tmp_path,
            )  # fmt: skip

    scheduler = start("dask_scheduler", "--host", "127.0.0.1", "--port", address.rsplit(":")[-1], "--no-dashboard")
    workers = [start("dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard") for _ in range(2)]
    yield address, workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


def performed(folder: Path, workers: Any, seeds: Sequence[int]) -> list[Trial]:
    file = folder.with_suffix(".yaml")
    file.write_text(f"seeds: {[*seeds]}{CAMPAIGN}")
    campaign = read_campaign(file, load_settings())
    folder.mkdir()
    opened = CampaignFolder.create(folder, campaign, folder)
    with workers(folder) as chosen:
        return perform_campaign(opened, chosen, lambda trial: None)


def test_a_campaign_loses_nothing_with_a_killed_worker_and_equals_that_of_one_process(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, processes = cluster
    folder = tmp_path / "together"

    def kill_one_in_the_midst() -> None:
        while not list(folder.glob("*/*/trial.json")):
            time.sleep(0.05)
        processes[0].send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill_one_in_the_midst, daemon=True)
    killer.start()
    together = performed(folder, lambda folder: cluster_workers(address, folder), (1, 2, 3))
    killer.join(10.0)
    assert processes[0].wait(10.0) == -signal.SIGKILL
    assert len(together) == 3 and all(trial.performed for trial in together)
    repeated = max(together, key=ended)  # the killed worker's run ends last, on the other worker
    (alone,) = performed(tmp_path / "alone", lambda folder: local_workers(1), [repeated.request.seed])
    assert outcome(alone) == outcome(repeated)


def test_a_cluster_that_does_not_answer_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.PATIENCE_S", 1.0)
    nobody = cluster_workers("tcp://127.0.0.1:9", tmp_path)
    with pytest.raises(ConfigurationError, match="no Dask scheduler"), nobody:
        pass
