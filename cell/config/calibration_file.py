"""Read and write calibration files. `foldcell calibrate` writes them and the cell reads them. There is one file
per kind of calibration.

YAML (or JSON, which is YAML) with `schema: 1` and `kind`:

camera    `intrinsics` (width, height, fx, fy, cx, cy in pixels), `T_table_camera` (4 rows of 4: camera coordinates
          to table coordinates, metres), `head_pan` [rad], and `table_height`: height of the table frame in the
          base frame at the time of the calibration [m]; default: the height of cell.yaml.
table     `height` of the table top in the base frame [m].
tactile   `contact_force`, `held_force` [N].

`provenance` states the origin of the values: for each part the date, the procedure, whether it was simulated, and
the figures. It is information for people and no decision depends on it. A matrix that is not a rigid transform and
a camera that looks away from the table are refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from foldcell.cell.config.yaml_file import read_yaml, validated
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.vocabulary import Array, CameraCalibration, Intrinsics, Table, frozen

FARTHEST_CENTRE = 0.1
"""Largest distance of the principal point from the picture's middle, as a share of its width or height. The
lenses of RGB-D cameras are centred within a few per cent. More means the values of another resolution."""
MOST_OBLONG = 1.2
"""Largest ratio of the two focal lengths. The pixels of cameras are square. More means the values of a
stretched picture."""

_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Row = tuple[_Number, _Number, _Number, _Number]


class _IntrinsicsFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    width: int = Field(ge=16, le=8192, strict=True)
    height: int = Field(ge=16, le=8192, strict=True)
    fx: float = Field(ge=10, le=20000, strict=True, description="focal length in pixels")
    fy: float = Field(ge=10, le=20000, strict=True, description="focal length in pixels")
    cx: float = Field(ge=0, le=8192, strict=True, description="principal point in pixels")
    cy: float = Field(ge=0, le=8192, strict=True, description="principal point in pixels")


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_: int = Field(alias="schema", ge=1, le=1, strict=True, description="version of this file's layout: 1")
    provenance: dict[str, dict[str, Any]] = Field(default={}, description="part -> origin of its values")


class CameraFile(_File):
    """A camera file as read. table_height [m]: None if the file does not state it."""

    kind: Literal["camera"]
    intrinsics: _IntrinsicsFile
    T_table_camera: tuple[_Row, _Row, _Row, _Row] = Field(description="4 rows of 4 numbers")
    head_pan: float = Field(ge=-1.6, le=1.6, strict=True, json_schema_extra={"unit": "rad"})
    table_height: float | None = Field(default=None, ge=-0.6, le=0.5, strict=True, json_schema_extra={"unit": "m"})

    @property
    def calibration(self) -> CameraCalibration:
        intrinsics = Intrinsics(**self.intrinsics.model_dump())
        return CameraCalibration(intrinsics, frozen(np.array(self.T_table_camera)), self.head_pan)


class _TableFile(_File):
    kind: Literal["table"]
    height: float = Field(ge=-0.6, le=0.5, strict=True, allow_inf_nan=False, json_schema_extra={"unit": "m"})


class _TactileFile(_File):
    kind: Literal["tactile"]
    contact_force: float = Field(ge=0.05, le=20.0, strict=True, json_schema_extra={"unit": "N"})
    held_force: float = Field(ge=0.05, le=20.0, strict=True, json_schema_extra={"unit": "N"})


def read_camera_file(path: Path) -> CameraFile:
    """Read a camera file. Raises ConfigurationError if it is not a valid camera calibration."""
    document = read_yaml(path, "camera calibration file")
    file = validated(document, CameraFile)
    calibration = file.calibration
    _check_pose(calibration.T_table_camera, f"{document.where(('T_table_camera',))}: T_table_camera")
    _check_lens(calibration.intrinsics, document.where(("intrinsics",)))
    return file


def load_camera_calibration(path: Path, table: Table | None = None) -> CameraCalibration:
    """Read a camera calibration. If the table's height has changed since the calibration, the camera's pose is
    converted to the frame of the present `table`. None: the pose stays as in the file. Raises
    ConfigurationError."""
    file = read_camera_file(path)
    if table is None or file.table_height is None:
        return file.calibration
    T = np.array(file.T_table_camera)
    T[2, 3] += file.table_height - table.height
    return replace(file.calibration, T_table_camera=frozen(T))


def load_table_height(path: Path) -> float:
    """Read the height of the table top in the base frame [m]. Raises ConfigurationError."""
    return validated(read_yaml(path, "table calibration file"), _TableFile).height


def load_tactile_thresholds(path: Path) -> dict[str, float]:
    """Read contact_force and held_force [N]. The keys are the names of these values in GraspSettings. Raises
    ConfigurationError."""
    file = validated(read_yaml(path, "tactile calibration file"), _TactileFile)
    return {"contact_force": file.contact_force, "held_force": file.held_force}


def calibration_text(
    calibration: CameraCalibration,
    table_height: float | None = None,
    provenance: Mapping[str, Mapping[str, Any]] | None = None,
) -> str:
    """Return the text of a camera file, for `load_camera_calibration`."""
    i = calibration.intrinsics
    data: dict[str, Any] = {
        "intrinsics": {
            "width": i.width,
            "height": i.height,
            **{name: float(getattr(i, name)) for name in ("fx", "fy", "cx", "cy")},
        },
        "T_table_camera": [[float(v) for v in row] for row in calibration.T_table_camera],
        "head_pan": float(calibration.head_pan),
    }
    if table_height is not None:
        data["table_height"] = float(table_height)
    return _text("camera", data, provenance)


def table_text(height: float, provenance: Mapping[str, Mapping[str, Any]] | None = None) -> str:
    """Return the text of a table file."""
    return _text("table", {"height": float(height)}, provenance)


def tactile_text(
    thresholds: Mapping[str, float], provenance: Mapping[str, Mapping[str, Any]] | None = None
) -> str:
    """Return the text of a tactile file."""
    return _text("tactile", {name: float(value) for name, value in thresholds.items()}, provenance)


def _text(kind: str, data: Mapping[str, Any], provenance: Mapping[str, Mapping[str, Any]] | None) -> str:
    origin = {"provenance": {part: dict(notes) for part, notes in provenance.items()}} if provenance else {}
    return yaml.safe_dump({"schema": 1, "kind": kind, **data, **origin}, sort_keys=False, allow_unicode=True)


def _check_lens(lens: Intrinsics, where: str) -> None:
    for name, centre, side in (("cx", lens.cx, lens.width), ("cy", lens.cy, lens.height)):
        middle = 0.5 * (side - 1)
        off, most = abs(centre - middle), FARTHEST_CENTRE * side
        if off > most:
            raise ConfigurationError(
                f"{where}: intrinsics.{name} = {centre:g}: the principal point is {off:.0f} pixels "
                f"from the middle ({middle:g}) of {side} pixels; at most {most:.0f} are plausible",
                f"it looks like that of a picture of about {round(2 * centre + 1)} pixels: give the values of the "
                "resolution that is used, or calibrate the camera again",
            )
    if not 1.0 / MOST_OBLONG <= lens.fx / lens.fy <= MOST_OBLONG:
        raise ConfigurationError(
            f"{where}: intrinsics.fx = {lens.fx:g}, fy = {lens.fy:g}: the pixels would not be square",
            "give the values of the resolution that is used, or calibrate the camera again",
        )


def _check_pose(T: Array, where: str) -> None:
    R = T[:3, :3]
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0:
        raise ConfigurationError(
            f"{where}: not a rotation (R R^T differs from the identity by {np.abs(R @ R.T - np.eye(3)).max():.2g},"
            f" determinant {np.linalg.det(R):.3g})",
            "calibrate the camera again",
        )
    if not np.allclose(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise ConfigurationError(f"{where}: the last row has to be 0, 0, 0, 1", "calibrate the camera again")
    if not 0.1 <= T[2, 3] <= 5.0 or np.abs(T[:2, 3]).max() > 5.0:
        raise ConfigurationError(
            f"{where}: the camera would be at ({T[0, 3]:g}, {T[1, 3]:g}, {T[2, 3]:g}) m in the table frame;"
            " the allowed height above the table is 0.1 to 5 m",
            "looks like millimetres" if np.abs(T[:3, 3]).max() > 50 else "calibrate the camera again",
        )
    if R[2, 2] > -0.1:
        raise ConfigurationError(
            f"{where}: the camera looks away from the table",
            "give the transform from camera to table; the camera's z axis is its viewing direction",
        )
