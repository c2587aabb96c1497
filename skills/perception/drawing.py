"""Draws what was perceived over a picture: mask, contour, key points and confidence, or the course of the
registration, as in the paper. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.perceive import Perception, Sought
from foldcell.skills.perception.rectification.table_view import TableView

_TINT = (60, 160, 255)
_CONTOUR = (40, 220, 90)
_POINT = (255, 70, 60)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_MARGIN = 45
_GAP = 6
_OBSERVED, _INITIAL, _FINAL = (255, 255, 255), (255, 150, 40), (40, 220, 90)


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
        _line(out, contour, (0, 0, 0), 3)
        _line(out, contour, _CONTOUR, 1)
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


def draw_on_camera(perception: Perception, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw the perception over the camera's picture rgb (H, W, 3) from which it was made."""
    view, state = perception.view, perception.state
    return draw_overlay(
        rgb,
        _in_picture(perception.mask, view, rgb) > 0,
        view.to_image(state.contour),
        {name: view.to_image(p) for name, p in state.keypoints.items()},
        _title(perception),
    )


def draw_sought(sought: Sought, rgb: NDArray[np.uint8], title: str) -> NDArray[np.uint8]:
    """Draw the picture of a refusal over the camera's picture rgb (H, W, 3): area and outline of what was taken
    for the garment, in red the outlines of the other things, the expected places of the key points, and a cross
    where the missing one was expected. title: one line at the top."""
    view, segmentation = sought.view, sought.segmentation
    contour = view.to_image(view.to_table(segmentation.contour)) if segmentation.found else None
    places = {name: view.to_image(place) for name, place in sought.places.items()}
    missing = places.pop(sought.missing, None) if sought.missing is not None else None
    out = draw_overlay(rgb, _in_picture(segmentation.mask, view, rgb) > 0, contour, places, title)
    others, _ = cv2.findContours(
        _in_picture(segmentation.others, view, rgb), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(out, others, -1, _POINT, 2, cv2.LINE_AA)
    if missing is not None:
        at = np.clip(missing, 0, (rgb.shape[1] - 1, rgb.shape[0] - 1))
        cv2.drawMarker(out, _rounded(at), (255, 255, 255), cv2.MARKER_TILTED_CROSS, 26, 6, cv2.LINE_AA)
        cv2.drawMarker(out, _rounded(at), _POINT, cv2.MARKER_TILTED_CROSS, 24, 3, cv2.LINE_AA)
        _label(out, f"{sought.missing}?", at, np.mean([missing, *places.values()], axis=0))
    return out


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


def _in_picture(mask: NDArray[np.bool_], view: TableView, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Warp a mask of the view to the camera's picture rgb (h, w, 3): (h, w), 1 inside."""
    size = (rgb.shape[1], rgb.shape[0])
    warped = cv2.warpPerspective(mask.astype(np.uint8), view.homography, size, flags=cv2.INTER_NEAREST)
    return np.asarray(warped, dtype=np.uint8)


def _title(perception: Perception) -> str:
    return f"{perception.garment}  confidence {perception.state.confidence:.2f}"


def _line(picture: NDArray[np.uint8], pixels: Array, colour: tuple[int, ...], width: int) -> None:
    """Draw a closed line through pixels (n, 2) (column, row)."""
    points = np.round(np.asarray(pixels) * 16).astype(np.int32)
    cv2.polylines(picture, [points], True, colour, width, cv2.LINE_AA, 4)


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


def _dimmed(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Darken the picture, the garment less than the rest, so that coloured lines are easy to see."""
    share = np.where(mask, np.float32(0.75), np.float32(0.4))
    return np.asarray(rgb * share[..., None], dtype=np.uint8)


def _crop(contour: Array, shape: tuple[int, ...]) -> tuple[slice, slice]:
    low, high = contour.min(axis=0) - _MARGIN, contour.max(axis=0) + _MARGIN
    left, top = (max(int(v), 0) for v in low)
    right, bottom = min(int(high[0]), shape[1]), min(int(high[1]), shape[0])
    return slice(top, bottom), slice(left, right)


def _captioned(panel: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    out = cv2.copyMakeBorder(panel, 26, 0, 0, _GAP, cv2.BORDER_CONSTANT, value=(24, 26, 30))
    cv2.putText(out, text, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return np.asarray(out, dtype=np.uint8)
