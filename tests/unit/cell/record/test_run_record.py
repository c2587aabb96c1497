"""The record of a run: written, read back, and refused if it is damaged."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from foldcell.cell.record.run_record import (
    RECORD,
    FailureRecord,
    FoldRecord,
    GraspRecord,
    Recognised,
    RecordingLosses,
    RunEvent,
    RunRecord,
    read_record,
    record_of,
    write_record,
)
from foldcell.cell.states.transition_table import State
from foldcell.robots.errors import FailureKind, StorageError
from tests.builders.records import run_record, score_record
from tests.inspections import a_claim


@pytest.fixture
def full(tmp_path: Path) -> RunRecord:
    """A record with every part."""
    return run_record(
        result="not_folded",
        state=State.NOT_FOLDED,
        failure=FailureRecord(FailureKind.TOO_HIGH, "it stands 31 mm high", "press it", "inspection.height 0.02"),
        score=score_record({"iou": 0.9}, iou=0.94, flat=None),
        steps=(
            FoldRecord(
                "half",
                done=True,
                pressed_from_m=(0.03, None),
                recoveries=("slipped -> look_again",),
                grasps=(
                    GraspRecord(2.0, "left", 0.004, "tip", 0.2, 0.001, 0, FailureKind.MISSED_GRASP),
                    GraspRecord(9.0, "left", 0.004, "tip", 1.8, 0.0034, 2),
                ),
            ),
        ),
        stage_times_s={"looking": 1.5},
        recording=RecordingLosses(dropped=2, errors=("disk full",)),
        claim=a_claim(crease_height_m=0.02),
        recognised=Recognised("medium_towel", 0.93),
        events=(RunEvent(3.0, "failure", "slipped while folding", "the left hand lost the cloth"),),
        run_dir=str(tmp_path),
        signal=15,
    )


def test_a_record_is_read_back_as_it_was_written(full: RunRecord) -> None:
    write_record(full)
    assert read_record(Path(full.run_dir)) == full == record_of(full.as_json())
    assert json.loads((Path(full.run_dir) / RECORD).read_text()) == full.as_json()


def test_a_record_without_grasps_is_read_as_before(full: RunRecord) -> None:
    values = full.as_json()
    del values["steps"][0]["grasps"]
    assert record_of(values) == replace(full, steps=(replace(full.steps[0], grasps=()),))


def test_a_height_that_was_not_visible_is_null_in_the_file(full: RunRecord) -> None:
    unseen = replace(full, claim=a_claim(crease_height_m=math.nan))
    write_record(unseen)
    assert json.loads((Path(full.run_dir) / RECORD).read_text())["claim"]["crease_height_m"] is None
    read = read_record(Path(full.run_dir))
    assert read.claim is not None and math.isnan(read.claim.crease_height_m)


def test_a_damaged_or_missing_record_is_refused(full: RunRecord, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No such file"):
        read_record(tmp_path)
    write_record(full)
    text = (tmp_path / RECORD).read_text()
    for damaged in (text[:-20], text.replace('"not_folded"', '"lost"')):
        (tmp_path / RECORD).write_text(damaged)
        with pytest.raises(StorageError, match="of its values"):
            read_record(tmp_path)


@pytest.mark.parametrize("values", [None, {}, {"reason": {"what": "no camera"}}, {"result": "done"}, ["folded"]])
def test_what_is_no_record_of_a_run_gives_none(values: object) -> None:
    assert record_of(values) is None


def test_a_figure_that_is_not_known_does_not_pass() -> None:
    score = score_record({"iou": 0.9, "edges_m": 0.03, "height_m": 0.02}, iou=0.91, height_m=0.021)
    assert score.failed == ("edges_m", "height_m")
