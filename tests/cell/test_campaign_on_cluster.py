"""A campaign on a real Dask scheduler with two worker processes, one of which is killed in the midst."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from foldcell.cell.campaigns.executors import cluster_workers
from foldcell.cell.campaigns.perform_campaign import perform_campaign
from foldcell.cell.campaigns.trials.campaign import Campaign, read_campaign
from foldcell.cell.campaigns.trials.perform_trial import Fold
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.config.cell_settings import load_settings
from foldcell.robots.errors import ConfigurationError
from tests.builders.campaigns import logged_fold, trials_campaign

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
CAMPAIGN = """
garments: [small_towel]
seeds: [1]
keep: none
variants:
  no_garment:
    do: [{fault: {kind: no_garment}}]
    cell: {recovery: {patience: 0}}
"""


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


def performed(folder: Path, campaign: Campaign, address: str, fold: Fold | None = None) -> list[Trial]:
    folder.mkdir()
    opened = CampaignFolder.create(folder, campaign, folder)
    with cluster_workers(address, folder) as workers:
        return perform_campaign(opened, workers, lambda trial: None, fold)


def test_a_campaign_loses_nothing_with_a_killed_worker_and_the_other_one_folds(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    """A worker dies among quick runs. A run of the simulated cell follows, in a thread of the other worker."""
    address, processes = cluster
    folder = tmp_path / "quick"

    def kill_one_in_the_midst() -> None:
        while not list(folder.rglob("trial.json")):
            time.sleep(0.05)
        processes[0].send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill_one_in_the_midst, daemon=True)
    killer.start()
    quick = performed(folder, trials_campaign(range(12)), address, logged_fold)
    killer.join(10.0)
    assert processes[0].wait(10.0) == -signal.SIGKILL
    assert len(quick) == 12 and all(trial.performed for trial in quick)
    times = {trial.request.seed: trial.record and trial.record.robot_time_s for trial in quick}
    assert times == {seed: 30.0 + seed for seed in range(12)}

    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    (trial,) = performed(tmp_path / "whole", read_campaign(tmp_path / "campaign.yaml", load_settings()), address)
    assert trial.record is not None and trial.record.failure is not None, trial.error
    assert (trial.record.state, trial.record.failure.kind) == ("not_folded", "no_garment")


def test_a_cluster_that_does_not_answer_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.PATIENCE_S", 1.0)
    nobody = cluster_workers("tcp://127.0.0.1:9", tmp_path)
    with pytest.raises(ConfigurationError, match="no Dask scheduler"), nobody:
        pass
