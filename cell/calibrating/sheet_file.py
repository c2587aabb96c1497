"""Encode a page as a file that prints to scale: a PNG with its resolution, or a PDF of one page."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.support.files.whole_file import PNG_MARK, marked_png
from foldcell.robots.errors import InternalError

Picture = NDArray[np.uint8]
POINT_MM = 25.4 / 72.0


def png_page(picture: Picture, pixels_per_mm: int) -> bytes:
    """Encode an image (h, w) with values 0 and 255 as PNG, one bit per pixel. The resolution is added here,
    because OpenCV does not write it."""
    good, encoded = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_BILEVEL, 1])
    if not good:
        raise InternalError("OpenCV could not encode the sheet as PNG")
    resolution = b"pHYs" + struct.pack(">IIB", 1000 * pixels_per_mm, 1000 * pixels_per_mm, 1)
    return marked_png(marked_png(encoded.tobytes()), resolution)


def pdf_page(picture: Picture, pixels_per_mm: int) -> bytes:
    """Encode an image (h, w) with values 0 and 255 as a PDF of one page, which has the image's size on paper. The
    PDF asks the viewer to print without scaling."""
    h, w = picture.shape
    wide, high = (n / pixels_per_mm / POINT_MM for n in (w, h))
    pixels = zlib.compress(np.packbits(picture > 127, axis=1).tobytes(), 9)
    drawing = f"q {wide:.4f} 0 0 {high:.4f} 0 0 cm /Sheet Do Q".encode()
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {wide:.4f} {high:.4f}] /Contents 4 0 R"
        " /Resources << /XObject << /Sheet 5 0 R >> >> >>".encode(),
        _stream("", drawing),
        _stream(
            f"/Type /XObject /Subtype /Image /Width {w} /Height {h} /ColorSpace /DeviceGray /BitsPerComponent 1"
            " /Filter /FlateDecode ",
            pixels,
        ),
    ]
    file = b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n"
    starts = []
    for number, body in enumerate(objects, 1):
        starts.append(len(file))
        file += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    table = "".join(f"{start:010} 00000 n \n" for start in starts)
    return (
        file
        + (
            f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}"
            f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{len(file)}\n%%EOF\n"
        ).encode()
    )


def _stream(entries: str, data: bytes) -> bytes:
    return f"<< {entries}/Length {len(data)} >>\nstream\n".encode() + data + b"\nendstream"


SHEET_FORMATS: Mapping[str, Callable[[Picture, int], bytes]] = {".pdf": pdf_page, ".png": png_page}
"""Encoders by file name suffix."""
SHEET_MARKS: Mapping[str, bytes] = {".pdf": b"/Resources << /XObject << /Sheet 5 0 R >> >>", ".png": PNG_MARK}
"""Text that every sheet contains, by file name suffix."""
