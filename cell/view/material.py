"""Rerun recordings of the simulated tests of a fabric: hang, tilt, cantilever and crease test."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from calibration.bending import ANGLE, BendingCalibration
from calibration.crease import CreaseCalibration
from calibration.free_fold import FreeFold
from calibration.friction import FrictionCalibration, tilted
from calibration.shear import ShearCalibration
from cell.view.entries import style
from cell.view.entries.entry import TIMELINE
from cell.view.entries.scene import facing_normals
from cell.view.streams import begin_stream
from robots.errors import StorageError
from skills.vocabulary import Array

__all__ = ["record_bending", "record_crease", "record_free_fold", "record_friction", "record_shear"]

GARMENT = "test/garment"
HALF_TABLE = 0.75


def record_shear(path: Path, test: ShearCalibration) -> None:
    """Record the hanging garment, the line L1 on it, and the elongation of this line over time. Raises
    StorageError."""
    stream = _begin(path, "hang test", "elongation")
    stream.log("elongation/measured", rr.SeriesLines(colors=[style.TARGET], names=["measured"]), static=True)
    for k, (t, x) in enumerate(zip(test.times, test.pictures, strict=True)):
        stream.set_time(TIMELINE, duration=float(t))
        _cloth(stream, x, test.shape.mesh.triangles, first=k == 0)
        ends = [x[test.shape.clip].mean(axis=0), x[test.shape.lowest]]
        stream.log("test/measured", rr.LineStrips3D([ends], radii=0.002, colors=[style.KEYPOINT]))
        stream.log("elongation/measured", rr.Scalars(100.0 * test.stretch_fraction))
        stream.log("elongation/simulated", rr.Scalars(100.0 * test.shape.elongation(x)))
    _end(stream, path)


def record_friction(path: Path, test: FrictionCalibration) -> None:
    """Record the garment on the tilted table, while friction decreases until the garment slides. Raises
    StorageError."""
    stream = _begin(path, "tilt test", "friction")
    plate = HALF_TABLE * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    for k, (t, x) in enumerate(zip(test.times, test.pictures, strict=True)):
        stream.set_time(TIMELINE, duration=float(t))
        lift = float(test.lifts[k])
        _mesh(stream, "test/table", tilted(plate, lift), faces, style.TABLE, first=k == 0)
        _cloth(stream, tilted(x, lift), test.mesh.triangles, first=k == 0)
        stream.log("friction/of_table", rr.Scalars(float(test.frictions[k])))
        stream.log("friction/tan_of_slope", rr.Scalars(math.tan(lift)))
        stream.log("slid/downhill_mm", rr.Scalars(1e3 * float((x - test.pictures[0])[:, 0].mean())))
    _end(stream, path)


def record_bending(path: Path, test: BendingCalibration) -> None:
    """Record the strip that bends over the edge, and the plane of 41.5 degrees. Raises StorageError."""
    stream = _begin(path, "cantilever test", "angle")
    near = np.array([-test.behind, 0.0, 0.0])
    far = near + test.overhang * np.array([math.cos(ANGLE), 0.0, -math.sin(ANGLE)])
    top = test.pictures[0][:, 2].mean()
    stream.log(
        "test/plane",
        rr.LineStrips3D([[(near[0], y, top), (far[0], y, top + far[2])] for y in (-0.03, 0.03)], radii=0.001,
                        colors=[style.TARGET]), static=True,
    )  # fmt: skip
    for k, (t, x) in enumerate(zip(test.times, test.pictures, strict=True)):
        stream.set_time(TIMELINE, duration=float(t))
        _cloth(stream, x, test.mesh.triangles, first=k == 0)
        stream.log("angle/of_tip_deg", rr.Scalars(math.degrees(test.tip_angle(x))))
    _end(stream, path)


def record_free_fold(path: Path, test: FreeFold) -> None:
    """Record the flat strip, the settled free fold, and the height of its crease. Raises StorageError."""
    stream = _begin(path, "free fold", "height")
    for k, x in enumerate(test.pictures):
        stream.set_time(TIMELINE, duration=float(k))
        _cloth(stream, x, test.mesh.triangles, first=k == 0)
        stream.log("height/of_crease_mm", rr.Scalars(1e3 * float(x[:, 2].max())))
    _end(stream, path)


def record_crease(path: Path, test: CreaseCalibration) -> None:
    """Record the coupon under the weight and after it, and its kept angle. Raises StorageError."""
    stream = _begin(path, "crease recovery test", "angle")
    coupon = test.coupon
    for k, (t, x) in enumerate(zip(coupon.times, coupon.pictures, strict=True)):
        stream.set_time(TIMELINE, duration=float(t))
        _cloth(stream, x, coupon.mesh.triangles, first=k == 0)
        stream.log("angle/kept_deg", rr.Scalars(math.degrees(coupon.kept_angle(x))))
        stream.log("angle/measured_deg", rr.Scalars(math.degrees(test.kept)))
    _end(stream, path)


def _begin(path: Path, name: str, series: str) -> rr.RecordingStream:
    views = rrb.Vertical(
        rrb.Spatial3DView(origin="/", name=name), rrb.TimeSeriesView(origin=f"/{series}"), row_shares=[3, 1]
    )
    try:
        stream = begin_stream(
            "foldcell_calibration", rr.FileSink(str(path)), rrb.Blueprint(views, collapse_panels=True)
        )
    except Exception as e:
        raise StorageError(f"cannot write {path}: {e}", "choose another folder with --logs", path=str(path)) from e
    stream.send_recording_name(name)
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    return stream


def _end(stream: rr.RecordingStream, path: Path) -> None:
    stream.disconnect()
    if not path.is_file():
        raise StorageError(f"{path} was not written", "choose another folder with --logs", path=str(path))


def _cloth(stream: rr.RecordingStream, x: Array, triangles: NDArray[np.int32], first: bool) -> None:
    _mesh(stream, GARMENT, x, triangles, style.GARMENT, first)


def _mesh(
    stream: rr.RecordingStream, path: str, x: Array, faces: NDArray[np.int32], colour: tuple[int, ...], first: bool
) -> None:
    x, normals = x.astype(np.float32), facing_normals(x, faces).astype(np.float32)
    if first:
        stream.log(
            path,
            rr.Mesh3D(vertex_positions=x, triangle_indices=faces.astype(np.uint32), vertex_normals=normals,
                      albedo_factor=(*colour, 255)),
        )  # fmt: skip
    else:
        stream.log(path, rr.Mesh3D.from_fields(vertex_positions=x, vertex_normals=normals))
