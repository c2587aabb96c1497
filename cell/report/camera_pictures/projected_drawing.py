"""Draws points and lines of the table frame over a camera picture."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.vocabulary import CameraCalibration

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

SCALE = 2.0
"""Pictures that stay are enlarged by this factor, so that lines and words are legible from two metres."""
NEAREST = 0.05
"""Points nearer to the camera than this are not drawn [m]."""
DARK, WHITE = (18, 20, 24), (255, 255, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FRACTION = 4
"""Binary digits of fractions of a pixel that cv2 draws with."""


class ProjectedDrawing:
    """One picture that is drawn on. Points are in the table frame, (n, 2) on the table or (n, 3) [m]."""

    def __init__(self, frame: CameraFrame, calibration: CameraCalibration, scale: float = SCALE) -> None:
        """scale: the camera's picture is enlarged by this factor."""
        k, (height, width) = calibration.intrinsics, frame.rgb.shape[:2]
        size = round(scale * width), round(scale * height)
        self._scale = scale
        self.picture: Picture = np.asarray(
            cv2.resize(frame.rgb, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8
        )
        self._camera = np.linalg.inv(calibration.T_table_camera)
        self._focal, self._centre = np.array([k.fx, k.fy]), np.array([k.cx, k.cy])

    def pixels(self, points: Array) -> Array:
        """Project points (n, 2 or 3) to pixels (n, 2) of the enlarged picture. NaN: behind the camera."""
        p = np.atleast_2d(np.asarray(points, dtype=np.float64))
        if p.shape[1] == 2:
            p = np.column_stack([p, np.zeros(len(p))])
        seen = p @ self._camera[:3, :3].T + self._camera[:3, 3]
        z = np.where(seen[:, 2:] > NEAREST, seen[:, 2:], np.nan)
        return self._scale * (self._focal * seen[:, :2] / z + self._centre)

    def line(self, points: Array, colour: Colour, width: int = 3, closed: bool = False) -> None:
        """Draw a line with a dark border, so that it shows on every cloth."""
        self._lines([points], colour, width, closed)

    def dashes(
        self, points: Array, colour: Colour, width: int = 3, dash: float = 0.012, closed: bool = False
    ) -> None:
        """Draw a dashed line; dash: length of a dash and of a gap [m]."""
        self._lines(dashed(np.vstack([points, points[:1]]) if closed else points, dash), colour, width, False)

    def dot(self, point: Array, colour: Colour, radius: int = 9) -> None:
        p = self.pixels(point)[0]
        if not np.all(np.isfinite(p)):
            return
        centre = (round(float(p[0])), round(float(p[1])))
        cv2.circle(self.picture, centre, radius + 2, DARK, -1, cv2.LINE_AA)
        cv2.circle(self.picture, centre, radius, colour, -1, cv2.LINE_AA)

    def shade(self, areas: Sequence[Array], colour: Colour, opacity: float = 0.35) -> None:
        """Tint areas, each a closed outline (n, 2 or 3)."""
        runs = [run for run in (self._fixed(area) for area in areas) if len(run) >= 3]
        if not runs:
            return
        layer = self.picture.copy()
        cv2.fillPoly(layer, runs, colour, cv2.LINE_AA, _FRACTION)
        self.picture = np.asarray(
            cv2.addWeighted(layer, opacity, self.picture, 1.0 - opacity, 0.0), dtype=np.uint8
        )

    def name(self, text: str, point: Array, colour: Colour = WHITE, offset: tuple[int, int] = (12, -10)) -> None:
        """Write a name beside a point."""
        p = self.pixels(point)[0]
        if np.all(np.isfinite(p)):
            self._text(text, int(p[0]) + offset[0], int(p[1]) + offset[1], 0.55, colour)

    def title(self, text: str) -> None:
        self._text(text, 14, 34, 0.85, WHITE, 2)

    def legend(self, entries: Sequence[tuple[str, Colour, bool]]) -> None:
        """Explain the lines at the lower edge: words, colour, whether dashed."""
        x, y = 14, self.picture.shape[0] - 16
        band = self.picture[y - 26 :]
        band[:] = (band * np.float32(0.35)).astype(np.uint8)
        for words, colour, dashed in entries:
            for left, right in ((0, 11), (17, 28)) if dashed else ((0, 28),):
                cv2.line(self.picture, (x + left, y - 6), (x + right, y - 6), colour, 4, cv2.LINE_AA)
            cv2.putText(self.picture, words, (x + 38, y), _FONT, 0.58, WHITE, 1, cv2.LINE_AA)
            x += 38 + cv2.getTextSize(words, _FONT, 0.58, 1)[0][0] + 26

    def _lines(self, lines: Sequence[Array], colour: Colour, width: int, closed: bool) -> None:
        """Draw lines with a dark border. All at once: a drawing thread waits after each call of OpenCV for the
        interpreter, while another thread computes."""
        runs = [run for run in map(self._fixed, lines) if len(run) >= 2]
        for ink, thickness in ((DARK, width + 2), (colour, width)):
            cv2.polylines(self.picture, runs, closed, ink, thickness, cv2.LINE_AA, _FRACTION)

    def _fixed(self, points: Array) -> NDArray[np.int32]:
        p = self.pixels(points)
        p = p[np.all(np.isfinite(p), axis=1)]
        return np.round(p * 2**_FRACTION).astype(np.int32)

    def _text(self, text: str, x: int, y: int, size: float, colour: Colour, weight: int = 1) -> None:
        (width, height), base = cv2.getTextSize(text, _FONT, size, weight)
        x = int(np.clip(x, 4, max(4, self.picture.shape[1] - width - 4)))
        y = int(np.clip(y, height + 4, self.picture.shape[0] - base - 4))
        box = self.picture[y - height - 4 : y + base + 2, x - 4 : x + width + 4]
        box[:] = (box * np.float32(0.35)).astype(np.uint8)
        cv2.putText(self.picture, text, (x, y), _FONT, size, colour, weight, cv2.LINE_AA)


def dashed(line: Array, dash: float) -> list[Array]:
    """Return the dashes [(k, 2 or 3), ...] of a line (n, 2 or 3) [m]. dash: length of a dash and of a gap [m]."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    starts = np.arange(0.0, s[-1], 2.0 * dash)
    at = [np.unique(np.clip([a, *s[(s > a) & (s < a + dash)], a + dash], 0.0, s[-1])) for a in starts]
    return [np.column_stack([np.interp(a, s, c) for c in line.T]) for a in at]
