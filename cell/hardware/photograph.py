"""Recognise a garment in a picture that was taken outside a run, by the cell's camera or by an unknown camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.support.files.picture_file import read_depth, read_picture
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, CameraFrame, Intrinsics, frozen
from foldcell.skills.garments.picture_measure import PictureMeasure
from foldcell.skills.perception.perceive import Perception, Sought, perceive
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import CameraCalibration, Outcome, Table

LEAST_CONFIDENCE = {"m": 0.6, "px": 0.43}
"""Least accepted probability that the key points in a photograph are accurate: within 10 mm, or within 2 % where
the scale is unknown. It is higher than in a run, because a garment file that is made from them is used again and
again."""
WIDTH, HEIGHT = 1.2, 2.0
"""For a picture by an unknown camera: assumed width of the table in the picture, and assumed height of the camera
above the table [m]."""
LONGEST = 5.0
"""Largest ratio of the sides of such a picture. The view of the table has the shape of the picture, and its memory
grows with this ratio."""
SMALLEST = 50
"""Fewest pixels of a side of such a picture. Key points have to be accurate to 2 % of the garment's diagonal: 1.4
pixels, if a square towel fills the smallest picture."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture. rgb: (H, W, 3) uint8. depth: (H, W) float32 [m], NaN where unknown; None: no depth. name,
    depth_name: names of the colour and the depth picture in messages."""

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32] | None
    name: str
    depth_name: str


def read_photograph(image: Path, depth: Path | None) -> Photograph:
    """Read a picture and its depth from files. Raises ConfigurationError for a file that cannot be read."""
    metres = read_depth(depth) if depth is not None else None
    return Photograph(read_picture(image), metres, str(image), str(depth))


def perceive_photograph(
    picture: Photograph,
    reference: Photograph | None,
    garment: str,
    unit: str,
    settings: CellSettings,
    on_region: Callable[[Sought], None] | None = None,
) -> tuple[Outcome[Perception], CameraFrame]:
    """Recognise the garment in the picture. Returns the outcome and the picture as a camera frame.

    reference: picture of the empty table. garment: a name, a file, or auto. unit: 'm' for the cell's camera, 'px'
    for an unknown camera that looks straight down. on_region: see `perceive`. Raises ConfigurationError for an
    unknown garment, and for a picture whose size differs from the camera's.
    """
    calibration, table = camera_calibration(settings), settings.table
    if unit == "px":
        calibration, table = photographed(picture.rgb.shape)
    names = list_garments() if garment == "auto" else (garment,)
    garments = [load_garment(name, settings.surface) for name in names]
    frame = _frame(picture, calibration.intrinsics, 0)
    empty = _frame(reference, calibration.intrinsics, 1) if reference is not None else None
    thresholds = replace(settings.perception.settings(), least_confidence=LEAST_CONFIDENCE[unit])
    if picture.depth is None or unit == "px":  # no depth, or none that a calibration could contradict
        thresholds = replace(thresholds, depth_holes=1.0)
    thresholds = replace(thresholds, size_known=unit != "px")
    expected = None if garment == "auto" else garments[0].name
    outcome = perceive(
        frame, calibration, table, empty, garments, expected, settings=thresholds, on_region=on_region
    )
    return outcome, frame


def photographed(shape: tuple[int, ...]) -> tuple[CameraCalibration, Table]:
    """Return an assumed calibration and table for a picture by an unknown camera. shape: (rows, columns, ...) of
    the picture. The camera is assumed straight above the table, and the picture shows a width of `WIDTH` on it.
    Results in pixels are valid, results in metres are not. Raises ConfigurationError for a picture that is too
    long or too small."""
    rows, columns = shape[:2]
    if max(rows, columns) > LONGEST * min(rows, columns):
        raise ConfigurationError(
            f"the picture is {columns} x {rows} pixels: one side is more than {LONGEST:.0f} times the other",
            "crop it to the garment and some of the table around it",
        )
    if min(rows, columns) < SMALLEST:
        raise ConfigurationError(
            f"the picture is {columns} x {rows} pixels: each side needs at least {SMALLEST}",
            "give the picture as it was taken, not a reduced one",
        )
    focal = HEIGHT * columns / WIDTH
    intrinsics = Intrinsics(columns, rows, focal, focal, (columns - 1) / 2, (rows - 1) / 2)
    T = np.array([[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, HEIGHT], [0.0, 0.0, 0.0, 1.0]])
    half = 0.5 * WIDTH * rows / columns
    return CameraCalibration(intrinsics, frozen(T)), Table(0.0, (-half, half), (-0.5 * WIDTH, 0.5 * WIDTH))


def in_unit(perception: Perception, points: Array, unit: str) -> Array:
    """Convert points (..., 2) [m] in the table frame to `unit`: 'm' returns them unchanged, 'px' returns pixels of
    the picture (column, row)."""
    return points if unit == "m" else perception.view.to_image(points)


def picture_measure(
    picture: Photograph, settings: CellSettings, measured: tuple[int, int] | None, length: float | None
) -> PictureMeasure:
    """Return the measure of a picture. measured, length: indices of two key points and their distance [m]; None
    for a picture by the cell's camera, which measures sizes itself.

    Raises ConfigurationError for a picture whose size differs from that of the cell's camera.
    """
    rows, columns = picture.rgb.shape[:2]
    if measured is not None:
        return PictureMeasure(columns, rows, measured, length)
    calibration = camera_calibration(settings)
    _check_size(picture.name, (rows, columns), (calibration.intrinsics.height, calibration.intrinsics.width))
    return PictureMeasure(columns, rows, None, None, TableView(calibration, settings.table).from_image)


def _frame(picture: Photograph, intrinsics: Intrinsics, sequence: int) -> CameraFrame:
    size = (intrinsics.height, intrinsics.width)
    _check_size(picture.name, picture.rgb.shape[:2], size)
    depth = picture.depth
    if depth is None:
        depth = np.full(size, np.nan, np.float32)
    else:
        _check_size(picture.depth_name, depth.shape, size)
    return CameraFrame(0.0, sequence, picture.rgb, depth, intrinsics)


def _check_size(name: str, found: tuple[int, ...], expected: tuple[int, int]) -> None:
    if tuple(found) != expected:
        wanted = f"{expected[1]} x {expected[0]}"
        raise ConfigurationError(
            f"{name}: is {found[1]} x {found[0]} pixels, the camera is calibrated for {wanted}",
            "give a picture as the cell's camera takes it, the settings of the camera that took it (--cell), or "
            "the unit px (--unit px) for a camera of which nothing is known",
        )
