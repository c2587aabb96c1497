"""`foldcell calibrate camera`: measures the camera's intrinsics from views of the calibration board."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from calibration.camera import CameraSettings, IntrinsicsCalibration, calibrate_camera
from cell.calibrating.score import intrinsics_error
from cell.commands.calibrate.cell_calibration import (
    CellCalibration,
    Provenance,
    add_action,
    camera_provenance,
    settings_of,
)
from cell.commands.options import Commands, count
from cell.config.calibration_file import calibration_text
from cell.config.cell_settings import CellSettings
from cell.hardware.camera import camera_calibration

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    about = "measure the camera's focal lengths and centre, from views of the calibration board"
    camera = add_action(actions, "camera", about, _calibration)
    camera.add_argument("--views", type=count, default=20, metavar="N", help="pictures that show the board (20)")


def _calibration(options: argparse.Namespace, settings: CellSettings) -> CellCalibration:
    wanted = settings_of(CameraSettings, views=options.views)
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
        procedure=lambda cell: calibrate_camera(wanted),
        figures=figures,
        error=intrinsics_error,
        text=text,
    )
