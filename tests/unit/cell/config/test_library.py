"""Library files: they are written completely or not at all, user entries take precedence, and damage stays
local."""

from __future__ import annotations

import errno
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import foldcell.cell.config.trajectory_library.library_file as files
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import (
    add_entry,
    load_library,
    shipped_library_path,
    user_library_path,
    write_library,
)
from foldcell.cell.planning.trajectory_library_build import build_library
from foldcell.robots.errors import StorageError
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.trajectory_library import (
    Library,
    LibraryEntry,
    from_json,
    lookup,
    to_json,
    trajectory_from,
)

TOWELS = ("small_towel", "medium_towel", "large_towel")
TOWEL = load_garment("medium_towel")


def perfect(mesh, positions, material, paths, /):  # type: ignore[no-untyped-def]
    """A stand-in simulation: any arc gives the target shape, 3 mm too high."""
    state = TOWEL.flat_state(*TOWEL.poses.middle)
    steps = plan_folds(state, TOWEL).unwrap()
    start = next(iter(paths.values())).position[0, :2]
    step = next(s for s in steps if any(np.allclose(g.point, start) for g in s.grasps.values()))
    return target_vertices(mesh, step.lines, material) + np.array([0, 0, 0.003])


@pytest.fixture(scope="module")
def built() -> Library:
    with ThreadPoolExecutor(1) as pool:
        return build_library([TOWEL], method="initial", predict=perfect, executor=pool)


def test_user_entries_take_precedence_and_accumulate(tmp_path: Path, built: Library) -> None:
    shipped = load_library().library
    half, quarter = built.entries
    add_entry(tmp_path, half)
    add_entry(tmp_path, quarter)
    add_entry(tmp_path, replace(half, simulations=99))
    loaded = load_library(tmp_path)
    assert not loaded.refused
    assert len(loaded.library.entries) == 2 + len(shipped.entries)
    found = lookup(loaded.library, "towel", "half", TOWEL.material, TOWEL.size_m)
    assert found is not None and found.simulations == 99


def test_concurrent_additions_lose_no_entry(tmp_path: Path, built: Library) -> None:
    """This happens when a run ends while a build writes its results."""
    begin = threading.Barrier(2)

    def add(who: str) -> None:
        begin.wait()
        for k in range(8):
            add_entry(tmp_path, replace(built.entries[0], garment=f"{who}{k}"))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(add, ("a", "b")))
    library, refused = from_json(user_library_path(tmp_path).read_text())
    assert not refused and len(library.entries) == 16


def test_a_failed_write_leaves_no_partial_file(
    tmp_path: Path, built: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = user_library_path(tmp_path)
    write_library(path, built)
    before = path.read_bytes()

    def full(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(StorageError, match="No space left"):
        write_library(path, Library())
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == [path.name]


def test_a_folder_that_is_a_file_is_a_storage_error(tmp_path: Path, built: Library) -> None:
    (tmp_path / "logs").write_text("")
    with pytest.raises(StorageError) as caught:
        add_entry(tmp_path / "logs", built.entries[0])
    assert "--logs" in str(caught.value)


def test_a_folder_that_may_not_be_read_is_a_storage_error(
    tmp_path: Path, built: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lock file is in this folder. A run continues without the entry."""
    monkeypatch.setattr(
        "foldcell.cell.config.trajectory_library.library_file.os.open",
        Mock(side_effect=PermissionError(errno.EACCES, "Permission denied")),
    )
    with pytest.raises(StorageError, match="cannot be read: Permission denied"):
        add_entry(tmp_path, built.entries[0])


def test_a_broken_file_is_refused_by_name_and_renamed_instead_of_overwritten(
    tmp_path: Path, built: Library
) -> None:
    path = user_library_path(tmp_path)
    path.write_text("{ broken")
    loaded = load_library(tmp_path)
    assert [p for p, _ in loaded.refused] == [path] and "JSON" in loaded.refused[0][1].reason
    assert len(loaded.library.entries) == len(load_library().library.entries)
    add_entry(tmp_path, built.entries[0])
    assert (tmp_path / "library.json.refused").read_text() == "{ broken"
    assert not load_library(tmp_path).refused
    path.write_text("broken again")
    add_entry(tmp_path, built.entries[0])
    assert (tmp_path / "library.json.refused").read_text() == "{ broken"
    assert (tmp_path / "library.json.refused-2").read_text() == "broken again"


def test_a_damaged_entry_does_not_affect_the_others(tmp_path: Path, built: Library) -> None:
    path = user_library_path(tmp_path)
    path.write_text(to_json(built).replace('"method": "initial"', '"method": "default"', 1))
    loaded = load_library(tmp_path)
    assert len(loaded.refused) == 1 and loaded.refused[0][1].index == 0
    assert built.entries[1].step in [e.step for e in loaded.library.entries if e.garment == "medium_towel"]


@pytest.mark.parametrize("name", TOWELS)
def test_the_shipped_library_has_every_towel_step(name: str) -> None:
    """Shipped entries are complete, belong to the present garment files, and give good folds."""
    library, refused = from_json(shipped_library_path().read_text())
    assert not refused
    garment = load_garment(name)
    for step in plan_folds(garment.flat_state(*garment.poses.middle), garment).unwrap():
        entry = lookup(library, garment.category, step.name, garment.material, garment.size_m)
        assert isinstance(entry, LibraryEntry) and entry.garment == name
        assert entry.material == garment.material and entry.size_m == pytest.approx(garment.size_m)
        diagonal = float(np.hypot(*garment.size_m))
        # A shorter arc may have a slightly larger D, because the objective weighs both.
        assert entry.dissimilarity <= entry.dissimilarity_initial + 5e-4
        assert entry.dissimilarity < 0.025 * diagonal
        found = trajectory_from(entry, step, garment.material.thickness)
        assert found is not None
        assert all(np.isfinite(c).all() and c[:, 2].min() >= 0 for c in found.control_points.values())
