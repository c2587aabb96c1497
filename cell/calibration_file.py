"""The camera's calibration: read from its file, or taken from the bracket's drawing.

The file is YAML (or JSON, which is YAML): `schema: 1`, `kind: camera`, `intrinsics` (width, height, fx, fy,
cx, cy in pixels), `T_table_camera` (4 rows of 4: camera coordinates to table coordinates, metres) and
`head_pan` [rad]. A matrix that is no rigid motion, or a camera that looks away from the table, is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from cell.camera import nominal_calibration
from cell.config import CellSettings
from cell.yaml_file import read_yaml, validated
from robots.errors import ConfigurationError
from skills.vocabulary import Array, CameraCalibration, Intrinsics, frozen

__all__ = ["calibration_text", "camera_calibration", "load_camera_calibration"]

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


class _CameraFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_: Literal[1] = Field(alias="schema")
    kind: Literal["camera"]
    intrinsics: _IntrinsicsFile
    T_table_camera: tuple[_Row, _Row, _Row, _Row] = Field(description="4 rows of 4 numbers")
    head_pan: float = Field(ge=-1.6, le=1.6, strict=True, json_schema_extra={"unit": "rad"})


def load_camera_calibration(path: Path) -> CameraCalibration:
    """Read a calibration file. Raises ConfigurationError for a file that cannot be used as one."""
    document = read_yaml(path, "camera calibration file")
    file = validated(document, _CameraFile)
    T = np.array(file.T_table_camera)
    _check_pose(T, f"{document.where(('T_table_camera',))}: T_table_camera")
    return CameraCalibration(Intrinsics(**file.intrinsics.model_dump()), frozen(T), file.head_pan)


def calibration_text(calibration: CameraCalibration) -> str:
    """The file's text for a calibration: what `load_camera_calibration` reads back."""
    i = calibration.intrinsics
    data = {
        "schema": 1,
        "kind": "camera",
        "intrinsics": {
            "width": i.width,
            "height": i.height,
            **{name: float(getattr(i, name)) for name in ("fx", "fy", "cx", "cy")},
        },
        "T_table_camera": [[float(v) for v in row] for row in calibration.T_table_camera],
        "head_pan": float(calibration.head_pan),
    }
    return yaml.safe_dump(data, sort_keys=False)


def camera_calibration(settings: CellSettings) -> CameraCalibration:
    """What the executive believes of its camera: the file that the settings name, or the bracket's drawing."""
    if settings.camera.calibration is not None:
        return load_camera_calibration(settings.camera.calibration)
    return nominal_calibration(settings.table)


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
            f"{where}: the camera would stand at ({T[0, 3]:g}, {T[1, 3]:g}, {T[2, 3]:g}) m in the table frame;"
            " allowed is 0.1 to 5 m above the table",
            "looks like millimetres" if np.abs(T[:3, 3]).max() > 50 else "calibrate the camera again",
        )
    if R[2, 2] > -0.1:
        raise ConfigurationError(
            f"{where}: the camera looks away from the table",
            "its z axis is the view: give camera to table, with z towards the table",
        )
