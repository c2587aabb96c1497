"""`foldcell.export` writes the folds of one garment, each once, or nothing."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import foldcell
from foldcell.robots.errors import Failure, FailureKind


def fold(garment: str = "towel", name: str = "half", arcs: bool = True) -> foldcell.OptimisedFold:
    poses = {"left": np.column_stack([np.linspace(0.0, 1.0, 5), np.zeros((5, 6)), np.ones(5)])} if arcs else {}
    failure = None if arcs else Failure(FailureKind.UNREACHABLE, "too far", "nearer")
    return foldcell.OptimisedFold(
        garment, name, 1, "default", {}, poses, 1.0, 0.02, 0.02, 0.01, 1, 0, failure
    )  # fmt: skip


def test_every_row_of_every_fold_is_written(tmp_path: Path) -> None:
    file = foldcell.export([fold(), fold(name="quarter"), fold(name="third", arcs=False)], tmp_path / "a.csv")
    foldcell.export([fold(), fold(name="quarter")], file)  # an export is replaced
    rows = list(csv.DictReader(file.open(encoding="utf-8")))
    assert [row["fold"] for row in rows] == ["half"] * 5 + ["quarter"] * 5


@pytest.mark.parametrize(
    ("folds", "words"),
    [
        ([fold("shirt"), fold("towel")], "they are of shirt, towel"),
        ([fold("shirt"), fold("towel", "quarter", arcs=False)], "they are of shirt, towel"),
        ([fold(), fold()], "one is there twice"),
        ([], "none has an arc"),
        ([fold(arcs=False)], "none has an arc"),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".json", ".yaml"])
def test_mixtures_and_nothing_are_refused(
    tmp_path: Path, folds: list[foldcell.OptimisedFold], words: str, suffix: str
) -> None:
    with pytest.raises(foldcell.ConfigurationError, match=words):
        foldcell.export(folds, tmp_path / f"poses{suffix}")
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_export_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "towel.yaml"
    file.write_text("title: my towel\n", encoding="utf-8")
    with pytest.raises(foldcell.ConfigurationError, match="was not made"):
        foldcell.export([fold()], file)
    assert file.read_text(encoding="utf-8") == "title: my towel\n"
