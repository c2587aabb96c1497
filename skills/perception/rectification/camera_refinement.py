"""Refines the camera's pose by one picture of the empty table.

The pose of a camera's bracket is known to a few millimetres and milliradians, which makes an error of a centimetre
on the table. The empty table shows most of this error: the depth picture gives the table's plane (two tilts and
the height), the near and far edges give the distance and the rotation. The picture does not show the shift along
y. The estimate is therefore a maximum a posteriori estimate, by Gauss-Newton steps, with the given calibration as
the prior.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.vocabulary import CameraCalibration, CameraFrame, Failure, FailureKind, Outcome, Table

_PRIOR_POSITION, _PRIOR_ANGLE = 0.005, 0.005
"""Standard deviations of the given calibration [m, rad]."""
_PLANE_TILT = 0.0008
"""Standard deviation of the measured plane's tilt [rad]."""
_PLANE_HEIGHT = 0.004
"""Standard deviation of the measured plane's height [m]. Depth sensors have a scale error of one per cent."""
_EDGE_PLACE = 0.0015
"""Standard deviation of the position of the table's edges in the table frame [m]."""
_SEARCH = 0.04
"""Distance from its expected place up to which an edge is searched [m]."""
_LARGEST_POSITION, _LARGEST_ANGLE = 0.03, 0.03
"""Maximum corrections [m, rad]."""
_LARGEST_HEIGHT = 0.04
"""Largest height of the measured table above or below the calibrated one [m]: three standard deviations of a depth
sensor with a scale error of one per cent."""


def tilted_table(frame: CameraFrame, calibration: CameraCalibration, table: Table) -> Failure | None:
    """Return CAMERA_FAULT if the depth of the empty table contradicts the calibration: the table is tilted by more
    than `_LARGEST_ANGLE`, or off by more than `_LARGEST_HEIGHT`. None also if the picture shows no plane."""
    plane = _table_plane(frame, calibration, table)
    if plane is None:
        return None
    T, (normal, distance) = calibration.T_table_camera, plane
    tilt = float(np.arccos(np.clip((T[:3, :3] @ normal)[2], -1.0, 1.0)))
    height = float(T[2, 3] - distance)
    if tilt <= _LARGEST_ANGLE and abs(height) <= _LARGEST_HEIGHT:
        return None
    return Failure(
        FailureKind.CAMERA_FAULT,
        f"by its depth, the table is tilted by {np.rad2deg(tilt):.1f} degrees and lies {abs(height) * 1e3:.0f} mm "
        f"{'higher' if height > 0.0 else 'lower'} than by the camera's calibration",
        "calibrate the camera's pose (calibrate hand-eye), or correct the places of camera and table in force",
        {"tilt_rad": tilt, "height_m": height},
    )


def refine_calibration(
    frame: CameraFrame, calibration: CameraCalibration, table: Table
) -> Outcome[CameraCalibration]:
    """Correct the calibration by a picture of the empty table.

    Failures: CAMERA_FAULT when the depth picture shows no plane, or when the correction is larger than
    `_LARGEST_POSITION` or `_LARGEST_ANGLE`: the calibration then belongs to another set-up. The outcome's notes
    contain the size of the correction and the number of visible edges.
    """
    plane = _table_plane(frame, calibration, table)
    if plane is None:
        return Outcome(
            failure=Failure(
                FailureKind.CAMERA_FAULT,
                "the depth picture does not show the table as a plane",
                "clear the table; check the depth sensor",
            )
        )
    edges = [
        (x, pixels) for x in table.x if (pixels := _edge_pixels(frame.rgb, calibration, table, x)) is not None
    ]
    correction = np.zeros(6)
    for _ in range(6):
        r, J = _residuals(correction, calibration, plane, edges)
        correction = correction - np.linalg.solve(J.T @ J, J.T @ r)
    shift, turn = float(np.linalg.norm(correction[:3])), float(np.linalg.norm(correction[3:]))
    notes: dict[str, float | int | str] = {"shift_m": shift, "turn_rad": turn, "edges": len(edges)}
    if shift > _LARGEST_POSITION or turn > _LARGEST_ANGLE:
        return Outcome(
            failure=Failure(
                FailureKind.CAMERA_FAULT,
                f"the table is seen {shift * 1e3:.0f} mm, {np.rad2deg(turn):.1f} degrees from where it should be",
                "calibrate the camera, or correct the table's place in cell.yaml",
                {"shift_m": shift, "turn_rad": turn},
            ),
            notes=notes,
        )
    T = frozen(_corrected_pose(calibration.T_table_camera, correction))
    return Outcome(value=CameraCalibration(calibration.intrinsics, T, calibration.head_pan), notes=notes)


def _corrected_pose(T: Array, correction: Array) -> Array:
    """Apply a correction (6,) to the camera's pose T (4, 4): a shift [m] and a rotation vector [rad], both in the
    table's axes."""
    R, _ = cv2.Rodrigues(np.asarray(correction[3:], dtype=float))
    out = np.array(T, dtype=float)
    out[:3, :3] = R @ T[:3, :3]
    out[:3, 3] = T[:3, 3] + correction[:3]
    return out


def _residuals(
    correction: Array,
    calibration: CameraCalibration,
    plane: tuple[Array, float],
    edges: list[tuple[float, Array]],
) -> tuple[Array, Array]:
    def at(c: Array) -> Array:
        T = _corrected_pose(calibration.T_table_camera, c)
        normal, distance = plane
        up = T[:3, :3] @ normal
        parts = [
            c[:3] / _PRIOR_POSITION,
            c[3:] / _PRIOR_ANGLE,
            up[:2] / _PLANE_TILT,
            np.array([(T[2, 3] - distance) / _PLANE_HEIGHT]),
        ]
        for x, rays in edges:
            d = rays @ T[:3, :3].T
            seen = T[0, 3] - d[:, 0] * T[2, 3] / d[:, 2]
            # Errors of neighbouring pixels are correlated: a whole edge counts as four independent measurements.
            parts.append((seen - x) / (_EDGE_PLACE * np.sqrt(len(rays) / 4.0)))
        return np.concatenate(parts)

    r = at(correction)
    step = 1e-6
    J = np.stack([(at(correction + step * e) - r) / step for e in np.eye(6)], axis=1)
    return r, J


def _rays(calibration: CameraCalibration, uv: Array) -> Array:
    k = calibration.intrinsics
    return np.stack([(uv[:, 0] - k.cx) / k.fx, (uv[:, 1] - k.cy) / k.fy, np.ones(len(uv))], axis=1)


def _table_plane(frame: CameraFrame, calibration: CameraCalibration, table: Table) -> tuple[Array, float] | None:
    """Fit the table's plane to the depth picture. Return its upward normal (3,) in camera axes and the camera's
    height above it [m]; None if the picture shows no plane."""
    v, u = np.mgrid[2 : frame.depth.shape[0] : 5, 2 : frame.depth.shape[1] : 5].reshape(2, -1)
    depth = frame.depth[v, u].astype(float)
    known = np.isfinite(depth)
    points = _rays(calibration, np.stack([u, v], axis=1)[known].astype(float)) * depth[known, None]
    T = calibration.T_table_camera
    in_table_frame = points @ T[:3, :3].T + T[:3, 3]
    margin = 0.04
    on_table = (
        (in_table_frame[:, 0] > table.x[0] + margin)
        & (in_table_frame[:, 0] < table.x[1] - margin)
        & (in_table_frame[:, 1] > table.y[0] + margin)
        & (in_table_frame[:, 1] < table.y[1] - margin)
        & (np.abs(in_table_frame[:, 2]) < 0.06)
    )
    points = points[on_table]
    for _ in range(4):
        if len(points) < 500:
            return None
        middle = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
        normal = axes[2] if axes[2] @ T[2, :3] > 0 else -axes[2]
        distance = np.abs((points - middle) @ normal)
        keep = distance < 3.0 * 1.4826 * float(np.median(distance)) + 1e-4
        if keep.all():
            break
        points = points[keep]
    return normal, float(-middle @ normal)


def _edge_pixels(rgb: NDArray[np.uint8], calibration: CameraCalibration, table: Table, x: float) -> Array | None:
    """Find rays (n, 3) in camera axes through the table's edge at this x [m]; None when the edge is not clearly
    visible.

    Across the expected line, within `_SEARCH`, the strongest change of colour is a point of the edge. A line is
    fitted to these points, and points that are far from it are removed.
    """
    T = np.linalg.inv(calibration.T_table_camera)
    P = calibration.intrinsics.matrix @ T[:3]
    y = np.linspace(table.y[0] + 0.02, table.y[1] - 0.02, 160)
    out = x + np.linspace(-_SEARCH, _SEARCH, 81)
    grid = np.stack(np.broadcast_arrays(out[None, :], y[:, None], 0.0, 1.0), axis=-1)
    uvw = grid @ P.T
    uv = uvw[..., :2] / uvw[..., 2:]
    # The ends of a profile may lie outside the picture, where the colour is constant and no edge is found.
    core = uv[:, 30:51]
    inside = (core > 1).all(axis=(1, 2)) & (core < np.array([rgb.shape[1], rgb.shape[0]]) - 2.0).all(axis=(1, 2))
    uv, y = uv[inside], y[inside]
    if len(y) < 40:
        return None
    smooth = cv2.GaussianBlur(rgb, (0, 0), 1.0).astype(np.float32)
    u, v = uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32)
    profile = cv2.remap(smooth, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    change = np.linalg.norm(profile[:, 4:].astype(float) - profile[:, :-4], axis=2)
    peak = np.argmax(change, axis=1)
    place = out[2:-2][peak]
    line = np.median(place)
    keep = np.ones(len(y), bool)
    fit = np.array([0.0, line])
    for tolerance in (0.010, 0.004, 0.003):
        keep = np.abs(place - np.polyval(fit, y)) < tolerance
        if np.count_nonzero(keep) < max(40, 0.5 * len(y)):
            return None
        fit = np.polyfit(y[keep], place[keep], 1)
    if float(np.median(change[keep, peak[keep]])) < 12.0:
        return None
    row = np.flatnonzero(keep)
    return _rays(calibration, uv[row, peak[row] + 2])
