"""`foldcell calibrate bending`: measures a fabric's bending length with a strip that hangs over an edge (ASTM
D1388)."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

from calibration.bending import calibrate_bending
from cell.commands.calibrate.fabric_calibration import FabricTest, Tell, add_garment_action, add_output, provenance
from cell.commands.options import Commands
from skills.cloth.elasticity import flexural_rigidity
from skills.garments.garment import Garment

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    action = add_garment_action(
        actions, "bending",
        "a fabric's bending length, from a strip that hangs over an edge (ASTM D1388)", _measure,
        {"--overhang": "of overhang at which the tip touches the plane of 41.5 degrees"}, any_surface=False,
    )  # fmt: skip
    add_output(action)


def _measure(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    test = calibrate_bending(garment.material, options.overhang)

    def record(path: Path) -> None:
        from cell.recording.rerun.material import record_bending

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
