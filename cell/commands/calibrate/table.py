"""`foldcell calibrate table`: measures the table's height and tilt by touching it with both hands."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from calibration.table import TableCalibration, TableSettings, calibrate_table
from cell.calibrating.score import table_error
from cell.commands.calibrate.cell_calibration import (
    CellCalibration,
    add_action,
    mm,
    settings_of,
)
from cell.commands.options import Commands, count
from cell.config.calibration_file import table_text
from cell.config.cell_settings import CellSettings

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    table = add_action(actions, "table", "measure the table's height by touching it with both hands", _calibration)
    table.add_argument(
        "--points", type=count, default=8, metavar="N", help="number of touched points, 3 to 10 (8)"
    )


def _calibration(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    wanted = settings_of(TableSettings, points=options.points)

    def figures(c: TableCalibration) -> dict[str, Any]:
        rms, differ = c.residual_rms, c.arms_differ
        return {
            "height_m": round(c.height, 6),
            "change_mm": mm(c.height - settings.table.height),
            "tilt_x_deg": round(float(np.rad2deg(c.tilt_x)), 4),
            "tilt_y_deg": round(float(np.rad2deg(c.tilt_y)), 4),
            "points": len(c.points),
            "residual_rms_mm": None if rms is None else mm(rms),
            "residual_max_mm": mm(float(np.abs(c.residual).max())),
            "arms_differ_mm": None if differ is None else mm(differ),
        }

    return CellCalibration(
        part="height",
        setting="table.calibration",
        procedure=lambda cell: calibrate_table(cell.table, wanted),
        figures=figures,
        error=table_error,
        text=lambda c, provenance: table_text(c.height, provenance),
    )
