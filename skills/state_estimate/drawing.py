"""Draws the candidates of an estimate over the picture, each with its probability."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState
from foldcell.skills.state_estimate.observation import Observation

MARGIN = 30
"""Width of the picture around the outlines [px]."""
HEAD, GAP = 26, 6
BACKGROUND = 26
_OBSERVED, _BEST, _OTHER = (255, 255, 255), (40, 220, 90), (255, 150, 40)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_CAPTIONS = {
    FoldState.BEFORE: "before the fold",
    FoldState.HALF_WAY: "half way",
    FoldState.AFTER: "after the fold",
    FoldState.HEAP: "a heap",
}


def draw_estimate(seen: Observation, estimate: StateEstimate) -> NDArray[np.uint8]:
    """Draw one panel for each state that has a candidate, in rows of two, RGB (H, W, 3), seen from above.

    White: the outline of the garment in the picture. Green: the candidate of the estimated state; orange: the
    other candidates.
    """
    candidates = [(state, found.outline) for state in FoldState if (found := estimate.of_state(state)) is not None]
    if estimate.state is FoldState.HEAP:
        candidates.append((FoldState.HEAP, np.zeros((0, 2))))
    outlines = [
        seen.view.to_pixel(outline) for outline in (seen.contour, *(o for _, o in candidates)) if len(outline)
    ]
    low = np.maximum(np.vstack(outlines).min(axis=0) - MARGIN, 0).astype(int)
    high = np.minimum(np.vstack(outlines).max(axis=0) + MARGIN, seen.mask.shape[::-1]).astype(int)
    panels = []
    for state, outline in candidates:
        panel = np.asarray(seen.rgb * np.float32(0.7), dtype=np.uint8)
        _line(panel, seen.view.to_pixel(seen.contour), _OBSERVED)
        if len(outline):
            _line(panel, seen.view.to_pixel(outline), _BEST if state is estimate.state else _OTHER)
        caption = f"{_CAPTIONS[state]}: {estimate.probabilities[state]:.2f}"
        panels.append(_captioned(panel[low[1] : high[1], low[0] : high[0]], caption))
    return _stacked(panels)


def _stacked(panels: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Place the panels in rows of two."""
    if len(panels) % 2 and len(panels) > 1:
        panels = [*panels, np.full_like(panels[0], BACKGROUND)]
    return np.vstack([np.hstack(panels[k : k + 2]) for k in range(0, len(panels), 2)])


def _line(picture: NDArray[np.uint8], pixels: Array, colour: tuple[int, ...]) -> None:
    points = np.round(pixels * 16).astype(np.int32)
    cv2.polylines(picture, [points], True, (0, 0, 0), 3, cv2.LINE_AA, 4)
    cv2.polylines(picture, [points], True, colour, 1, cv2.LINE_AA, 4)


def _captioned(panel: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    out = cv2.copyMakeBorder(panel, HEAD, 0, 0, GAP, cv2.BORDER_CONSTANT, value=(BACKGROUND,) * 3)
    cv2.putText(out, text, (6, 18), _FONT, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return np.asarray(out, dtype=np.uint8)
