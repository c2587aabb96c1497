"""The page of first grasps counts the first grasp of each fold, read from a run's journal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.grasp_results import page, read_grasps
from foldcell.cell.journal.journal import Journal

MISSED = {"event": "failed", "kind": "missed_grasp", "what": "the left hand holds 2 layers, not 4"}
LOST = {"event": "failed", "kind": "missed_grasp", "what": "the left hand lost the cloth while lifting it"}
STOPPED = {"event": "failed", "kind": "stopped", "what": "the button"}
DONE = {"event": "done"}
GRASPS = {
    "held": ((0, "grasp", DONE), (0, "lift", DONE), (1, "grasp", DONE), (1, "lift", DONE)),
    "second try": ((0, "grasp", MISSED), (0, "grasp", DONE), (0, "lift", DONE)),
    "lost in the lift": ((0, "grasp", DONE), (0, "lift", LOST), (0, "grasp", DONE), (0, "lift", DONE)),
    "stopped": ((0, "grasp", STOPPED),),
}


@pytest.mark.parametrize(
    ("made", "found"),
    [
        ("held", [("half", 1, ""), ("quarter", 1, "")]),
        ("second try", [("half", 2, MISSED["what"])]),
        ("lost in the lift", [("half", 2, LOST["what"])]),
        ("stopped", []),
    ],
)
def test_the_first_grasp_of_a_fold_counts(made: str, found: list[Any], tmp_path: Path) -> None:
    with Journal.open(tmp_path / "journal.db") as journal:
        run = journal.begin_run(garment="small_towel", seed=7, driver="sim")
        intent = run.intent(0.0, "planning", "plan_folds")
        run.result(intent, 0.1, {"event": "done", "steps": ["half", "quarter"]})
        for fold, effect, outcome in GRASPS[made]:
            run.result(run.intent(1.0, effect, effect, {"step": fold}), 2.0, outcome)
        run.end("folded", {})
    grasps = list(read_grasps(tmp_path))
    assert [(g.fold, g.tries, g.what) for g in grasps] == found
    text = page(grasps, "today")
    held = sum(not what for _, _, what in found)
    assert f"| all |  | {held} of {len(found)} |" in text and all(what in text for _, _, what in found)
