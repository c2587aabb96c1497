"""`foldcell calibrate crease`: measures how much of a pressed crease a fabric keeps (AATCC 66 kind of test)."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from calibration.crease import calibrate_crease
from cell.commands.calibrate.fabric_calibration import FabricTest, Tell, add_garment_action, add_output, provenance
from cell.commands.options import Commands
from skills.garments.garment import Garment

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    action = add_garment_action(
        actions, "crease",
        "the plastic set of a pressed crease, from a strip of 40 x 15 mm folded under a weight (AATCC 66 kind)",
        _measure, {}, any_surface=False,
        others={
            "--angle": ("DEG", "degrees of 180 that the crease keeps: 180 less the crease recovery angle"),
            "--load": ("KG", "kilograms that lay on the folded end, 15 x 18 mm (standard: 0.5)"),
            "--time": ("S", "seconds under load (standard: 300)"),
        },
    )  # fmt: skip
    add_output(action)


def _measure(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    test = calibrate_crease(garment.material, math.radians(options.angle), options.load, options.time, tell=tell)

    def record(path: Path) -> None:
        from cell.view.material import record_crease

        record_crease(path, test)

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
        record=record,
    )  # fmt: skip
