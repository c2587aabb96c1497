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
DONE = {"event": "done", "held": {"left": {"layers": 2, "planned": 2}, "right": {"layers": 1, "planned": 1}}}
PLEAT = {"event": "done", "held": {"left": {"layers": 2, "planned": 2}, "right": {"layers": 2, "planned": 1}}}
GRASPS = {
    "held": ((0, "grasp", DONE), (0, "lift", DONE), (1, "grasp", DONE), (1, "lift", DONE)),
    "second try": ((0, "grasp", MISSED), (0, "grasp", DONE), (0, "lift", DONE)),
    "lost in the lift": ((0, "grasp", DONE), (0, "lift", LOST), (0, "grasp", DONE), (0, "lift", DONE)),
    "a pleat": ((0, "grasp", PLEAT), (0, "lift", DONE), (1, "grasp", DONE), (1, "lift", DONE)),
    "a pleat that slips": ((0, "grasp", PLEAT), (0, "lift", LOST), (0, "grasp", PLEAT), (0, "lift", DONE)),
    "stopped": ((0, "grasp", STOPPED),),
}


@pytest.mark.parametrize(
    ("made", "found"),
    [
        ("held", [("half", 1, "", False), ("quarter", 1, "", False)]),
        ("second try", [("half", 2, MISSED["what"], False)]),
        ("lost in the lift", [("half", 2, LOST["what"], False)]),
        ("a pleat", [("half", 1, "", True), ("quarter", 1, "", False)]),
        ("a pleat that slips", [("half", 2, LOST["what"], False)]),
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
    assert [(g.fold, g.tries, g.what, g.more) for g in grasps] == found
    text = page(grasps, "today")
    held, more = sum(not what for _, _, what, _ in found), sum(more for *_, more in found)
    assert f"| all |  | {held} of {len(found)} |" in text and all(what in text for _, _, what, _ in found)
    assert next(line for line in text.splitlines() if line.startswith("| all")).endswith(f"| {more} |")
