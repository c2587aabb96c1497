"""The calibration board as a page to print: an A4 picture true to scale, with a line of 100 mm to check the print.

Every edge of the pattern lies between two pixels of the picture, so that its lengths are exact.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.board import BOARD, DICTIONARY, Board

__all__ = ["PAGE", "PIXELS_PER_MM", "RULER_MM", "draw_sheet"]

PAGE = (297, 210)
"""A4 across, width and height [mm]."""
PIXELS_PER_MM = 12
RULER_MM = 100
_CAPITALS = 2.4
"""Height of capital letters [mm]."""
_PEN = 3
"""Width of letters and lines [px]: odd, so that a line has a middle."""


def draw_sheet(board: Board = BOARD) -> NDArray[np.uint8]:
    """(h, w) picture, black 0 and white 255, of the page with the board in its middle, PIXELS_PER_MM to scale.

    On it too: the line along which the card is cut, the ruler, the middle of the lower edge and what the board is.
    Raises ValueError for a board that does not fit the page.
    """
    card = 1e3 * np.array(board.size)
    if (card > PAGE).any():
        wanted = f"{card[0]:.0f} x {card[1]:.0f} mm"
        raise ValueError(f"a card of {wanted} does not fit a page of {PAGE[0]} x {PAGE[1]} mm")
    sheet = np.full((PAGE[1] * PIXELS_PER_MM, PAGE[0] * PIXELS_PER_MM), 255, dtype=np.uint8)
    picture = board.image(1e3 * PIXELS_PER_MM)
    left, top = ((np.array(sheet.shape) - picture.shape) // 2)[::-1]
    bottom, right = top + picture.shape[0], left + picture.shape[1]
    sheet[top:bottom, left:right] = picture
    cv2.rectangle(sheet, (left - 1, top - 1), (right, bottom), 0, 1)

    margin = round(1e3 * board.margin * PIXELS_PER_MM)
    _write(sheet, _description(board), left + margin, top + round(0.65 * margin))
    line = bottom - round(0.5 * margin)
    end = _ruler(sheet, left + margin, line)
    _write(sheet, f"{RULER_MM} mm", end + _px(3), line + _px(0.5 * _CAPITALS))
    middle = (left + right) // 2
    cv2.line(sheet, (middle, line - _px(2)), (middle, bottom), 0, _PEN)
    _write(sheet, "lower edge: the tab goes here", middle + _px(3), line + _px(0.5 * _CAPITALS))
    return np.where(sheet > 127, 255, 0).astype(np.uint8)  # letters are drawn with soft edges


def _description(board: Board) -> str:
    wide, high = 1e3 * board.square * board.columns, 1e3 * board.square * board.rows
    return (
        f"foldcell calibration board: ChArUco {board.columns} x {board.rows}, {DICTIONARY}, squares"
        f" {1e3 * board.square:g} mm, markers {1e3 * board.marker:g} mm, pattern {wide:g} x {high:g} mm."
        " A4, scale 1:1: print at 100 %."
    )


def _ruler(sheet: NDArray[np.uint8], x: int, y: int) -> int:
    """A line of RULER_MM from x [px] on, with a tick each 10 mm whose middle counts; returns where it ends."""
    end = x + RULER_MM * PIXELS_PER_MM
    cv2.line(sheet, (x, y), (end, y), 0, _PEN)
    for mm in range(0, RULER_MM + 1, 10):
        half = _px(1.6 if mm in (0, RULER_MM) else 0.8)
        at = x + mm * PIXELS_PER_MM
        cv2.line(sheet, (at, y - half), (at, y + half), 0, _PEN)
    return end


def _write(sheet: NDArray[np.uint8], text: str, x: int, y: int) -> None:
    """x, y: the lower left corner of the text [px]."""
    scale = cv2.getFontScaleFromHeight(cv2.FONT_HERSHEY_SIMPLEX, _px(_CAPITALS), _PEN)
    cv2.putText(sheet, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, 0, _PEN)


def _px(mm: float) -> int:
    return round(mm * PIXELS_PER_MM)
