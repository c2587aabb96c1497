"""Comparison of two journals of one run, without wall-clock times and paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from foldcell.cell.journal.journal import Entry
from foldcell.cell.runs.decide_again import changed_versions, first_difference


def line(
    sequence: int, kind: str, name: str, state: str = "looking", answers: int | None = None, **payload: Any
) -> Entry:
    return Entry(sequence, 0.5 * sequence, 1e9 + sequence, state, kind, name, answers, {"schema": 1, **payload})


THEN = [
    line(1, "event", "start", **{"from": "idle"}),
    line(2, "intent", "look", step=0),
    line(3, "result", "look", answers=2, event="done", wall={"segment_s": 0.1}, seen={"iou": 0.9, "sag_m": 0.01}),
    line(4, "event", "paused", path_s=1.0),
    line(5, "event", "done", "recognising", **{"from": "looking"}),
]  # fmt: skip


def other(at: int, **changes: Any) -> list[Entry]:
    return [*THEN[:at], replace(THEN[at], **changes), *THEN[at + 1 :]]


def test_equal_entries_agree_at_any_wall_time() -> None:
    payload = {**THEN[2].payload, "wall": {"segment_s": 7.0}}
    assert first_difference(THEN, [replace(e, wall_time=2e9) for e in other(2, payload=payload)]) is None


def test_a_different_figure_is_named() -> None:
    found = first_difference(THEN, other(2, payload={**THEN[2].payload, "seen": {"iou": 0.8, "sag_m": 0.01}}))
    assert found is not None and found[0] == 2
    there = found[1]
    assert (there.cell_time_s, there.place, there.state, there.effect) == (
        1.5,
        "line 3 of the journal",
        "looking",
        "look",
    )
    assert (there.then, there.now) == ("look ends: done (seen.iou 0.9)", "look ends: done (seen.iou 0.8)")


def test_a_different_failure_is_reported_with_its_message() -> None:
    failed = {"schema": 1, "event": "failed", "kind": "no_garment", "what": "the table is empty", "hint": "look"}
    found = first_difference(THEN, other(2, payload=failed))
    assert found is not None and found[1].now == "look ends: failed, no_garment: the table is empty"


def test_a_different_transition_between_effects_is_reported() -> None:
    found = first_difference(THEN, other(4, name="failed", state="recovering"))
    assert found is not None
    there = found[1]
    assert (there.state, there.effect) == ("looking", None)
    assert (there.then, there.now) == ("done -> recognising", "failed -> recovering")


def test_a_difference_within_an_effect_names_the_effect() -> None:
    found = first_difference(THEN, other(3, name="resumed"))
    assert found is not None and (found[1].effect, found[1].then, found[1].now) == ("look", "paused", "resumed")


def test_a_different_cell_time_is_reported() -> None:
    found = first_difference(THEN, other(1, cell_time=1.25))
    assert found is not None and (found[1].then, found[1].now) == (
        "look begins (cell time 1.0)", "look begins (cell time 1.25)",
    )  # fmt: skip


def test_missing_entries_are_reported_only_for_complete_journals() -> None:
    assert first_difference(THEN, THEN[:3], whole=False) is None
    assert first_difference(THEN[:3], THEN, whole=False) is None
    shorter, longer = first_difference(THEN, THEN[:3]), first_difference(THEN[:3], THEN)
    assert shorter is not None and shorter[1].now == "nothing: the run was over"
    assert longer is not None and longer[1].then == "nothing: the run was over"


def test_changed_versions_are_named() -> None:
    changed = changed_versions({"numpy": "0.0.1", "no-such-package": "2"})
    assert changed["numpy"][0] == "0.0.1" and changed["numpy"][1] != "0.0.1"
    assert changed["no-such-package"] == ("2", "not installed")
    assert changed_versions({}) == {}
