"""`foldcell calibrate tactile`: measures noise and drift of the tactile sensors and derives thresholds."""

from __future__ import annotations

import argparse
from typing import Any

from calibration.tactile import TactileCalibration, calibrate_tactile
from cell.calibrating.score import tactile_error
from cell.commands.calibrate.cell_calibration import (
    CellCalibration,
    add_action,
    mm,
)
from cell.commands.options import Commands
from cell.config.calibration_file import tactile_text
from cell.config.cell_settings import CellSettings

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    add_action(actions, "tactile", "measure noise, drift and thresholds of the tactile sensors", _calibration)


def _calibration(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    def figures(c: TactileCalibration) -> dict[str, Any]:
        out: dict[str, Any] = {"contact_force_n": c.contact_force, "held_force_n": c.held_force}
        for side, f in c.figures.items():
            for name in ("cell_noise", "pad_noise", "tip_noise", "pad_drift", "tip_drift"):
                out[f"{side}_{name}_n"] = round(getattr(f, name), 4)
            out[f"{side}_rate_hz"] = round(f.rate, 2)
            out[f"{side}_stiffness_n_per_m"] = round(c.stiffness[side], 1)
            out[f"{side}_noticed_mm"] = mm(c.noticed[side])
        return out | {"false_contacts": c.false_contacts, "zeros": c.zeros}

    return CellCalibration(
        part="thresholds",
        setting="grasp.calibration",
        procedure=lambda cell: calibrate_tactile(cell.table, cell.grasp),
        figures=figures,
        error=tactile_error,
        text=lambda c, provenance: tactile_text(
            {"contact_force": c.contact_force, "held_force": c.held_force}, provenance
        ),
    )
