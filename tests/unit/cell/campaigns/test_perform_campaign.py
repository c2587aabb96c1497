"""Whole campaigns with quick runs: nothing is lost and nothing repeated, whatever is killed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from foldcell.cell.campaigns.executors import Workers
from foldcell.cell.campaigns.perform_campaign import perform_campaign
from foldcell.cell.campaigns.trials.store import MANIFEST, CampaignFolder
from foldcell.robots.errors import ConfigurationError
from tests.builders.campaigns import FINISHED, logged_fold, trials_campaign

ROOT = Path(__file__).parents[4]
CONTINUE = """
import sys
from pathlib import Path
from foldcell.cell.campaigns.executors import local_workers
from foldcell.cell.campaigns.perform_campaign import perform_campaign
from foldcell.cell.campaigns.trials.store import CampaignFolder
from tests.builders.campaigns import logged_fold
if __name__ == "__main__":
    campaign = CampaignFolder.open(Path(sys.argv[1]))
    with campaign.owned(), local_workers(2) as workers:
        perform_campaign(campaign, workers, lambda trial: print("ended", flush=True), logged_fold)
"""


def finished(folder: Path) -> Counter[str]:
    log = folder / FINISHED
    return Counter(log.read_text().split()) if log.exists() else Counter()


def test_a_campaign_killed_twice_makes_every_run_once(tmp_path: Path) -> None:
    """kill -9 of the client and its workers at random moments; finished runs are never made again."""
    seeds = range(14)
    CampaignFolder.create(tmp_path, trials_campaign(seeds), tmp_path / "logs")
    script = tmp_path / "continue.py"
    script.write_text(CONTINUE)
    generator = random.Random(20_261_125)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for kill in (True, True, False):
        client = subprocess.Popen(
            [sys.executable, script, tmp_path], stdout=subprocess.PIPE, text=True, env=environment,
            start_new_session=True,
        )  # fmt: skip
        assert client.stdout is not None
        if kill:
            for _ in range(generator.randint(1, 4)):
                assert client.stdout.readline() == "ended\n"
            time.sleep(generator.uniform(0.0, 0.2))
            os.killpg(client.pid, signal.SIGKILL)
        client.communicate()
    assert client.returncode == 0
    # a run that was killed between its last line and its result may be made twice; none was finished twice
    assert set(finished(tmp_path)) == {str(seed) for seed in seeds}
    assert sum(finished(tmp_path).values()) <= len(seeds) + 2 * 2
    results = json.loads((tmp_path / "trials.json").read_text())
    assert [run["seed"] for run in results["runs"]] == list(seeds) and results["not_performed"] == []
    assert [run["record"]["robot_time_s"] for run in results["runs"]] == [30.0 + seed for seed in seeds]
    assert (tmp_path / "campaign.html").exists()


def performed(folder: Path, workers: int, order: Iterable[int] | None = None) -> str:
    campaign = trials_campaign(range(3), ("towel", "shirt"))
    if order is not None:
        campaign = type(campaign)(
            campaign.about, campaign.keep, tuple(campaign.requests[i] for i in order), campaign.variants
        )
    opened = CampaignFolder.create(folder, campaign, folder / "logs")
    with ThreadPoolExecutor(workers) as pool:
        perform_campaign(opened, Workers(pool, workers), lambda trial: None, logged_fold)
    return (folder / "trials.json").read_text()


def test_results_depend_on_neither_the_order_nor_the_number_of_workers(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    assert performed(tmp_path / "a", 4) == performed(tmp_path / "b", 1, reversed(range(6)))


def test_a_campaign_is_not_continued_by_another_program(tmp_path: Path) -> None:
    CampaignFolder.create(tmp_path, trials_campaign([1]), tmp_path / "logs")
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    manifest["program"]["numba"] = "0.1"
    (tmp_path / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(ConfigurationError, match=r"numba 0\.1 ->"):
        CampaignFolder.open(tmp_path).check_program()


@pytest.mark.parametrize("content", [None, "", "{}", '{"schema": 99}', '{"schema": 2, "keep": "some"}'])
def test_a_folder_without_a_sound_campaign_is_refused(content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / MANIFEST).write_text(content)
    with pytest.raises(ConfigurationError):
        CampaignFolder.open(tmp_path)
