"""Refines the time step: measures accuracy and cost over the number of substeps per frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import (
    MATERIAL,
    RELEASE,
    SETTLE,
    Paths,
    planned_folds,
    seconds_of,
    shirt_folds,
    towel_half,
    towel_mesh,
    towel_quarter,
)
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.cloth.settings import SolverSettings, choose_substeps
from foldcell.skills.vocabulary import Material

SUBSTEPS = (8, 12, 16, 24, 32)
FINEST = 48


def substeps(quick: bool, tell: Tell) -> dict[str, Any]:
    """Simulate each fold with several numbers of substeps.

    Every fold starts from the end of the finest simulation of the earlier folds, so that errors do not add up.
    Figures of each number: mean distance of the vertices from the finest simulation [mm], and simulated seconds
    over CPU seconds. chosen: the number of substeps that the solver chooses; with fewer, the cloth stretches too
    much.
    """
    counts = SUBSTEPS[1:3] if quick else SUBSTEPS
    rows = []
    for name, mesh, material, folds in _scenes(quick):
        x = mesh.lay_flat(material.thickness)
        chosen = choose_substeps(mesh, material, SolverSettings())
        for number, paths in enumerate(folds, 1):
            row: dict[str, Any] = {"garment": name, "fold": number, "chosen": chosen}
            finest = _end(mesh, x, material, paths, FINEST)
            for n in counts:
                start = time.thread_time()
                end = _end(mesh, x, material, paths, n)
                row[f"x_realtime_{n}"] = seconds_of(paths) / (time.thread_time() - start)
                row[f"off_mm_{n}"] = 1e3 * float(np.linalg.norm(end - finest, axis=1).mean())
            rows.append(row)
            off = ", ".join(f"{row[f'off_mm_{n}']:.2f} mm with {n}" for n in counts)
            tell(f"{name}, fold {number}: {off}")
            x = finest
    return {"substeps_folds": rows}


def _end(mesh: ClothMesh, x: Array, material: Material, paths: Paths, count: int) -> Array:
    return predict_fold(mesh, x, material, paths, RELEASE, SETTLE, SolverSettings(substeps=count)).vertices


def _scenes(quick: bool) -> Iterator[tuple[str, ClothMesh, Material, list[Paths]]]:
    mesh, material = towel_mesh(425)
    yield "towel", mesh, material, [towel_half(), towel_quarter()]
    if not quick:
        mesh, folds = shirt_folds()
        yield "shirt", mesh, MATERIAL, folds
        yield ("pants", *planned_folds("pants"))
