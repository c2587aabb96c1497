"""Draws a registration, as in the paper: initial template, contour after each round, and result. Pure."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.overlay import draw_overlay
from skills.perception.perceive import Perception

__all__ = ["draw_fitting"]

_MARGIN = 45
_GAP = 6
_OBSERVED, _INITIAL, _FINAL = (255, 255, 255), (255, 150, 40), (40, 220, 90)


def draw_fitting(perception: Perception) -> NDArray[np.uint8]:
    """Draw three panels side by side, RGB (H, W, 3), cropped around the garment in the rectified view."""
    view, stages = perception.view, perception.registration.stages
    dimmed = _dimmed(perception.rgb, perception.mask)
    initial, steps = dimmed.copy(), dimmed.copy()
    _line(initial, perception.segmentation.contour, _OBSERVED, 1)
    _line(initial, view.to_pixel(stages[0]), _INITIAL, 2)
    for i, stage in enumerate(stages):
        share = i / max(len(stages) - 1, 1)
        colour = tuple(round((1 - share) * a + share * b) for a, b in zip(_INITIAL, _FINAL, strict=True))
        _line(steps, view.to_pixel(stage), colour, 2 if i == len(stages) - 1 else 1)
    state = perception.state
    names = {name: view.to_pixel(p) for name, p in state.keypoints.items()}
    box = _crop(perception.segmentation.contour, dimmed.shape)
    corner = np.array([box[1].start, box[0].start])
    result = draw_overlay(
        np.ascontiguousarray(perception.rgb[box]), None, view.to_pixel(state.contour) - corner,
        {name: p - corner for name, p in names.items()},
    )  # fmt: skip
    captions = (
        "template as laid on", f"{len(stages) - 1} updates of the reference",
        f"{perception.garment}  {state.confidence:.2f}",
    )  # fmt: skip
    panels = [initial[box], steps[box], result]
    return np.hstack([_captioned(panel, text) for panel, text in zip(panels, captions, strict=True)])


def _dimmed(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Darken the picture, the garment less than the rest, so that coloured lines are easy to see."""
    share = np.where(mask, np.float32(0.75), np.float32(0.4))
    return np.asarray(rgb * share[..., None], dtype=np.uint8)


def _line(picture: NDArray[np.uint8], pixels: Array, colour: tuple[int, ...], width: int) -> None:
    points = np.round(np.asarray(pixels) * 16).astype(np.int32)
    cv2.polylines(picture, [points], True, colour, width, cv2.LINE_AA, 4)


def _crop(contour: Array, shape: tuple[int, ...]) -> tuple[slice, slice]:
    low, high = contour.min(axis=0) - _MARGIN, contour.max(axis=0) + _MARGIN
    left, top = (max(int(v), 0) for v in low)
    right, bottom = min(int(high[0]), shape[1]), min(int(high[1]), shape[0])
    return slice(top, bottom), slice(left, right)


def _captioned(panel: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    out = cv2.copyMakeBorder(panel, 26, 0, 0, _GAP, cv2.BORDER_CONSTANT, value=(24, 26, 30))
    cv2.putText(out, text, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return np.asarray(out, dtype=np.uint8)
