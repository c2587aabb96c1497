"""Differences between two runs of the journal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from foldcell.cell.journal.journal import Journal
from foldcell.cell.runs.run_difference import Decision, RunDifference, run_difference

Effects = Sequence[tuple[str, str]]


def difference(tmp_path: Path, runs: Sequence[tuple[int, Effects, dict[str, Any], str]]) -> RunDifference:
    """runs: seed, (effect, event) of each decision, result, settings."""
    with Journal.open(tmp_path / "journal.db") as journal:
        found = []
        for seed, effects, result, settings in runs:
            run = journal.begin_run(
                garment="towel", seed=seed, driver="sim", settings_hash="x", versions={"numpy": str(seed)}
            )
            (run.directory / "cell.yaml").write_text(settings)
            for t, (effect, event) in enumerate(effects):
                intent = run.intent(float(t), "folding", effect, {"step": 0})
                run.result(intent, float(t) + 0.5, {"event": event})
            run.end("folded", result)
            record = journal.run(run.id)
            found += [record, journal.entries(record.id)]
        a, a_entries, b, b_entries = found
        return run_difference(a, a_entries, b, b_entries)


def test_only_what_differs_is_named(tmp_path: Path) -> None:
    same = [("look", "done"), ("grasp", "done")]
    found = difference(
        tmp_path,
        [
            (1, [*same, ("lift", "done"), ("fold", "done")],
             {"robot_time_s": 30.0, "wall_time_s": 1.0, "score": {"iou": 0.9, "passed": True}},
             "grasp: {grip_force: 15.0}\n"),
            (2, [*same, ("lift", "failed")],
             {"robot_time_s": 31.0, "wall_time_s": 9.0, "score": {"iou": 0.9, "passed": False}},
             "grasp: {grip_force: 20.0}\n"),
        ],
    )  # fmt: skip
    assert [(d.name, d.first, d.second) for d in found.settings] == [
        ("seed", 1, 2), ("grasp.grip_force", 15.0, 20.0)
    ]  # fmt: skip
    assert [d.name for d in found.versions] == ["numpy"]
    assert {d.name for d in found.figures} == {"robot_time_s", "score.passed"}
    assert found.alike == 2
    assert found.then == (
        Decision("lift", "folding", 0, "done", None),
        Decision("lift", "folding", 0, "failed", None),
    )


def test_a_run_that_ends_earlier_differs_where_it_ends(tmp_path: Path) -> None:
    found = difference(
        tmp_path, [(1, [("look", "done")], {}, ""), (1, [("look", "done"), ("fold", "done")], {}, "")]
    )
    assert found.alike == 1 and found.then is not None
    assert found.then[0] is None and str(found.then[1]) == "fold in folding of fold 1: done"


def test_a_repeated_run_differs_in_nothing(tmp_path: Path) -> None:
    runs = [(1, [("look", "done")], {"score": {"iou": 0.9}}, "a: 1\n")] * 2
    found = difference(tmp_path, runs)
    assert found == RunDifference((), (), 1, None, ())
