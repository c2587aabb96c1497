"""The folder in which every random case begins: one good file of each kind that a command reads, and things that
are no such file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from foldcell.cell.campaigns.trials.campaign import Campaign, TrialRequest
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.config.calibration_file import table_text
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.cell.journal.journal import Journal
from foldcell.cell.runs.request_file import keep_request
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.support.files.paths import repository_root

KINDS: Mapping[str, str] = {
    "garment": "my_towel.yaml",
    "cell": "cell.yaml",
    "script": "script.yaml",
    "campaign": "campaign.yaml",
    "calibration": "table.yaml",
    "points": "points.json",
    "picture": "picture.png",
    "jpeg": "picture.jpg",
    "depth": "depth.png",
    "logs": "logs",
    "journal": "logs/journal.db",
    "trials": "logs/trials-1",
    "manifest": "logs/trials-1/campaign.json",
}
"""What a sample is -> its name in the folder."""
ODD = (
    "empty",
    "folder",
    "no such file",
    "no/such/folder",
    "dangling",
    "loop",
    "noise.bin",
    "zero",
    "Wäsche 衣.yaml",
)
"""Names in the folder that are no file of any kind."""


def make_samples(folder: Path) -> str:
    """Write the samples into a new folder. Returns the id of the run in its logs."""
    folder.mkdir(parents=True)
    root = repository_root()
    assert root is not None
    at = {kind: folder / name for kind, name in KINDS.items()}
    at["garment"].write_bytes(shipped_garment_path("small_towel").read_bytes())
    (folder / "Wäsche 衣.yaml").write_bytes(at["garment"].read_bytes())
    at["calibration"].write_text(table_text(-0.1), encoding="utf-8")
    at["cell"].write_text("table: {calibration: table.yaml}\ngrasp: {grip_force: 10.0}\n", encoding="utf-8")
    at["script"].write_bytes((root / "tests" / "hil" / "dropped_corner.yaml").read_bytes())
    at["campaign"].write_text(
        "about: two\ngarments: [my_towel.yaml, small_towel]\nseeds: {first: 1, count: 2}\n"
        "variants: {shipped: {}, soft: {cell: {grasp: {grip_force: 8.0}}}}\n",
        encoding="utf-8",
    )
    picture = np.random.default_rng(0).normal(170.0, 2.0, (480, 640, 3)).clip(0, 255).astype(np.uint8)
    picture[120:345, 180:480] = (60, 90, 150)
    cv2.imwrite(str(at["picture"]), picture)
    cv2.imwrite(str(at["jpeg"]), picture)
    cv2.imwrite(str(at["depth"]), np.full((480, 640), 1000, np.uint16))
    corners = {"near_left": [180, 345], "near_right": [480, 345], "far_left": [180, 120], "far_right": [480, 120]}
    at["points"].write_text(json.dumps(corners), encoding="utf-8")
    (folder / "noise.bin").write_bytes(np.random.default_rng(1).bytes(5000))
    (folder / "empty").write_bytes(b"")
    (folder / "zero").write_bytes(bytes(100))
    (folder / "folder").mkdir()
    os.symlink("no such file", folder / "dangling")
    os.symlink("loop", folder / "loop")
    return _make_logs(at["logs"], at["trials"])


def _make_logs(logs: Path, trials: Path) -> str:
    settings = load_settings()
    logs.mkdir()
    with Journal.open(logs / "journal.db") as journal:
        for status in ("folded", "not_folded"):
            run = journal.begin_run(garment="small_towel", seed=1, driver="sim", versions={"numpy": "2"})
            keep_request(run.directory, FoldRequest("small_towel", 1, "sim", settings, logs))
            run.result(run.intent(1.0, "looking", "look"), 1.5, {"event": "done"})
            run.end(status, {})
            (run.directory / "report.html").write_text("a report", encoding="utf-8")
    request = TrialRequest(
        "shipped", "small_towel", 1, "sim", "xpbd", settings.model_dump(mode="json", by_alias=True)
    )
    trials.mkdir()
    CampaignFolder.create(trials, Campaign("", "all", (request,), {"shipped": ""}), logs)
    return run.directory.name
