"""Encode pictures for files and pages. Pictures are (H, W, 3) uint8, red first."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.support.files.whole_file import PNG_MARK, marked_png, refuse_foreign, write_whole

Picture = NDArray[np.uint8]
JPEG_QUALITY = 88


def jpeg_file(picture: Picture, quality: int = JPEG_QUALITY) -> bytes:
    """Return the content of a JPEG file. quality: 0 to 100."""
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def write_png(path: Path, picture: Picture) -> None:
    """Write a PNG with the mark of a picture that foldcell drew. Raises StorageError, and ConfigurationError if a
    file that foldcell did not draw has this path."""
    refuse_foreign(path, PNG_MARK)
    write_whole(path, marked_png(cv2.imencode(".png", picture[:, :, ::-1])[1].tobytes()))


def data_uri(content: bytes, kind: str) -> str:
    """Return the address with which a page holds a picture in itself. content, kind: of its file, as in 'jpeg'."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def shrunk(picture: Picture, width: int) -> Picture:
    """Return the picture, scaled down to this width [px] if it is wider."""
    if picture.shape[1] <= width:
        return picture
    size = width, round(picture.shape[0] * width / picture.shape[1])
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
