"""The calibrations of the cell: what `foldcell calibrate table`, `camera`, `hand-eye` and `tactile` measure."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

from foldcell.calibration.camera import IntrinsicsCalibration, calibrate_camera, check_views
from foldcell.calibration.hand_eye import HandEyeCalibration, HandEyeSettings, calibrate_hand_eye
from foldcell.calibration.table import TableCalibration, calibrate_table, check_points
from foldcell.calibration.tactile import TactileCalibration, calibrate_tactile
from foldcell.cell.calibrating.score import hand_eye_error, intrinsics_error, table_error, tactile_error
from foldcell.cell.commands.calibrate.run_on_cell import (
    DATA_SHEET,
    CellCalibration,
    Provenance,
    add_action,
    camera_provenance,
    mm,
)
from foldcell.cell.commands.shared import Commands, count
from foldcell.cell.config.calibration_file import calibration_text, table_text, tactile_text
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.skills.vocabulary import Array

DOUBTFUL_LENS = (
    "the intrinsics are those of the data sheet, and their error adds to that of the pose. For a better pose, run"
    " foldcell calibrate camera, name its file in cell.yaml, and run this again"
)


def add_options(actions: Commands) -> None:
    table = add_action(actions, "table", "measure the table's height by touching it with both hands", _table)
    table.add_argument(
        "--points", type=count, default=8, metavar="N", help="number of touched points, 3 to 10 (8)"
    )
    about = "measure the camera's focal lengths and centre, from views of the calibration board"
    camera = add_action(actions, "camera", about, _camera)
    camera.add_argument("--views", type=count, default=20, metavar="N", help="pictures that show the board (20)")
    about = "measure the camera's pose, from views of the calibration board in each hand"
    eye = add_action(actions, "hand-eye", about, _hand_eye)
    eye.add_argument(
        "--views", type=count, default=12, metavar="N", help="pictures with the board in each hand (12)"
    )
    add_action(actions, "tactile", "measure noise, drift and thresholds of the tactile sensors", _tactile)


def _table(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    check_points(options.points)

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
        procedure=lambda cell: calibrate_table(cell.table, options.points),
        figures=figures,
        error=table_error,
        text=lambda c, provenance: table_text(c.height, provenance),
    )


def _camera(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    check_views(options.views)
    present, present_provenance = camera_calibration(settings), camera_provenance(settings)

    def figures(c: IntrinsicsCalibration) -> dict[str, Any]:
        i, before = c.intrinsics, present.intrinsics
        names = ("fx", "fy", "cx", "cy")
        return {
            **{f"{name}_px": round(getattr(i, name), 4) for name in names},
            **{f"{name}_sigma_px": round(s, 4) for name, s in zip(names, c.sigma, strict=True)},
            **{f"{name}_change_px": round(getattr(i, name) - getattr(before, name), 4) for name in names},
            "reprojection_rms_px": round(c.rms, 4),
            "reprojection_worst_view_px": round(c.worst_view, 4),
            "distortion_px": round(c.distortion, 4),
            "views": c.views,
            "corners": c.corners,
            "coverage": round(c.coverage, 3),
        }

    def text(c: IntrinsicsCalibration, provenance: Provenance) -> str:
        """Return the text of the file, with the new intrinsics and the present pose. The pose is measured by
        `foldcell calibrate hand-eye`."""
        changed = replace(present, intrinsics=c.intrinsics)
        return calibration_text(changed, settings.table.height, present_provenance | provenance)

    return CellCalibration(
        part="intrinsics",
        setting="camera.calibration",
        procedure=lambda cell: calibrate_camera(options.views),
        figures=figures,
        error=intrinsics_error,
        text=text,
    )


def _hand_eye(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    present, table, present_provenance = camera_calibration(settings), settings.table, camera_provenance(settings)
    measured = present_provenance.get("intrinsics", {}).get("by") != DATA_SHEET
    kind = HandEyeSettings if measured else HandEyeSettings.with_lens_of_data_sheet
    wanted = kind(views=options.views)

    def pose(c: HandEyeCalibration) -> Array:
        return np.asarray(np.linalg.inv(table.T_base_table) @ c.T_base_camera)

    def figures(c: HandEyeCalibration) -> dict[str, Any]:
        change = np.linalg.inv(present.T_table_camera) @ pose(c)
        return {
            "position_m": [round(float(v), 5) for v in c.T_base_camera[:3, 3]],
            "change_mm": mm(float(np.linalg.norm(change[:3, 3]))),
            "change_deg": _deg(float(np.arccos(np.clip(0.5 * (np.trace(change[:3, :3]) - 1.0), -1.0, 1.0)))),
            "reprojection_rms_px": round(c.rms, 4),
            "board_scale": round(c.scale, 5),
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


def _tactile(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
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
        procedure=lambda cell: calibrate_tactile(cell.table),
        figures=figures,
        error=tactile_error,
        text=lambda c, provenance: tactile_text(
            {"contact_force": c.contact_force, "held_force": c.held_force}, provenance
        ),
    )
