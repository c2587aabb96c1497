"""Draws the perceived mask, contour, key points and confidence over a picture. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.perceive import Perception
from skills.perception.rectification.table_view import TableView
from skills.perception.segmentation.mask import Segmentation

__all__ = ["draw_on_camera", "draw_on_view", "draw_overlay", "draw_region"]

_TINT = (60, 160, 255)
_CONTOUR = (40, 220, 90)
_POINT = (255, 70, 60)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_overlay(
    rgb: NDArray[np.uint8],
    mask: NDArray[np.bool_] | None = None,
    contour: Array | None = None,
    keypoints: Mapping[str, Array] | None = None,
    title: str = "",
) -> NDArray[np.uint8]:
    """Return a copy of rgb (H, W, 3) with the given items drawn over it.

    mask: (H, W). contour: (n, 2) closed, and keypoints: name -> (2,), both in pixels (column, row) of `rgb`.
    title: one line at the top, for category and confidence.
    """
    out = np.ascontiguousarray(rgb).copy()
    if mask is not None and mask.any():
        tinted = out[mask].astype(np.float32) * 0.65 + np.array(_TINT, np.float32) * 0.35
        out[mask] = np.round(tinted).astype(np.uint8)
    if contour is not None and len(contour) > 1:
        cv2.polylines(out, [_fixed_point(contour)], True, (0, 0, 0), 3, cv2.LINE_AA, 4)
        cv2.polylines(out, [_fixed_point(contour)], True, _CONTOUR, 1, cv2.LINE_AA, 4)
    points = {name: np.asarray(p, dtype=float) for name, p in (keypoints or {}).items()}
    middle = np.mean(list(points.values()), axis=0) if points else np.zeros(2)
    for point in points.values():
        cv2.circle(out, _rounded(point), 5, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(out, _rounded(point), 4, _POINT, -1, cv2.LINE_AA)
    for name, point in points.items():
        _label(out, name, point, middle)
    if title:
        _text(out, title, (8, 20), 0.55)
    return out


def draw_on_view(perception: Perception) -> NDArray[np.uint8]:
    """Draw the perception over its rectified picture; the result is (H, W, 3)."""
    view, state = perception.view, perception.state
    return draw_overlay(
        perception.rgb,
        perception.mask,
        view.to_pixel(state.contour),
        {name: view.to_pixel(p) for name, p in state.keypoints.items()},
        _title(perception),
    )


def draw_on_camera(perception: Perception, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw the perception over the camera's picture rgb (H, W, 3) from which it was made."""
    view, state = perception.view, perception.state
    size = (rgb.shape[1], rgb.shape[0])
    mask = cv2.warpPerspective(perception.mask.astype(np.uint8), view.homography, size, flags=cv2.INTER_NEAREST)
    return draw_overlay(
        rgb,
        mask > 0,
        view.to_image(state.contour),
        {name: view.to_image(p) for name, p in state.keypoints.items()},
        _title(perception),
    )


def draw_region(
    view: TableView, segmentation: Segmentation, rgb: NDArray[np.uint8], title: str
) -> NDArray[np.uint8]:
    """Draw the picture of a refusal over the camera's picture rgb (H, W, 3): area and outline of what was taken
    for the garment, and in red the outlines of the other things. title: one line at the top."""
    size = (rgb.shape[1], rgb.shape[0])

    def in_picture(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
        warped = cv2.warpPerspective(mask.astype(np.uint8), view.homography, size, flags=cv2.INTER_NEAREST)
        return np.asarray(warped, dtype=np.uint8)

    contour = view.to_image(view.to_table(segmentation.contour, 0.0)) if segmentation.found else None
    out = draw_overlay(rgb, in_picture(segmentation.mask) > 0, contour, title=title)
    others, _ = cv2.findContours(in_picture(segmentation.others), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(out, others, -1, _POINT, 2, cv2.LINE_AA)
    return out


def _title(perception: Perception) -> str:
    return f"{perception.garment}  confidence {perception.state.confidence:.2f}"


def _fixed_point(points: Array) -> NDArray[np.int32]:
    return np.round(np.asarray(points) * 16).astype(np.int32)


def _rounded(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _label(out: NDArray[np.uint8], name: str, point: Array, middle: Array) -> None:
    """Write a key point's name beside it, on the side away from the garment's middle, but within the picture."""
    (width, height), _ = cv2.getTextSize(name, _FONT, 0.42, 1)
    x = point[0] + 8 if point[0] >= middle[0] else point[0] - 8 - width
    y = point[1] - 6 if point[1] < middle[1] else point[1] + 8 + height
    x = float(np.clip(x, 2, out.shape[1] - width - 2))
    y = float(np.clip(y, height + 2, out.shape[0] - 4))
    _text(out, name, (int(x), int(y)), 0.42)


def _text(out: NDArray[np.uint8], text: str, place: tuple[int, int], size: float) -> None:
    """Write white text on a darkened box, so that it is legible on any background."""
    (width, height), base = cv2.getTextSize(text, _FONT, size, 1)
    top, left = max(place[1] - height - 3, 0), max(place[0] - 3, 0)
    box = out[top : place[1] + base, left : place[0] + width + 3]
    box[:] = (box * np.float32(0.35)).astype(np.uint8)
    cv2.putText(out, text, place, _FONT, size, (255, 255, 255), 1, cv2.LINE_AA)
