"""Read pictures and depth images from files, as arrays."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.support.process.library_messages import captured_messages
from foldcell.robots.errors import ConfigurationError

MILLIMETRES = 1e-3
LARGEST_FILE = 2**29
"""The rest of a larger file is not read [bytes]."""
LARGEST_PICTURE = 2**28
"""A picture with more pixels is not decoded."""
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
DAMAGED = ("premature end", "Premature end", "bad Huffman code", "instead of RST")
"""Parts of libjpeg's messages about a picture with missing or invalid data. libjpeg returns such a picture with
invented pixels."""


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Read a picture (H, W, 3) RGB. Raises ConfigurationError for a file that is not a picture."""
    return _read_image(path, cv2.IMREAD_COLOR_RGB)


def read_depth(path: Path) -> NDArray[np.float32]:
    """Read a depth image (H, W) [m], NaN where nothing was measured. The file is `.npy` in metres, or a 16-bit
    picture in millimetres. Raises ConfigurationError for any other file."""
    if path.suffix == ".npy":
        try:
            raw = np.load(path, mmap_mode="r", allow_pickle=False)  # its header may state any size
        except (OSError, ValueError, EOFError) as e:
            raise ConfigurationError(f"{path}: is no array that can be read: {e}", path=str(path)) from e
        if not isinstance(raw, np.ndarray):
            raw.close()
            raise ConfigurationError(
                f"{path}: is no single array (an .npz holds several)", "save it with numpy.save", path=str(path)
            )
        if raw.size > LARGEST_PICTURE:
            raise _too_large(path, raw.size)
        metres = raw.astype(np.float32) if raw.ndim == 2 and raw.dtype.kind == "f" else None
    else:
        raw = _read_image(path, cv2.IMREAD_UNCHANGED)
        metres = raw.astype(np.float32) * MILLIMETRES if raw.ndim == 2 and raw.dtype == np.uint16 else None
    if metres is None:
        raise ConfigurationError(
            f"{path}: holds {raw.dtype} of shape {raw.shape}", "give 16-bit millimetres (PNG) or metres (.npy)"
        )
    return known_depth(metres)


def known_depth(metres: NDArray) -> NDArray[np.float32]:
    """Return the depth (H, W) [m], with NaN in place of zero and negative values."""
    return np.where(metres > 0, metres, np.nan).astype(np.float32)


def _read_image(path: Path, flags: int) -> NDArray:
    try:
        with path.open("rb") as file:  # which may be a device without an end
            data = file.read(LARGEST_FILE)
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be read: {e.strerror}", "check the path", path=str(path)) from e
    if (pixels := _stated_pixels(data)) > LARGEST_PICTURE:
        raise _too_large(path, pixels)
    with captured_messages() as messages:
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
        except cv2.error:  # the file states an impossible picture size
            image = None
        said = messages()
    if image is None:
        raise ConfigurationError(
            f"{path}: is no picture that can be read (PNG or JPEG)", "export or copy it anew", path=str(path)
        )
    if any(message in said for message in DAMAGED):
        raise ConfigurationError(
            f"{path}: the picture is damaged; a part of it is missing", "export or copy it anew", path=str(path)
        )
    return np.asarray(image)


def _too_large(path: Path, pixels: int) -> ConfigurationError:
    most = f"{pixels / 1e6:.0f} million pixels, at most {LARGEST_PICTURE / 1e6:.0f} are read"
    return ConfigurationError(f"{path}: has {most}", "export it smaller", path=str(path))


def _stated_pixels(data: bytes) -> int:
    """Return the number of pixels that the header of a PNG or JPEG file states; 0 if there is no such header."""
    if data.startswith(PNG_SIGNATURE) and len(data) >= 24:
        columns, rows = struct.unpack(">II", data[16:24])
        return int(columns * rows)
    at = 2
    while data.startswith(b"\xff\xd8") and at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # the header of a frame
            rows, columns = struct.unpack(">HH", data[at + 5 : at + 9])
            return int(columns * rows)
        at += 2 + length
    return 0
