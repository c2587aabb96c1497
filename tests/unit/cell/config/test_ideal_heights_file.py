"""The file with the heights of ideal folds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.config.trajectory_library.ideal_heights_file import (
    ideal_heights_of,
    put_ideal_heights,
)
from foldcell.cell.config.trajectory_library.library_file import user_heights_path
from foldcell.skills.fold_plan.ideal_heights import IdealFoldHeights, bending_lengths, ideal_fold_heights

TOWEL = load_garment("small_towel")
HEIGHTS = tuple(IdealFoldHeights(0.01 * k, 0.011 * k, 0.02 * k, 0.015 * k) for k in (1, 2, 3))


def test_heights_are_found_for_the_garment_they_were_computed_for_only(tmp_path: Path) -> None:
    library = tmp_path / "library.json"
    put_ideal_heights(user_heights_path(library), TOWEL, HEIGHTS)
    put_ideal_heights(user_heights_path(library), load_garment("vest"), HEIGHTS[:2])
    assert ideal_heights_of(TOWEL, library) == HEIGHTS
    thicker = replace(TOWEL, name="mine", material=replace(TOWEL.material, thickness=0.004))
    assert ideal_heights_of(thicker, library) == ()
    assert ideal_heights_of(replace(thicker, name="small_towel"), library) == ()


@pytest.mark.parametrize(
    "text", ["{ broken", "[]", '{"schema": 99, "garments": {}}', '{"schema": 1, "garments": 3}']
)
def test_an_unreadable_file_counts_as_empty(tmp_path: Path, text: str) -> None:
    library = tmp_path / "library.json"
    user_heights_path(library).write_text(text)
    assert ideal_heights_of(replace(TOWEL, name="mine"), library) == ()


@pytest.mark.parametrize("spoil", [{"heights": 3}, {"heights": [{"height": 0.01}]}, {"of": None}, None])
def test_a_damaged_entry_counts_as_missing(tmp_path: Path, spoil: dict | None) -> None:
    library, mine = tmp_path / "library.json", replace(TOWEL, name="mine")
    put_ideal_heights(user_heights_path(library), mine, HEIGHTS)
    data = json.loads(user_heights_path(library).read_text())
    data["garments"]["mine"] = None if spoil is None else data["garments"]["mine"] | spoil
    user_heights_path(library).write_text(json.dumps(data))
    assert ideal_heights_of(mine, library) == ()


@pytest.mark.parametrize("name", list_garments())
def test_every_shipped_garment_has_heights_over_the_range_of_its_fabric(name: str) -> None:
    garment = load_garment(name)
    heights = ideal_heights_of(garment)
    assert [h.bending_length for h in heights] == pytest.approx(bending_lengths(garment), abs=1e-6)
    first = [h.first_crease for h in heights]
    assert np.all(np.diff(first) > 0.0), "stiffer cloth has higher creases"


def test_a_towels_first_crease_is_about_as_high_as_a_free_fold() -> None:
    """One layer, folded once: 0.907 bending lengths of its direction, less what bending friction keeps."""
    assert TOWEL.fabric is not None
    heights = ideal_fold_heights(TOWEL, 0.017)
    stiffest = 0.017 * np.prod(TOWEL.fabric.bending_ratio) ** (1 / 12)  # along the warp
    assert 0.6 * 0.017 < heights.first_crease - TOWEL.material.thickness < 1.1 * 0.907 * stiffest
