"""`foldcell calibrate friction`: measures a garment's friction from the slope on which it begins to slide."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from calibration.friction import FrictionCalibration, calibrate_friction
from cell.commands.calibrate.fabric_calibration import FabricTest, Tell, add_garment_action, add_output, provenance
from cell.commands.options import Commands
from skills.garments.garment import Garment

__all__ = ["add_options", "tilt_test"]


def add_options(actions: Commands) -> None:
    action = add_garment_action(
        actions, "friction", "a garment's friction with the table, from the slope on which it slides", _measure,
        {
            "--height": "by which one side of the table is lifted when the garment begins to slide",
            "--length": "of the table's length",
        },
        any_surface=True,
    )  # fmt: skip
    add_output(action)


def _measure(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    height, length = options.height, options.length
    test = tilt_test(garment, height, length, tell)
    degrees = math.degrees(test.angle)

    def record(path: Path) -> None:
        from cell.view.material import record_friction

        record_friction(path, test)

    return FabricTest(
        values={"friction_angle_deg": {surface: round(degrees, 3)}},
        measured={f"friction_{surface}": provenance(f"table {length:g} m long lifted by {height:g} m")},
        fields=("friction_static",),
        figures={
            "height_m": height, "length_m": length, "friction_angle_deg": degrees, "friction": test.coefficient,
            "simulated_friction": test.simulated, "simulated_error_rel": test.error,
        },
        agrees=test.agrees,
        record=record,
    )  # fmt: skip


def tilt_test(garment: Garment, height: float, length: float, tell: Tell) -> FrictionCalibration:
    return calibrate_friction(garment.template, garment.layers, garment.material, height, length, tell)
