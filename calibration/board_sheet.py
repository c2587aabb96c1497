"""Draw the calibration board as a page to print: an A4 image to scale, with a 100 mm line to check the print.

Every edge of the pattern coincides with a border between two pixels, so the pattern's lengths are exact.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.calibration.board import BOARD, DICTIONARY

PAGE = (297, 210)
"""Width and height of the page (A4 landscape) [mm]."""
PIXELS_PER_MM = 12
RULER_MM = 100
_CAPITALS = 2.4
"""Height of capital letters [mm]."""
_PEN = 3
"""Stroke width of letters and lines [px]. It is odd, so that a line has a middle pixel."""


def draw_sheet() -> NDArray[np.uint8]:
    """Return an image (h, w) of the page, black 0 and white 255, with PIXELS_PER_MM and the board in the middle.

    The page also shows the cutting line, the ruler, the middle of the lower edge and the board's description.
    """
    sheet = np.full((PAGE[1] * PIXELS_PER_MM, PAGE[0] * PIXELS_PER_MM), 255, dtype=np.uint8)
    picture = BOARD.image(1e3 * PIXELS_PER_MM)
    left, top = ((np.array(sheet.shape) - picture.shape) // 2)[::-1]
    bottom, right = top + picture.shape[0], left + picture.shape[1]
    sheet[top:bottom, left:right] = picture
    cv2.rectangle(sheet, (left - 1, top - 1), (right, bottom), 0, 1)

    margin = round(1e3 * BOARD.margin * PIXELS_PER_MM)
    _write(sheet, _description(), left + margin, top + round(0.65 * margin))
    line = bottom - round(0.5 * margin)
    end = _ruler(sheet, left + margin, line)
    _write(sheet, f"{RULER_MM} mm", end + _px(3), line + _px(0.5 * _CAPITALS))
    middle = (left + right) // 2
    cv2.line(sheet, (middle, line - _px(2)), (middle, bottom), 0, _PEN)
    _write(sheet, "lower edge: the tab goes here", middle + _px(3), line + _px(0.5 * _CAPITALS))
    return np.where(sheet > 127, 255, 0).astype(np.uint8)  # OpenCV anti-aliases letters


def _description() -> str:
    wide, high = 1e3 * BOARD.square * BOARD.columns, 1e3 * BOARD.square * BOARD.rows
    return (
        f"foldcell calibration board: ChArUco {BOARD.columns} x {BOARD.rows}, {DICTIONARY}, squares"
        f" {1e3 * BOARD.square:g} mm, markers {1e3 * BOARD.marker:g} mm, pattern {wide:g} x {high:g} mm."
        " A4, scale 1:1: print at 100 %."
    )


def _ruler(sheet: NDArray[np.uint8], x: int, y: int) -> int:
    """Draw a line of RULER_MM that starts at x [px], with a tick every 10 mm. The middle of a tick's stroke
    marks the exact length. Returns the end of the line [px]."""
    end = x + RULER_MM * PIXELS_PER_MM
    cv2.line(sheet, (x, y), (end, y), 0, _PEN)
    for mm in range(0, RULER_MM + 1, 10):
        half = _px(1.6 if mm in (0, RULER_MM) else 0.8)
        at = x + mm * PIXELS_PER_MM
        cv2.line(sheet, (at, y - half), (at, y + half), 0, _PEN)
    return end


def _write(sheet: NDArray[np.uint8], text: str, x: int, y: int) -> None:
    """Write a text. x, y: lower left corner of the text [px]."""
    scale = cv2.getFontScaleFromHeight(cv2.FONT_HERSHEY_SIMPLEX, _px(_CAPITALS), _PEN)
    cv2.putText(sheet, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, 0, _PEN)


def _px(mm: float) -> int:
    return round(mm * PIXELS_PER_MM)
