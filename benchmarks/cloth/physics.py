"""Simulated laboratory tests against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.cloth.scenes import MATERIAL
from calibration.bending import cantilever
from calibration.friction import calibrate_friction
from calibration.shear import calibrate_shear, clip_and_lowest, hang, hung_shape
from cell.garments import load_garment
from skills.cloth.elastic import GRAVITY
from skills.cloth.mesh import mesh_from_contour
from skills.cloth.solver import ClothSimulation, SolverSettings

Figures = dict[str, Any]
PATCH = np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]])
CREEP_RATIO, SLIDE_RATIOS = 0.98, (1.02, 1.1, 1.5)
FRICTIONS = (0.2, 0.6, 1.0)
STRETCHES = (0.01, 0.02, 0.035)
STRIP = (0.15, 0.6)
HUNG = {"small_towel": 0.011, "medium_towel": 0.031, "pants": 0.017}
"""Garments of the paper and their measured stretch."""


def slide_expected(mu: float, angle: float, seconds: float = 1.0) -> float:
    """Way of a block down a slope [m]."""
    return float(0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle)) * seconds**2)


def tilt(figures: Figures) -> None:
    """Coulomb: what holds does not creep, what slides slides as a block."""
    mesh = mesh_from_contour(PATCH, 0.026)
    creep, error = 0.0, 0.0
    for mu in FRICTIONS:
        for ratio in (CREEP_RATIO, *SLIDE_RATIOS):
            angle = float(np.arctan(ratio * mu))
            settings = SolverSettings(gravity=(GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)), drag=0.0)
            s = ClothSimulation(
                mesh, replace(MATERIAL, friction_static=mu, friction_dynamic=mu), settings=settings
            )
            before = s.positions
            s.advance(60)
            way = (s.positions - before)[:, 0]
            if ratio < 1.0:
                creep = max(creep, 1e3 * float(np.abs(way).max()))
            else:
                error = max(error, abs(float(way.mean()) / slide_expected(mu, angle) - 1.0))
    figures["tilt_creep_mm_max"], figures["tilt_slide_error_rel_max"] = creep, error
    pants = load_garment("pants")
    test = calibrate_friction(pants.template, pants.layers, pants.material, 0.375, 1.0)
    figures["tilt_two_layers_error_rel"] = test.error


def hang_strip(figures: Figures) -> None:
    width, length = STRIP
    worst = 0.0
    for edge in (0.015, 0.018, 0.026, 0.03):
        mesh = mesh_from_contour(np.array([[0, 0], [width, 0], [width, length], [0, length]]), edge)
        top, bottom = mesh.rest[:, 1] > length - 1e-9, mesh.rest[:, 1] < 1e-9
        x = np.column_stack([mesh.rest[:, 0], np.zeros(len(mesh.rest)), mesh.rest[:, 1]])
        for stretch in STRETCHES:
            s = ClothSimulation(
                mesh, replace(MATERIAL, stretch_fraction=stretch), x, SolverSettings(drag=2.0, sleep_frames=0),
                table=False, fixed=top,
            )  # fmt: skip
            s.advance(200)
            z = s.positions[:, 2]
            worst = max(worst, abs(float(z[top].mean() - z[bottom].mean()) / length - 1.0 - stretch))
    figures["hang_strip_error_pp_max"] = 100.0 * worst


def hang_garment(figures: Figures, names: tuple[str, ...]) -> None:
    """The paper's test: calibrated on one mesh, hung again on others and with the predictor's own substeps."""
    worst = 0.0
    for name in names:
        garment = load_garment(name)
        pair = clip_and_lowest(garment.template, garment.keypoints)
        wanted = HUNG[name]
        l2 = float(np.linalg.norm(garment.template[pair[0]] - garment.template[pair[1]]))
        test = calibrate_shear(
            garment.template, garment.keypoints, garment.layers, garment.material, l2 * (1.0 + wanted), l2
        )
        fabric = replace(garment.material, stretch_fraction=test.strip_stretch)
        for edge in (0.015, 0.020, 0.026):
            shape = hung_shape(garment.template, pair, garment.layers, fabric.thickness, edge)
            end, _ = hang(shape, fabric, 4.0, substeps=SolverSettings().substeps)
            worst = max(worst, abs(shape.elongation(end) - wanted))
    figures["hang_garment_error_pp_max"] = 100.0 * worst


def bending(figures: Figures) -> None:
    worst = 0.0
    for length in (0.012, 0.020, 0.035):
        for edge in (0.015, 0.020, 0.030):
            test = cantilever(replace(MATERIAL, bending_length=length), edge, pictures=2)
            worst = max(worst, abs(test.error))
    figures["bending_error_rel_max"] = worst


def measure(figures: Figures, quick: bool, tell: Callable[[str], None]) -> None:
    tell("tilt, hang and cantilever tests ...")
    tilt(figures)
    hang_strip(figures)
    hang_garment(figures, ("small_towel",) if quick else tuple(HUNG))
    strip, garment = figures["hang_strip_error_pp_max"], figures["hang_garment_error_pp_max"]
    figures["hang_error_pp_max"] = max(strip, garment)
    bending(figures)
