"""Known folds under the claim: what the executive is shown, and what the results page counts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.claim_matrix import false_claims, page
from benchmarks.claims.stage import Stage, judge_shown, open_stage
from benchmarks.claims.verdicts import Verdict, caught_by
from benchmarks.score_matrix import in_own_frame
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.vocabulary import Array
from tests.inspections import a_claim

TOWEL = "small_towel"


@pytest.fixture(scope="module")
def towel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stage, Array]]:
    """A towel after its first fold, before the last one, and the exact last fold in the towel's own frame."""
    with open_stage(TOWEL, 7, tmp_path_factory.mktemp("claims")) as stage:
        garment = in_own_frame(stage.world.garment)
        lines = ways_to_fold(load_garment(TOWEL), garment.keypoints)[0]
        stage.recognise()
        for k in range(len(lines)):
            stage.predict()
            exact = target_vertices(garment.mesh, lines[: k + 1], garment.fabric)
            if k + 1 < len(lines):
                stage.accept(stage.show(exact))
        yield stage, exact


def claimed(towel: tuple[Stage, Array], moved: Array | float = 0.0) -> Any:
    stage, exact = towel
    judged, _ = judge_shown(stage.cell, stage.show(exact + moved))
    return judged.fold.attempt.claim


def test_an_exact_fold_is_claimed(towel: tuple[Stage, Array]) -> None:
    claim = claimed(towel)
    assert claim.holds, claim.says


def test_the_height_that_the_executive_sees_is_that_of_the_shape(towel: tuple[Stage, Array]) -> None:
    exact = towel[1]
    top = float(np.quantile(exact[:, 2], 0.9))
    assert claimed(towel).height_m == pytest.approx(top, abs=0.002)
    assert claimed(towel, np.array([0.0, 0.0, 0.02])).height_m == pytest.approx(top + 0.02, abs=0.002)


def test_a_fold_that_was_displaced_is_not_claimed(towel: tuple[Stage, Array]) -> None:
    claim = claimed(towel, np.array([0.06, 0.0, 0.0]))
    assert not claim.shape and claim.drift_m == pytest.approx(0.06, abs=0.006)


def test_no_shape_that_is_shown_changes_what_the_stage_knows(towel: tuple[Stage, Array]) -> None:
    stage, exact = towel
    before = stage.context
    stage.show(exact)
    assert stage.context is before


def verdict(**changes: Any) -> Verdict:
    good: dict[str, Any] = {
        "garment": TOWEL, "seed": 1, "kind": "ideal", "variant": 0, "bad": (), "claim": a_claim(),
        "diagnosis": None, "says": "folded as planned", "figures": {},
    }  # fmt: skip
    return Verdict(**good | changes)


def test_a_claim_is_false_only_if_the_score_fails_the_fold() -> None:
    good, lie = verdict(), verdict(kind="sag", bad=("edges_m",))
    seen = verdict(kind="sag", bad=("edges_m",), claim=a_claim(shape=False), diagnosis="sag")
    assert false_claims([good, lie, seen]) == [lie]
    text = page([good, lie, seen], ["vest 3: no picture"], "command")
    assert "- False claims: 1 of 2" in text and "- Ideal folds not claimed: 0 of 1" in text
    assert "| sag | 1 of 2 |" in text and "- small_towel 1, sag 0: fails edges_m" in text
    assert "vest 3: no picture" in text


def test_a_good_ideal_fold_that_is_not_claimed_is_listed() -> None:
    text = page([verdict(claim=a_claim(flat=False), says="it stands high")], [], "command")
    assert "- Ideal folds not claimed: 1 of 1" in text and "ideal 0: it stands high" in text


@pytest.mark.parametrize(
    ("changes", "diagnosis", "names"),
    [
        ({}, None, ()),
        ({"shape": False, "target_iou": 0.8}, None, ("overlap",)),
        ({"shape": False, "drift_m": 0.06}, "drift", ("drift",)),
        ({"flat": False, "height_m": 0.03}, "piling", ("piling", "height")),
        ({"flat": False, "crease_height_m": 0.05}, None, ("crease height",)),
        ({"shape": False}, "sag", ("sag",)),
    ],
)
def test_what_found_a_bad_fold_is_named(
    changes: dict[str, Any], diagnosis: str | None, names: tuple[str, ...]
) -> None:
    assert caught_by(verdict(claim=a_claim(**changes), diagnosis=diagnosis)) == names
    assert caught_by(verdict(claim=None)) == ("not visible",)


def test_pictures_are_kept_in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second call reads the record; nothing is folded again."""
    import benchmarks.claims.record as record

    made = []
    monkeypatch.setattr(record, "_record", lambda *args: made.append(args[:2]) or {"garment": args[0]})
    monkeypatch.setattr(record, "open_stage", _NoStage)
    first, second = (record.recorded(TOWEL, 7, tmp_path) for _ in range(2))
    assert first == second and made == [(TOWEL, 7)]


class _NoStage:
    def __init__(self, *args: Any) -> None: ...

    def __enter__(self) -> None: ...

    def __exit__(self, *args: object) -> None: ...
