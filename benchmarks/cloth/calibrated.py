"""Tests the calibration procedures on the paper's garments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from foldcell.calibration.friction import calibrate_friction
from foldcell.calibration.identify import identify_friction, predict_candidates, silhouette
from foldcell.calibration.shear import calibrate_shear, clip_and_lowest, elongations
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.trajectory.arcs.paths import fold_paths
from foldcell.skills.vocabulary import GraspId, Material

PAPER = {
    "long_sleeve_shirt_large": (2.9, 24.3),
    "long_sleeve_shirt_small": (2.9, 24.7),
    "jeans": (2.9, 19.1),
    "pants": (1.7, 21.9),
    "large_towel": (2.2, 18.7),
    "medium_towel": (3.1, 22.3),
    "small_towel": (1.1, 24.3),
}
"""Stretch [%] and friction angle [degrees] in the table of garments of Li et al. 2015."""
OTHERS = {1: (0.015, 0.030), 2: (0.030,)}
"""Edge lengths [m] of the other meshes on which a garment is calibrated, by its number of layers. Garments of two
layers have one such mesh, because their calibration takes long."""
QUICK = ("small_towel",)
TRUE_FRICTION = 0.8
"""True friction divided by the believed friction, in the test of the identification."""


def hung(quick: bool, tell: Tell) -> dict[str, Any]:
    """Perform the paper's hanging test for each of its garments.

    Each garment is calibrated on the mesh that predicts its folds and on the meshes of OTHERS. On each mesh, the
    fabric calibrated there is then hung again with the predictor's own substeps. The mesh spread is the largest
    error when the fabric that was calibrated on the predicting mesh is hung on each of the meshes.
    """
    first, again, spread, rows = 0.0, 0.0, 0.0, []
    for name in QUICK if quick else tuple(PAPER):
        garment = load_garment(name)
        pair = clip_and_lowest(garment.template, garment.keypoints)
        wanted = 0.01 * PAPER[name][0]
        l2 = float(np.linalg.norm(garment.template[pair[0]] - garment.template[pair[1]]))
        edges = dict.fromkeys([garment.mesh_edge_m, *(() if quick else OTHERS[garment.layers])])
        row: dict[str, Any] = {"garment": name, "wanted_percent": 100.0 * wanted, "hung": []}
        nominal = None
        for edge in edges:
            test = calibrate_shear(
                garment.template, garment.keypoints, garment.layers, garment.material, l2 * (1.0 + wanted), l2,
                edge=edge,
            )  # fmt: skip
            fabric = replace(garment.material, stretch_fraction=test.strip_stretch)
            nominal = nominal or fabric
            found = float(elongations(test.shape, fabric, substeps=None)[0].mean())
            same = float(elongations(test.shape, nominal)[0].mean()) if fabric is not nominal else test.simulated
            first, again = max(first, abs(test.simulated - wanted)), max(again, abs(found - wanted))
            spread = max(spread, abs(same - wanted))
            row["hung"].append({
                "mesh_mm": 1e3 * edge, "hang_drop_m": test.hang_drop, "calibrated_percent": 100.0 * test.simulated,
                "predictors_substeps_percent": 100.0 * found, "nominal_fabric_percent": 100.0 * same,
                "spread_of_starts_percent": 100.0 * test.spread,
            })  # fmt: skip
        rows.append(row)
        tell(f"{name}: asked for {100.0 * wanted:.2f} %, hung {', '.join(_hung(h) for h in row['hung'])}")
    return {
        "calibrated_garments": len(rows),
        "hang_garment_error_pp_max": 100.0 * first,
        "hang_garment_predictors_substeps_error_pp_max": 100.0 * again,
        "hang_garment_mesh_spread_pp_max": 100.0 * spread,
        "hang_garment": rows,
    }


def _hung(test: Mapping[str, float]) -> str:
    return f"{test['calibrated_percent']:.2f} % with {test['mesh_mm']:.0f} mm"


def friction(quick: bool, tell: Tell) -> dict[str, Any]:
    """Simulate each garment on the paper's tilted table. Return the largest relative error of the friction
    coefficient at which it begins to slide; the correct value is tan(angle)."""
    worst = 0.0
    names = QUICK if quick else tuple(PAPER)
    for name in names:
        garment = load_garment(name)
        height = math.sin(math.radians(PAPER[name][1]))
        test = calibrate_friction(garment.template, garment.layers, garment.material, height, 1.0)
        worst = max(worst, abs(test.error))
        tell(f"{name}: {100.0 * test.error:+.2f} % from tan(angle)")
    return {"friction_garments": len(names), "friction_calibration_error_rel_max": worst}


def identified(quick: bool, tell: Tell) -> dict[str, Any]:
    """Identify friction from the outline after one fold that drags the cloth. The fold is simulated on another
    mesh than that of the identification."""
    believed = Material(0.4, 0.03, 0.012, 0.0025, 0.45, 0.85 * 0.45, 0.6)
    contour = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]])
    up, controls = np.array([0.0, 0.0, 0.45]), {}
    for i, y in ((GraspId.LEFT, 0.188), (GraspId.RIGHT, -0.188)):
        a, b = np.array([0.288, y, 0.001]), np.array([-0.288, y, 0.012])
        controls[i] = np.array([a, a + up, b + up, b])
    paths = fold_paths(controls, dict.fromkeys(controls, np.pi / 2), 3.0)
    mesh, other = mesh_from_contour(contour, 0.0262), mesh_from_contour(contour, 0.0225, rotate=0.4)
    grid = predict_candidates(mesh, mesh.lay_flat(0.0025), believed, paths)
    truth = believed.with_friction(TRUE_FRICTION * believed.friction_static)
    end = predict_fold(other, other.lay_flat(0.0025), truth, paths)
    outline = np.asarray(silhouette(end.vertices, other.triangles).exterior.coords)[:-1]
    found = identify_friction(outline, grid, believed)
    return {
        "identified_friction_believed": believed.friction_static,
        "identified_friction_true": truth.friction_static,
        "identified_friction": found.friction,
        "identified_friction_deviation_assumed": found.deviation,
    }
