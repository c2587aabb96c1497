"""Compute the errors of a calibration against the ground truth of a simulated cell. They are only recorded: no
decision uses them."""

from __future__ import annotations

import numpy as np

from foldcell.calibration.camera import IntrinsicsCalibration
from foldcell.calibration.hand_eye import HandEyeCalibration
from foldcell.calibration.table import TableCalibration
from foldcell.calibration.tactile import TactileCalibration
from foldcell.cell.simulation import Truth
from foldcell.cell.simulation.noise import load_noise
from foldcell.skills.vocabulary import Array, Intrinsics, Table


def table_error(found: TableCalibration, truth: Truth) -> dict[str, float]:
    return {"height_error_mm": round(1e3 * (found.height - truth.table_height), 4)}


def intrinsics_error(found: IntrinsicsCalibration, truth: Truth) -> dict[str, float]:
    """Return the error of each intrinsic parameter, and the largest error of an image point that they cause
    [px]."""
    a, b = found.intrinsics, truth.intrinsics
    out = {f"{name}_error_px": round(getattr(a, name) - getattr(b, name), 4) for name in ("fx", "fy", "cx", "cy")}
    u, v = np.meshgrid([0.0, b.width], [0.0, b.height])  # the error is linear, so it is largest at a corner
    du = (u - b.cx) / b.fx * a.fx + a.cx - u
    dv = (v - b.cy) / b.fy * a.fy + a.cy - v
    return out | {"corner_error_px": round(float(np.hypot(du, dv).max()), 4)}


def hand_eye_error(
    found: HandEyeCalibration, believed: Intrinsics, table: Table, truth: Truth
) -> dict[str, float]:
    """Return the error of the camera's pose, and the mean and largest position error of points on the table.

    The position of a point in the base frame is computed from its true pixel, with the intrinsics `believed`, the
    found camera pose and the configured table height.
    """
    T_base_table = np.eye(4)
    T_base_table[2, 3] = truth.table_height
    true = T_base_table @ truth.T_table_camera
    gap = np.linalg.inv(true) @ found.T_base_camera
    errors = [
        _point_error(np.array([x, y]), true, found.T_base_camera, believed, table, truth) for x, y in _grid(table)
    ]
    angle = np.arccos(np.clip(0.5 * (np.trace(gap[:3, :3]) - 1.0), -1.0, 1.0))
    return {
        "camera_error_mm": round(1e3 * float(np.linalg.norm(gap[:3, 3])), 4),
        "camera_error_deg": round(float(np.rad2deg(angle)), 4),
        "on_table_mean_mm": round(1e3 * float(np.mean(errors)), 4),
        "on_table_max_mm": round(1e3 * float(np.max(errors)), 4),
    }


def _grid(table: Table) -> list[tuple[float, float]]:
    x, y = np.linspace(0.35, 0.95, 5), np.linspace(-0.4, 0.4, 5)
    return [
        (float(a), float(b)) for a in x for b in y if table.x[0] < a < table.x[1] and table.y[0] < b < table.y[1]
    ]


def _point_error(xy: Array, true: Array, found: Array, believed: Intrinsics, table: Table, truth: Truth) -> float:
    """Return the distance between a point of the table and the position computed from its pixel [m]."""
    p = np.linalg.inv(true) @ np.array([*xy, truth.table_height, 1.0])
    pixel = truth.intrinsics.matrix @ (p[:3] / p[2])
    ray = found[:3, :3] @ np.linalg.solve(believed.matrix, pixel)
    seen = found[:3, 3] + ray * (table.height - found[2, 3]) / ray[2]
    return float(np.linalg.norm(seen[:2] - xy))


def tactile_error(found: TactileCalibration, truth: Truth) -> dict[str, float]:
    """Return the relative error of each measured noise figure against the simulated noise, for the worse hand."""
    noise = load_noise().tactile
    pairs = {"cell_noise": noise.noise, "tip_noise": noise.tip_noise}
    return {
        f"{name}_error": round(
            max((abs(getattr(f, name) / true - 1.0) for f in found.figures.values()), default=0.0), 4
        )
        for name, true in pairs.items()
    }
