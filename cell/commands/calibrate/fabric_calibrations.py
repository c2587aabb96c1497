"""The calibrations of a fabric: what `foldcell calibrate shear`, `friction`, `bending` and `crease` measure."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from foldcell.calibration.bending import calibrate_bending
from foldcell.calibration.crease import calibrate_crease
from foldcell.calibration.free_fold import calibrate_free_fold
from foldcell.calibration.friction import calibrate_friction
from foldcell.calibration.shear import calibrate_shear, clip_and_lowest
from foldcell.cell.commands.calibrate.run_on_fabric import (
    FabricTest,
    Tell,
    add_garment_action,
    provenance,
)
from foldcell.cell.commands.shared import Commands
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.cloth.elasticity import flexural_rigidity, membrane_modulus
from foldcell.skills.garments.garment import Garment


def add_options(actions: Commands) -> None:
    shear = add_garment_action(
        actions, "shear", "a garment's stretch, from its length hanging and lying", _shear,
        {
            "--l1": ("M", "metres from the clip to the lowest point of the hanging garment"),
            "--l2": ("M", "metres between the same two points of the garment spread on a table"),
        },
    )  # fmt: skip
    shear.add_argument("--held", metavar="KEYPOINT", help="key point at the clip (an end of its longest line)")
    add_garment_action(
        actions, "friction", "a garment's friction with the table, from the slope on which it slides", _friction,
        {
            "--height": ("M", "metres by which one side of the table is lifted when the garment begins to slide"),
            "--length": ("M", "metres of the table's length"),
        },
        any_surface=True,
    )  # fmt: skip
    bending = add_garment_action(
        actions, "bending",
        "a fabric's bending length, from a strip that hangs over an edge (ASTM D1388) or is folded over", _bending,
        {},
    )  # fmt: skip
    measured = bending.add_mutually_exclusive_group(required=True)
    measured.add_argument(
        "--overhang", type=float, metavar="M",
        help="metres of overhang at which the tip touches the plane of 41.5 degrees",
    )  # fmt: skip
    measured.add_argument(
        "--fold-height", type=float, metavar="M",
        help="metres from the table to the top of the crease of a strip that is folded over and not pressed",
    )  # fmt: skip
    bending.add_argument(
        "--mass", type=float, metavar="KG_M2", help="weighed areal mass in kg/m2 (with --fold-height)"
    )
    add_garment_action(
        actions, "crease",
        "the plastic set of a pressed crease, from a strip of 40 x 15 mm folded under a weight (AATCC 66 kind)",
        _crease,
        {
            "--angle": ("DEG", "degrees of 180 that the crease keeps: 180 less the crease recovery angle"),
            "--load": ("KG", "kilograms that lay on the folded end, 15 x 18 mm (standard: 0.5)"),
            "--time": ("S", "seconds under load (standard: 300)"),
        },
    )  # fmt: skip


def _shear(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    l1, l2 = options.l1, options.l2
    test = calibrate_shear(
        garment.template, garment.keypoints, garment.layers, garment.material, l1, l2, options.held,
        garment.size_range, tell, garment.mesh_edge_m,
    )  # fmt: skip
    fabric = replace(garment.material, stretch_fraction=test.strip_stretch)
    return FabricTest(
        values={"stretch_fraction": round(test.stretch_fraction, 5), "hang_drop": round(test.hang_drop, 4)},
        measured={"stretch_fraction": provenance(f"L1 {l1:g} m, L2 {l2:g} m, hung by {_held(garment, options)}")},
        fields=("stretch_fraction",),
        figures={
            "l1_m": l1, "l2_m": l2, "stretch_fraction": test.stretch_fraction,
            "simulated_stretch_fraction": test.simulated, "simulated_spread": test.spread,
            "hang_drop_m": test.hang_drop,
            "strip_stretch_fraction": test.strip_stretch, "membrane_modulus_N_per_m": membrane_modulus(fabric),
            "hung_by": _held(garment, options), "simulations": test.simulations,
        },
        agrees=abs(test.simulated - test.stretch_fraction) <= 1e-3,
        record=lambda view, path: view.record_shear(path, test),
    )  # fmt: skip


def _held(garment: Garment, options: argparse.Namespace) -> str:
    return garment.keypoints[clip_and_lowest(garment.template, garment.keypoints, options.held)[0]]


def _friction(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    height, length = options.height, options.length
    test = calibrate_friction(garment.template, garment.layers, garment.material, height, length, tell)
    degrees = math.degrees(test.angle)
    return FabricTest(
        values={"friction_angle_deg": {surface: round(degrees, 3)}},
        measured={f"friction_{surface}": provenance(f"table {length:g} m long lifted by {height:g} m")},
        fields=("friction_static",),
        figures={
            "height_m": height, "length_m": length, "friction_angle_deg": degrees, "friction": test.coefficient,
            "simulated_friction": test.simulated, "simulated_error_rel": test.error,
        },
        agrees=test.agrees,
        record=lambda view, path: view.record_friction(path, test),
    )  # fmt: skip


def _bending(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    if options.overhang is None:
        return _folded_over(garment, options, tell)
    if options.mass is not None:
        raise ConfigurationError("--mass belongs to --fold-height", "leave it out, or give --fold-height")
    test = calibrate_bending(garment.material, options.overhang)
    fabric = replace(garment.material, bending_length=test.bending_length)
    return FabricTest(
        values={"bending_length": round(test.bending_length, 5)},
        measured={"bending_length": provenance(f"overhang {options.overhang:g} m at 41.5 degrees")},
        fields=("bending_length",),
        figures={
            "overhang_m": options.overhang, "bending_length_m": test.bending_length,
            "flexural_rigidity_N_m": flexural_rigidity(fabric), "simulated_bending_length_m": test.simulated,
            "simulated_error_rel": test.error, "simulated_tip_angle_deg": math.degrees(test.angle),
        },
        agrees=test.agrees,
        record=lambda view, path: view.record_bending(path, test),
    )  # fmt: skip


def _folded_over(garment: Garment, options: argparse.Namespace, tell: Tell) -> FabricTest:
    if options.mass is not None and not 0.03 <= options.mass <= 2.0:
        raise ConfigurationError(
            f"no fabric weighs {options.mass:g} kg/m2", "give 0.03 to 2: mass of the strip divided by its area"
        )
    mass = garment.material.areal_mass if options.mass is None else options.mass
    test = calibrate_free_fold(replace(garment.material, areal_mass=mass), options.fold_height, tell)
    weighed = {} if options.mass is None else {"areal_mass": round(mass, 4)}
    fabric = replace(garment.material, areal_mass=mass, bending_length=test.bending_length)
    return FabricTest(
        values={"bending_length": round(test.bending_length, 5), **weighed},
        measured={
            "bending_length": provenance(f"free fold {options.fold_height:g} m high"),
            **{name: provenance("weighed") for name in weighed},
        },
        fields=("bending_length", *weighed),
        figures={
            "fold_height_m": options.fold_height, "bending_length_m": test.bending_length,
            "flexural_rigidity_N_m": flexural_rigidity(fabric), "simulated_fold_height_m": test.height,
            "simulated_error_rel": test.error,
        },
        agrees=test.agrees,
        record=lambda view, path: view.record_free_fold(path, test),
    )  # fmt: skip


def _crease(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    test = calibrate_crease(garment.material, math.radians(options.angle), options.load, options.time, tell=tell)
    return FabricTest(
        values={"crease_set": round(test.crease_set, 4)},
        measured={
            "crease_set": provenance(f"{options.angle:g} deg kept after {options.load:g} kg, {options.time:g} s")
        },
        fields=("crease_set",),
        figures={
            "kept_angle_deg": options.angle, "load_kg": options.load, "time_s": options.time,
            "pressure_pa": test.pressure, "crease_set": test.crease_set,
            "simulated_kept_angle_deg": math.degrees(test.simulated),
            "simulated_error_deg": math.degrees(test.error),
        },
        agrees=test.agrees,
        record=lambda view, path: view.record_crease(path, test),
    )  # fmt: skip
