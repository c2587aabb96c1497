"""`foldcell calibrate bending`: measures a fabric's bending length with a strip that hangs over an edge (ASTM
D1388) or that is folded over (free fold)."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

from calibration.bending import calibrate_bending
from calibration.free_fold import calibrate_free_fold
from cell.commands.calibrate.fabric_calibration import FabricTest, Tell, add_garment_action, add_output, provenance
from cell.commands.options import Commands
from robots.errors import ConfigurationError
from skills.cloth.elasticity import flexural_rigidity
from skills.garments.garment import Garment

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    action = add_garment_action(
        actions, "bending",
        "a fabric's bending length, from a strip that hangs over an edge (ASTM D1388) or is folded over", _measure,
        {}, any_surface=False,
    )  # fmt: skip
    measured = action.add_mutually_exclusive_group(required=True)
    measured.add_argument(
        "--overhang", type=float, metavar="M",
        help="metres of overhang at which the tip touches the plane of 41.5 degrees",
    )  # fmt: skip
    measured.add_argument(
        "--fold-height", type=float, metavar="M",
        help="metres from the table to the top of the crease of a strip that is folded over and not pressed",
    )  # fmt: skip
    action.add_argument(
        "--mass", type=float, metavar="KG_M2", help="weighed areal mass in kg/m2 (with --fold-height)"
    )
    add_output(action)


def _measure(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    if options.overhang is None:
        return _folded_over(garment, options, tell)
    if options.mass is not None:
        raise ConfigurationError("--mass belongs to --fold-height", "leave it out, or give --fold-height")
    test = calibrate_bending(garment.material, options.overhang)

    def record(path: Path) -> None:
        from cell.view.material import record_bending

        record_bending(path, test)

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
        record=record,
    )  # fmt: skip


def _folded_over(garment: Garment, options: argparse.Namespace, tell: Tell) -> FabricTest:
    if options.mass is not None and not 0.03 <= options.mass <= 2.0:
        raise ConfigurationError(
            f"no fabric weighs {options.mass:g} kg/m2", "give 0.03 to 2: mass of the strip divided by its area"
        )
    mass = garment.material.areal_mass if options.mass is None else options.mass
    test = calibrate_free_fold(replace(garment.material, areal_mass=mass), options.fold_height, tell)

    def record(path: Path) -> None:
        from cell.view.material import record_free_fold

        record_free_fold(path, test)

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
        record=record,
    )  # fmt: skip
