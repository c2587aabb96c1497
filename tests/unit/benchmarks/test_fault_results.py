"""The page of injected faults counts only runs whose fault happened, and names all that did not end as due."""

from __future__ import annotations

from benchmarks.fault_results import CAUSES, FaultRun, page

RUNS = (
    FaultRun("slip", "small_towel", 7, True, True, "recovered", "folded"),
    FaultRun("slip", "small_towel", 8, False, True, "asked", "off_target: 9 degrees | more"),
    FaultRun("missed_grasp", "small_towel", 7, True, False, "recovered", "folded"),
    FaultRun("stop_flaps", "small_towel", 7, True, True, "safe", "stopped"),
)


def rows(text: str, title: str) -> list[list[str]]:
    section = text.split(f"## {title}\n")[1].split("\n## ")[0]
    return [[c.strip() for c in line.strip("| ").split("|")] for line in section.splitlines() if "|" in line][2:]


def test_only_runs_whose_fault_happened_are_counted() -> None:
    text = page(RUNS, ["abc"], "2026-01-02")
    assert [row[:2] for row in rows(text, "Ended as due")] == [
        ["small_towel 7", "1 of 1 (21 to 100 %)"],
        ["small_towel 8", "0 of 1 (0 to 79 %)"],
        ["all", "1 of 2 (9 to 91 %)"],
    ]
    by_fault = {row[0]: row[1:] for row in rows(text, "By fault")}
    assert by_fault["slip"] == ["recovered", "1 of 1", "0 of 1"] and by_fault["missed grasp"][1] == "-"
    assert by_fault["stop flaps"][:2] == ["safe", "1 of 1"] and len(by_fault) == 3


def test_every_run_that_did_not_end_as_due_is_named_and_written_causes_stay() -> None:
    text = page(RUNS, ["abc", "abc", "def"], "2026-01-02", "The garment turned.\n")
    (named,) = rows(text, "Runs that did not end as due")
    assert named == ["slip", "small_towel 8", "asked", "off_target: 9 degrees / more"]
    assert "commit abc, def," in text and text.endswith(f"{CAUSES}\nThe garment turned.\n")
