"""Recognition of a garment in one picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Union

from foldcell.settings import Settings, cell_settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cell.hardware.photograph import Photograph
    from robots.errors import Failure
    from robots.ports import Array

__all__ = ["Image", "PerceivedGarment", "perceive"]

Image: TypeAlias = Union["NDArray[Any]", Path, str]
"""An array or a file."""


@dataclass(frozen=True, eq=False)
class PerceivedGarment:
    """What lies on the table.

    garment: name of the one whose template fits; category: its kind. confidence: 0..1. ambiguous: symmetries that
    the picture does not resolve. unit: 'm' [m] in the table frame (x forward, y left), or 'px', column and row in
    the picture. keypoints: name -> (2,). contour: (n, 2), not closed, counter-clockwise in the table frame.

    failure: why no garment was accepted; garment and category are None then, confidence 0 and the rest empty.
    """

    garment: str | None
    category: str | None
    confidence: float
    ambiguous: tuple[str, ...]
    unit: str
    keypoints: Mapping[str, Array]
    contour: Array
    failure: Failure | None


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
    """Find the garment in a picture: its kind, key points and outline.

    rgb: (H, W, 3) uint8, red first, or a PNG or JPEG file. depth: (H, W) floats [m] along the optical axis, 0,
    negative or NaN where nothing was measured, or a file (16-bit PNG in millimetres, `.npy` in metres). garment:
    the expected one, a name or a file; None: any of the shipped ones. reference, reference_depth: pictures of the
    empty table. unit: 'm' for a picture by the cell's own camera, calibrated as the settings say; 'px' for one
    taken from above by an unknown camera.

    Raises ConfigurationError for an argument or a file that is wrong, and for a picture of another size than the
    calibrated camera's.
    """
    import numpy as np

    from cell.hardware.photograph import in_unit, perceive_photograph
    from robots.errors import ConfigurationError

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
        "auto" if garment is None else str(garment),
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
    """name, depth_name: of the arguments, for messages about arrays."""
    from cell.hardware.photograph import Photograph
    from cell.support.files.picture_file import read_depth, read_picture

    if isinstance(rgb, str | Path):
        name, picture = str(rgb), read_picture(Path(rgb))
    else:
        picture = _colours(rgb, name)
    if depth is None:
        return Photograph(picture, None, name, depth_name)
    if isinstance(depth, str | Path):
        return Photograph(picture, read_depth(Path(depth)), name, str(depth))
    return Photograph(picture, _metres(depth, depth_name), name, depth_name)


def _colours(rgb: NDArray[Any], name: str) -> NDArray[Any]:
    import numpy as np

    from robots.errors import ConfigurationError

    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
        raise ConfigurationError(
            f"{name}: holds {rgb.dtype} of shape {rgb.shape}", "give 8-bit colours of shape (rows, columns, 3)"
        )
    return np.ascontiguousarray(rgb)


def _metres(depth: NDArray[Any], name: str) -> NDArray[Any]:
    from cell.support.files.picture_file import known_depth
    from robots.errors import ConfigurationError

    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise ConfigurationError(
            f"{name}: holds {depth.dtype} of shape {depth.shape}", "give metres of shape (rows, columns)"
        )
    return known_depth(depth)
