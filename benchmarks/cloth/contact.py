"""Benchmark of self-contact. It measures crossings, motion after the release, and strain of the edges."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import (
    MATERIAL,
    RELEASE,
    SETTLE,
    SHIRT,
    SHIRT_EDGE,
    TIMES,
    Paths,
    frames_of,
    planned_folds,
    shirt_folds,
    sides_folds,
    timed,
)
from benchmarks.cloth.strain import MOST_STRAIN, EdgeStrains, edge_strains, on_the_line
from foldcell.cell.config.garments.garment_file import list_garments
from foldcell.robots.ports import Array
from foldcell.skills.cloth.intersections.crossings import count_crossings
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.cloth.strain import TURN, reach
from foldcell.skills.vocabulary import Material

FRAMES = SolverSettings().frame_rate
AFTER = round((RELEASE + SETTLE) * FRAMES)
"""FRAMES: number of frames per second. AFTER: number of frames after the release."""
STARTS, MOVED = 6, 1e-6
"""Number of slightly different starts from which each fold is made, and standard deviation of the perturbation of
each coordinate [m]."""
TURNS = (30.0, 45.0, 60.0, 75.0, 90.0)
"""Angles that a table compares: cloth that turns by more than the angle counts as a crease [degrees]."""
VARIANTS = (
    # friction (table and layers), thickness [m], speed
    (0.3, 0.003, 1.0), (0.9, 0.003, 1.0), (0.6, 0.002, 1.0), (0.6, 0.004, 1.0), (0.6, 0.003, 2.0),
    (0.3, 0.002, 2.0), (0.9, 0.004, 2.0), (0.3, 0.004, 1.5), (0.9, 0.002, 1.5),
)  # fmt: skip


@dataclass
class Folded:
    """Results of folds, one list entry per fold.

    end: number of crossings at the end. most: largest number of crossings in a frame. residual: largest
    displacement of a vertex in the last 0.1 s of the first second after the release [m]. edges: strains at the
    end.
    """

    end: list[int] = field(default_factory=list)
    most: list[int] = field(default_factory=list)
    residual: list[float] = field(default_factory=list)
    edges: list[EdgeStrains] = field(default_factory=list)

    def add(self, other: Folded) -> None:
        for mine, others in zip(vars(self).values(), vars(other).values(), strict=True):
            mine.extend(others)

    def row(self) -> dict[str, Any]:
        """Return the maxima over the folds, as a row of a table."""
        strained = self.strained()
        del strained["edges_looked_at"]
        shown = {"end": max(self.end), "most": max(self.most), "residual_mm": 1e3 * max(self.residual)}
        return shown | strained

    def strained(self, turn: float = TURN) -> dict[str, Any]:
        """Return figures of the strains of the edges near which the cloth turns by at most `turn` [rad].

        strain_percent: largest elongation or compression. tension_percent: largest elongation.
        edges_over_5_percent: number of edges with a strain above MOST_STRAIN. edges_looked_at: number of all these
        edges.
        """
        strain = np.concatenate([edges.away(turn) for edges in self.edges])
        return {
            "strain_percent": 100.0 * float(np.abs(strain).max(initial=0.0)),
            "tension_percent": 100.0 * float(strain.max(initial=0.0)),
            "edges_over_5_percent": int((np.abs(strain) > MOST_STRAIN).sum()),
            "edges_looked_at": len(strain),
        }

    def line(self) -> str:
        """Return the maxima as one line of text, for progress messages."""
        return f"{max(self.end)} crossings at the end, {max(self.most)} on the way, " + (
            f"{1e3 * max(self.residual):.2f} mm of motion, strain {self.strained()['strain_percent']:.1f} %"
        )

    def figures(self, name: str) -> dict[str, Any]:
        strained = self.strained()
        return {
            f"{name}_end_crossings": max(self.end),
            f"{name}_max_crossings": max(self.most),
            f"{name}_residual_mm_max": 1e3 * max(self.residual),
            f"{name}_strain_percent_max": strained["strain_percent"],
            f"{name}_tension_percent_max": strained["tension_percent"],
            f"{name}_edges_over_5_percent": strained["edges_over_5_percent"],
            f"{name}_edges_looked_at": strained["edges_looked_at"],
        }


def fold_all(mesh: ClothMesh, material: Material, folds: list[Paths], start: int = 0) -> Folded:
    """Make the folds one after the other and check every frame. start: 0, or a seed with which the initial
    vertices are perturbed (standard deviation MOVED)."""
    found = Folded()
    x = mesh.lay_flat(material.thickness)
    if start > 0:
        x += MOVED * np.random.default_rng(start).standard_normal(x.shape)
    pinched: list[Array] = []
    lined = np.zeros(len(x), dtype=bool)
    for paths in folds:
        lined |= on_the_line(x, paths, reach(mesh))
        shots = list(frames_of(mesh, x, material, paths))
        pinched += [mesh.rest[np.argmin(np.linalg.norm(x - path.position[0], axis=1))] for path in paths.values()]
        x = shots[-1]
        counts = [count_crossings(shot, mesh.triangles) for shot in shots]
        found.end.append(counts[-1])
        found.most.append(max(counts))
        second = len(shots) - AFTER + FRAMES - 1  # one second after the release
        moved = shots[second] - shots[second - FRAMES // 10]
        found.residual.append(float(np.linalg.norm(moved, axis=1).max()))
        found.edges.append(edge_strains(mesh, x, np.array(pinched), lined))
    return found


def shirt(quick: bool, tell: Tell) -> dict[str, Any]:
    mesh, folds = shirt_folds()
    rest = ClothSimulation(mesh, MATERIAL)
    rest.advance(60)
    start = time.thread_time()
    rest.advance(60)
    figures: dict[str, Any] = {
        "shirt_vertices": len(mesh.rest),
        "shirt_1307_rest_x_realtime": 1.0 / (time.thread_time() - start),
    }
    speeds = _speeds(mesh, rest.positions, folds)
    figures["shirt_1307_sleeve_x_realtime"] = min(speeds[:2])
    figures["shirt_1307_hem_x_realtime"] = speeds[2]
    return figures | fold_all(mesh, MATERIAL, folds).figures("shirt")


def _speeds(mesh: ClothMesh, x: Array, folds: list[Paths]) -> list[float]:
    """Measure the speed of each fold with the fabric MATERIAL, relative to real time. The folds are made one after
    the other, the first one from x (n, 3)."""
    speeds = []
    for paths in folds:
        result, speed = timed(mesh, x, MATERIAL, paths, times=TIMES)
        x = result.vertices
        speeds.append(speed)
    return speeds


def sides(quick: bool, tell: Tell) -> dict[str, Any]:
    """Fold the shirt, each sleeve together with the side of the body."""
    mesh = mesh_from_contour(SHIRT, SHIRT_EDGE, layers=2)
    speeds = _speeds(mesh, mesh.lay_flat(MATERIAL.thickness), sides_folds())
    figures: dict[str, Any] = {"sides_x_realtime": min(speeds[:2]), "sides_hem_x_realtime": speeds[2]}
    return figures | fold_all(mesh, MATERIAL, sides_folds()).figures("sides")


def starts(quick: bool, tell: Tell) -> dict[str, Any]:
    """Fold the two-layer shirt and all shipped garments, each from slightly different starts.

    The spread of the results shows how much of a garment's figures is chance. The figures count the folds that end
    with crossings, that have more than five crossings in a frame, or that are not at rest.
    """
    mesh, folds = shirt_folds()
    rows: list[dict[str, Any]] = []
    for name in ["shirt", *list_garments()][: 2 if quick else None]:
        scene = (mesh, MATERIAL, folds) if name == "shirt" else planned_folds(name)
        found = Folded()
        for start in range(2 if quick else STARTS):
            found.add(fold_all(*scene, start))
            tell(f"{name}, start {start + 1}: {found.line()} so far")
        rows.append({
            "garment": name, "folds": len(found.end), "end_crossed": sum(n > 0 for n in found.end),
            "crossed_over_5": sum(n > 5 for n in found.most), "not_at_rest": sum(r > 5e-4 for r in found.residual),
            "residual_mm_median": 1e3 * float(np.median(found.residual)),
            "residual_mm_max": 1e3 * max(found.residual), "strain_percent_max": found.strained()["strain_percent"],
            "tension_percent_max": found.strained()["tension_percent"],
        })  # fmt: skip
    counted = ("folds", "end_crossed", "crossed_over_5", "not_at_rest")
    return {f"starts_{key}": sum(row[key] for row in rows) for key in counted} | {"starts": rows}


def variants(quick: bool, tell: Tell) -> dict[str, Any]:
    """Fold shirt and pants with other friction, thickness and speed. Return the worst figures and a row per
    case."""
    rows, worst = [], Folded()
    for name, (mu, thickness, speed), mesh, material, folds in _scenes(2 if quick else len(VARIANTS)):
        found = fold_all(mesh, material, folds)
        worst.add(found)
        case = {"garment": name, "friction": mu, "thickness_mm": 1e3 * thickness, "speed": speed}
        rows.append(case | found.row())
        tell(f"{name}, friction {mu}, {1e3 * thickness:.0f} mm, speed x{speed:g}: {found.line()}")
    figures = worst.figures("variants")
    figures["variants_folds"] = len(worst.end)
    figures["variants_folds_that_end_with_crossings"] = sum(n > 0 for n in worst.end)
    figures["variants_folds_not_at_rest"] = sum(r > 5e-4 for r in worst.residual)
    by_turn = [{"turn_degrees": turn} | worst.strained(np.deg2rad(turn)) for turn in TURNS]
    return figures | {"variants": rows, "variants_by_turn": by_turn}


def _scenes(
    count: int,
) -> Iterator[tuple[str, tuple[float, float, float], ClothMesh, Material, list[Paths]]]:
    for mu, thickness, speed in VARIANTS[:count]:
        made = {"thickness": thickness, "friction_static": mu, "friction_dynamic": mu, "friction_layers": mu}
        material = replace(MATERIAL, **made)
        mesh, folds = shirt_folds(material, speed)
        yield "shirt", (mu, thickness, speed), mesh, material, folds
        yield "pants", (mu, thickness, speed), *planned_folds("pants", speed, **made)
