"""`foldcell calibrate hand-eye`: measures the camera's pose from views of the calibration board in each hand."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

from calibration.hand_eye import HandEyeCalibration, HandEyeSettings, calibrate_hand_eye
from cell.calibrating.score import hand_eye_error
from cell.commands.calibrate.cell_calibration import (
    DATA_SHEET,
    CellCalibration,
    add_action,
    camera_provenance,
    mm,
    settings_of,
)
from cell.commands.options import Commands, count
from cell.config.calibration_file import calibration_text
from cell.config.cell_settings import CellSettings
from cell.hardware.camera import camera_calibration
from skills.vocabulary import Array

__all__ = ["add_options"]

DOUBTFUL_LENS = (
    "the intrinsics are those of the data sheet, and their error adds to that of the pose. For a better pose, run"
    " foldcell calibrate camera, name its file in cell.yaml, and run this again"
)


def add_options(actions: Commands) -> None:
    about = "measure the camera's pose, from views of the calibration board in each hand"
    eye = add_action(actions, "hand-eye", about, _calibration)
    eye.add_argument(
        "--views", type=count, default=12, metavar="N", help="pictures with the board in each hand (12)"
    )


def _calibration(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    present, table, present_provenance = camera_calibration(settings), settings.table, camera_provenance(settings)
    measured = present_provenance.get("intrinsics", {}).get("by") != DATA_SHEET
    kind = HandEyeSettings if measured else HandEyeSettings.with_lens_of_data_sheet
    wanted = settings_of(kind, views=options.views)

    def pose(c: HandEyeCalibration) -> Array:
        return np.asarray(np.linalg.inv(table.T_base_table) @ c.T_base_camera)

    def figures(c: HandEyeCalibration) -> dict[str, Any]:
        change = np.linalg.inv(present.T_table_camera) @ pose(c)
        return {
            "position_m": [round(float(v), 5) for v in c.T_base_camera[:3, 3]],
            "change_mm": mm(float(np.linalg.norm(change[:3, 3]))),
            "change_deg": _deg(float(np.arccos(np.clip(0.5 * (np.trace(change[:3, :3]) - 1.0), -1.0, 1.0)))),
            "reprojection_rms_px": round(c.rms, 4),
            "residual_mm": mm(c.position),
            "residual_deg": _deg(c.angle),
            "position_sigma_mm": mm(c.position_sigma),
            "angle_sigma_deg": _deg(c.angle_sigma),
            "views": c.views,
            "intrinsics_by": present_provenance.get("intrinsics", {}).get("by", "a file that does not say"),
        }

    return CellCalibration(
        part="pose",
        setting="camera.calibration",
        procedure=lambda cell: calibrate_hand_eye(cell.robot, cell.calibration, cell.table, wanted),
        figures=figures,
        error=lambda c, truth: hand_eye_error(c, present.intrinsics, table, truth),
        text=lambda c, provenance: calibration_text(
            replace(present, T_table_camera=pose(c)), table.height, present_provenance | provenance
        ),
        warning="" if measured else DOUBTFUL_LENS,
    )


def _deg(radians: float) -> float:
    return round(float(np.rad2deg(radians)), 4)
