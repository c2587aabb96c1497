"""Recognise a garment in one picture."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foldcell.arguments import own_numeric_state, path, text
from foldcell.cell.hardware.photograph import Photograph, in_unit, perceive_photograph
from foldcell.cell.support.files.picture_file import known_depth, read_depth, read_picture
from foldcell.robots.errors import ConfigurationError, Failure
from foldcell.robots.ports import Array
from foldcell.settings import Settings, cell_settings

Image: TypeAlias = NDArray[Any] | Path | str
"""An array, or the path of a file."""


@dataclass(frozen=True, eq=False)
class PerceivedGarment:
    """The garment recognised in a picture.

    garment: name of the garment whose template fits; category: its kind. confidence: probability that all
    key points are within 10 mm of their true places, or with the unit 'px' within 2 % of their diagonal.
    ambiguous: symmetries that the picture does not resolve.
    unit: 'm' for the table frame (x forward, y left) in metres, 'px' for pixels (column, row) of the picture.
    keypoints: name -> (2,). contour: (n, 2), not closed, counter-clockwise in the table frame.

    failure: the reason why no garment was accepted. In that case garment and category are None, confidence is 0
    and the other values are empty.
    """

    garment: str | None
    category: str | None
    confidence: float
    ambiguous: tuple[str, ...]
    unit: str
    keypoints: Mapping[str, Array]
    contour: Array
    failure: Failure | None


@own_numeric_state
def perceive(
    rgb: Image,
    depth: Image | None = None,
    *,
    garment: str | Path | None = None,
    reference: Image | None = None,
    reference_depth: Image | None = None,
    unit: str = "m",
    settings: Settings = None,
) -> PerceivedGarment:
    """Recognise the garment in a picture: its kind, key points and outline.

    rgb: (H, W, 3) uint8, red first, or a PNG or JPEG file. depth: (H, W) floats [m] along the optical axis, with
    0, a negative value or NaN where nothing was measured; or a file (16-bit PNG in millimetres, `.npy` in metres).
    garment: name or file of the expected garment; None: any of the shipped garments. reference, reference_depth:
    picture and depth of the empty table. unit: 'm' for a picture by the cell's camera, with the calibration of the
    settings; 'px' for a picture taken from above by an unknown camera.

    Raises ConfigurationError for an invalid argument or file, and for a picture whose size differs from the
    calibrated camera's. One by an unknown camera may be neither smaller than 50 pixels nor longer than 5:1.
    """
    unit = text(unit, "unit")
    if unit not in ("m", "px"):
        raise ConfigurationError(f"there is no unit '{unit}'", "it is m or px")
    if reference is None and reference_depth is not None:
        raise ConfigurationError("reference_depth without reference", "give the empty table's picture as well")
    if reference is not None and depth is not None and reference_depth is None:
        raise ConfigurationError(
            "reference with depth, but without reference_depth",
            "give the empty table's depth as well, or leave out reference or depth",
        )
    seen, _ = perceive_photograph(
        _photograph(rgb, depth, "rgb", "depth"),
        None if reference is None else _photograph(reference, reference_depth, "reference", "reference_depth"),
        "auto" if garment is None else str(path(garment, "garment")),
        unit,
        cell_settings(settings),
    )
    if seen.failure is not None:
        return PerceivedGarment(None, None, 0.0, (), unit, {}, np.empty((0, 2)), seen.failure)
    perception = seen.unwrap()
    state = perception.state
    return PerceivedGarment(
        garment=perception.garment,
        category=state.category,
        confidence=state.confidence,
        ambiguous=state.ambiguous,
        unit=unit,
        keypoints={name: in_unit(perception, p, unit) for name, p in state.keypoints.items()},
        contour=in_unit(perception, state.contour, unit),
        failure=None,
    )


def _photograph(rgb: Image, depth: Image | None, name: str, depth_name: str) -> Photograph:
    """Make a `Photograph` from arrays or files. name, depth_name: names of the arguments, for messages about
    arrays."""
    if isinstance(rgb, str | os.PathLike):
        file = path(rgb, name)
        name, picture = str(file), read_picture(file)
    else:
        picture = _colours(rgb, name)
    if depth is None:
        return Photograph(picture, None, name, depth_name)
    if isinstance(depth, str | os.PathLike):
        file = path(depth, depth_name)
        return Photograph(picture, read_depth(file), name, str(file))
    return Photograph(picture, _metres(depth, depth_name), name, depth_name)


def _colours(rgb: NDArray[Any], name: str) -> NDArray[Any]:
    _check_array(rgb, name)
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or not rgb.size:
        raise ConfigurationError(
            f"{name}: holds {rgb.dtype} of shape {rgb.shape}", "give 8-bit colours of shape (rows, columns, 3)"
        )
    return np.ascontiguousarray(rgb)


def _metres(depth: NDArray[Any], name: str) -> NDArray[Any]:
    _check_array(depth, name)
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise ConfigurationError(
            f"{name}: holds {depth.dtype} of shape {depth.shape}", "give metres of shape (rows, columns)"
        )
    return known_depth(depth)


def _check_array(given: object, name: str) -> None:
    if not isinstance(given, np.ndarray) or isinstance(given, np.ma.MaskedArray):
        raise ConfigurationError(
            f"{name}: is a {type(given).__name__}", "give a NumPy array without a mask, or the path of a file"
        )
