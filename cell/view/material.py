"""Rerun recordings of the simulated tests of a fabric: hang, tilt, cantilever and crease test."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from foldcell.calibration.bending import ANGLE, BendingCalibration
from foldcell.calibration.crease import CreaseCalibration, kept_angle
from foldcell.calibration.free_fold import FreeFold
from foldcell.calibration.friction import FrictionCalibration, tilted
from foldcell.calibration.shear import ShearCalibration
from foldcell.cell.view.entries import style
from foldcell.cell.view.entries.entry import TIMELINE
from foldcell.cell.view.entries.scene import mesh, moved_mesh
from foldcell.cell.view.streams import begin_stream
from foldcell.robots.errors import StorageError
from foldcell.skills.vocabulary import Array

HALF_TABLE = 0.75


def record_shear(path: Path, test: ShearCalibration) -> None:
    """Record the hanging garment, the line L1 on it, and the elongation of this line over time. Raises
    StorageError."""
    with _recording(path, "hang test", "elongation") as stream:
        stream.log("elongation/measured", rr.SeriesLines(colors=[style.TARGET], names=["measured"]), static=True)
        for _, x in _pictures(stream, test.times, test.pictures, test.shape.mesh.triangles):
            ends = [x[test.shape.clip].mean(axis=0), x[test.shape.lowest]]
            stream.log("test/measured", rr.LineStrips3D([ends], radii=0.002, colors=[style.KEYPOINT]))
            stream.log("elongation/measured", rr.Scalars(100.0 * test.stretch_fraction))
            stream.log("elongation/simulated", rr.Scalars(100.0 * test.shape.elongation(x)))


def record_friction(path: Path, test: FrictionCalibration) -> None:
    """Record the garment on the tilted table, while friction decreases until the garment slides. Raises
    StorageError."""
    plate = HALF_TABLE * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    lifts = [float(lift) for lift in test.lifts]
    shown = [tilted(x, lift) for x, lift in zip(test.pictures, lifts, strict=True)]
    with _recording(path, "tilt test", "friction") as stream:
        for k, _ in _pictures(stream, test.times, shown, test.mesh.triangles):
            _mesh(stream, "test/table", tilted(plate, lifts[k]), faces, style.TABLE, first=k == 0)
            stream.log("friction/of_table", rr.Scalars(float(test.frictions[k])))
            stream.log("friction/tan_of_slope", rr.Scalars(math.tan(lifts[k])))
            slid = (test.pictures[k] - test.pictures[0])[:, 0].mean()
            stream.log("slid/downhill_mm", rr.Scalars(1e3 * float(slid)))


def record_bending(path: Path, test: BendingCalibration) -> None:
    """Record the strip that bends over the edge, and the plane of 41.5 degrees. Raises StorageError."""
    near = np.array([-test.behind, 0.0, 0.0])
    far = near + test.overhang * np.array([math.cos(ANGLE), 0.0, -math.sin(ANGLE)])
    top = test.pictures[0][:, 2].mean()
    plane = [[(near[0], y, top), (far[0], y, top + far[2])] for y in (-0.03, 0.03)]
    with _recording(path, "cantilever test", "angle") as stream:
        stream.log("test/plane", rr.LineStrips3D(plane, radii=0.001, colors=[style.TARGET]), static=True)
        for _, x in _pictures(stream, test.times, test.pictures, test.mesh.triangles):
            stream.log("angle/of_tip_deg", rr.Scalars(math.degrees(test.tip_angle(x))))


def record_free_fold(path: Path, test: FreeFold) -> None:
    """Record the flat strip, the settled free fold, and the height of its crease. Raises StorageError."""
    with _recording(path, "free fold", "height") as stream:
        for _, x in _pictures(stream, range(len(test.pictures)), test.pictures, test.mesh.triangles):
            stream.log("height/of_crease_mm", rr.Scalars(1e3 * float(x[:, 2].max())))


def record_crease(path: Path, test: CreaseCalibration) -> None:
    """Record the coupon under the weight and after it, and its kept angle. Raises StorageError."""
    coupon = test.coupon
    with _recording(path, "crease recovery test", "angle") as stream:
        for _, x in _pictures(stream, coupon.times, coupon.pictures, coupon.mesh.triangles):
            stream.log("angle/kept_deg", rr.Scalars(math.degrees(kept_angle(coupon.mesh, x))))
            stream.log("angle/measured_deg", rr.Scalars(math.degrees(test.kept)))


@contextmanager
def _recording(path: Path, name: str, series: str) -> Iterator[rr.RecordingStream]:
    """Write a recording with a view of the test and a plot of `series`. Raises StorageError."""
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
    yield stream
    stream.disconnect()
    if not path.is_file():
        raise StorageError(f"{path} was not written", "choose another folder with --logs", path=str(path))


def _pictures(
    stream: rr.RecordingStream,
    times: Iterable[float],
    pictures: Sequence[Array] | Array,
    triangles: NDArray[np.int32],
) -> Iterator[tuple[int, Array]]:
    """Record the cloth at each time [s]. Yields number and vertices (n, 3) of each picture. The caller can record
    more at the time of the picture."""
    for k, (t, x) in enumerate(zip(times, pictures, strict=True)):
        stream.set_time(TIMELINE, duration=float(t))
        _mesh(stream, "test/garment", x, triangles, style.GARMENT, first=k == 0)
        yield k, x


def _mesh(
    stream: rr.RecordingStream, path: str, x: Array, faces: NDArray[np.int32], colour: tuple[int, ...], first: bool
) -> None:
    stream.log(path, mesh(x, faces, (*colour, 255)) if first else moved_mesh(x, faces))
