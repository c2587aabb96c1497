"""Pictures of a fold, drawn from mesh snapshots: shaded cloth on a table and tool paths in green.

This is a small software renderer (z-buffer, smooth shading, soft shadow). It needs no graphics driver and draws
the same picture on every machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, Side
from skills.vocabulary import Table

__all__ = ["KeyFrame", "View", "draw_frame", "fold_strip", "join"]

Picture = NDArray[np.uint8]

FRONT, BACK = (196, 84, 92), (231, 178, 170)
TABLE_COLOUR, FLOOR_COLOUR = (203, 184, 158), (238, 239, 241)
GREEN, GREEN_DONE = (28, 172, 76), (13, 110, 48)
TOOL, INK = (52, 55, 62), (40, 42, 48)
LIGHT = np.array([-0.35, 0.45, 0.82]) / np.linalg.norm([-0.35, 0.45, 0.82])
AMBIENT = 0.45
SUPERSAMPLE = 2
SLIVER = 3
"""A strip of cloth of about twice this width [px] or less is a sliver. If one side of the cloth shows only in a
sliver beside the other side, the sliver is drawn in the colour of the other side."""
TOOL_LENGTH = 0.09
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """One moment of a fold. vertices: (n, 3); tools: the tool centre points (3,). Table frame [m]."""

    vertices: Array
    tools: Mapping[Side, Array] = field(default_factory=dict)
    caption: str = ""


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera of width x height pixels at `eye` (3,) that looks at `target` (3,). Table frame, z up."""

    eye: Array
    target: Array
    focal: float
    width: int
    height: int
    shift: tuple[float, float] = (0.0, 0.0)

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3): its rows are the picture's right, down and forward in the table frame."""
        forward = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward])

    def project(self, points: Array) -> Array:
        """Project points (n, 3) to (n, 3): column, row [px] and depth [m]."""
        p = (np.asarray(points, dtype=np.float64) - self.eye) @ self.rotation.T
        uv = self.focal * p[:, :2] / p[:, 2:] + [self.width / 2 + self.shift[0], self.height / 2 + self.shift[1]]
        return np.column_stack([uv, p[:, 2]])

    @classmethod
    def around(cls, points: Array, width: int, height: int, margin: float = 0.08) -> View:
        """Return a view from the front left. `points` (n, 3) fill it except for `margin` (fraction of the
        picture)."""
        low, high = points.min(axis=0), points.max(axis=0)
        target = (low + high) / 2.0
        eye = target + np.array([0.85, 0.75, 0.95]) * 1.35 * max(0.3, float(np.linalg.norm(high - low)))
        view = cls(eye, target, 1.0, 0, 0)
        uv = view.project(points)[:, :2]
        span = np.maximum(np.ptp(uv, axis=0), 1e-6)
        focal = (1.0 - 2.0 * margin) * float(np.min(np.array([width, height]) / span))
        middle = focal * (uv.min(axis=0) + uv.max(axis=0)) / 2.0
        return cls(eye, target, focal, width, height, (-float(middle[0]), -float(middle[1])))

    def scaled(self, k: int) -> View:
        shift = (self.shift[0] * k, self.shift[1] * k)
        return View(self.eye, self.target, self.focal * k, self.width * k, self.height * k, shift)


def draw_frame(
    frame: KeyFrame,
    triangles: NDArray[np.integer],
    view: View,
    table: Table | None = None,
    arcs: Sequence[Array] = (),
) -> Picture:
    """Draw one picture (H, W, 3). triangles: (m, 3). arcs: tool paths (k, 3), drawn on top."""
    big = view.scaled(SUPERSAMPLE)
    canvas = np.empty((big.height, big.width, 3), dtype=np.float64)
    canvas[:] = FLOOR_COLOUR if table is not None else (255, 255, 255)
    if table is not None:
        _table(canvas, big, table)
    _shadow(canvas, big, frame.vertices, triangles)
    _cloth(canvas, big, frame.vertices, triangles)
    picture = canvas.clip(0, 255).astype(np.uint8)
    for path in arcs:
        _line(picture, big, path, GREEN, 2 * SUPERSAMPLE)
        for end, filled in ((path[:1], False), (path[-1:], True)):
            _dot(picture, big, end, GREEN_DONE, 4 * SUPERSAMPLE, filled)
    for point in frame.tools.values():
        _tool(picture, big, point)
    return np.asarray(cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def fold_strip(
    frames: Sequence[KeyFrame],
    triangles: NDArray[np.integer],
    arcs: Sequence[Array] = (),
    table: Table | None = None,
    size: tuple[int, int] = (300, 230),
) -> list[Picture]:
    """Draw one picture per frame, all from one view that shows the whole motion. size: width, height [px]."""
    if not frames:
        return []
    points = [f.vertices for f in frames] + [np.asarray(a) for a in arcs]
    above = np.array([0.0, 0.0, 0.5 * TOOL_LENGTH])
    points += [np.array(list(f.tools.values())) + above for f in frames if f.tools]
    view = View.around(np.vstack(points), *size)
    return [draw_frame(f, triangles, view, table, arcs) for f in frames]


def join(pictures: Sequence[Picture], captions: Sequence[str] = (), gap: int = 6) -> Picture:
    """Join pictures of the same size side by side (H, W, 3), with captions below. gap [px]."""
    height, width = pictures[0].shape[:2]
    foot = 26 if any(captions) else 0
    out = np.full((height + foot, len(pictures) * (width + gap) - gap, 3), 255, dtype=np.uint8)
    for k, picture in enumerate(pictures):
        left = k * (width + gap)
        out[:height, left : left + width] = picture
        if k < len(captions):
            cv2.putText(out, captions[k], (left + 4, height + 18), _FONT, 0.45, INK, 1, cv2.LINE_AA)
    return out


def _table(canvas: NDArray, view: View, table: Table) -> None:
    """Draw the table top. Points behind the eye or too close to it cannot be projected and are left out."""
    x, y = np.linspace(*table.x, 40), np.linspace(*table.y, 40)
    rim = np.vstack([
        np.column_stack([x, np.full(40, table.y[0])]), np.column_stack([np.full(40, table.x[1]), y]),
        np.column_stack([x[::-1], np.full(40, table.y[1])]), np.column_stack([np.full(40, table.x[0]), y[::-1]]),
    ])  # fmt: skip
    p = view.project(np.column_stack([rim, np.zeros(len(rim))]))
    p = p[p[:, 2] > 0.05]
    if len(p) >= 3:
        cv2.fillPoly(canvas, [np.round(p[:, :2] * 16).astype(np.int32)], TABLE_COLOUR, cv2.LINE_AA, 4)


def _shadow(canvas: NDArray, view: View, vertices: Array, triangles: NDArray[np.integer]) -> None:
    """Darken the table by the garment's shadow: its blurred projection along the light onto z = 0."""
    reach = vertices[:, 2:].clip(min=0.0) / LIGHT[2]
    p = view.project(np.column_stack([vertices[:, :2] - reach * LIGHT[:2], np.zeros(len(vertices))]))
    mask = np.zeros(canvas.shape[:2], dtype=np.uint8)
    for triangle in np.round(p[:, :2]).astype(np.int32)[triangles]:
        cv2.fillConvexPoly(mask, triangle, 255)
    soft = cv2.GaussianBlur(mask, (0, 0), 3.0 * SUPERSAMPLE).astype(np.float64) / 255.0
    canvas *= 1.0 - 0.38 * soft[:, :, None]


def _cloth(canvas: NDArray, view: View, vertices: Array, triangles: NDArray[np.integer]) -> None:
    p = view.project(vertices)
    normals = _normals(vertices, triangles)
    to_eye = view.eye - vertices
    shade = AMBIENT + (1.0 - AMBIENT) * np.abs(normals @ LIGHT)
    facing = np.einsum("ij,ij->i", normals, to_eye)
    depth, tone = np.full(canvas.shape[:2], np.inf), np.zeros(canvas.shape[:2])
    front = np.zeros(canvas.shape[:2], np.uint8)
    _rasterise(np.ascontiguousarray(p), triangles.astype(np.int64), shade, facing, depth, tone, front)
    front = _without_slivers(front, np.isfinite(depth))
    colour = np.where(front[..., None] > 0, np.array(FRONT, float), np.array(BACK, float))
    np.copyto(canvas, tone[..., None] * colour, where=np.isfinite(depth)[..., None])


def _without_slivers(front: NDArray[np.uint8], cloth: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Remove slivers from `front` (H, W), which is 1 where the front of the cloth shows and 0 elsewhere. Slivers
    occur along an open hem, because the coarse edges of two mesh layers cross there: without this step the inside
    of one layer would look like a row of teeth. cloth: (H, W), true where cloth is visible."""
    size = 2 * SLIVER * SUPERSAMPLE + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    for side in (1, 0):
        mask = (cloth & (front == side)).astype(np.uint8)
        thin = (mask > 0) & (cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel) == 0)
        other = cv2.dilate((cloth & (front != side)).astype(np.uint8), kernel) > 0
        front = np.where(thin & other, 1 - side, front).astype(np.uint8)
    return front


def _normals(vertices: Array, triangles: NDArray[np.integer]) -> Array:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normal = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normal, triangles[:, k], face)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


@numba.njit(cache=True, nogil=True)
def _rasterise(p, triangles, shade, facing, depth, tone, front):  # type: ignore[no-untyped-def]
    """Fill triangles with a z-buffer. p: (n, 3) pixel and depth; shade, facing: (n,) at the vertices. depth, tone,
    front: (H, W) results: depth, brightness, and 1 where the front of the cloth shows."""
    height, width = depth.shape
    for m in range(triangles.shape[0]):
        i, j, k = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        x0, y0, x1, y1, x2, y2 = p[i, 0], p[i, 1], p[j, 0], p[j, 1], p[k, 0], p[k, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        left, right = max(0, int(min(x0, x1, x2))), min(width - 1, int(max(x0, x1, x2)) + 1)
        top, bottom = max(0, int(min(y0, y1, y2))), min(height - 1, int(max(y0, y1, y2)) + 1)
        # a triangle shows one side only, even if its vertices face different ways
        side = facing[i] + facing[j] + facing[k] > 0.0
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                b = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
                c = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
                a = 1.0 - b - c
                if a < -1e-6 or b < -1e-6 or c < -1e-6:
                    continue
                z = a * p[i, 2] + b * p[j, 2] + c * p[k, 2]
                if z < depth[row, column]:
                    depth[row, column] = z
                    tone[row, column] = a * shade[i] + b * shade[j] + c * shade[k]
                    front[row, column] = side


def _line(picture: Picture, view: View, path: Array, colour: tuple[int, int, int], width: int) -> None:
    points = np.round(view.project(path)[:, :2] * 16).astype(np.int32)
    cv2.polylines(picture, [points], False, colour, width, cv2.LINE_AA, 4)


def _dot(
    picture: Picture, view: View, point: Array, colour: tuple[int, int, int], radius: int, filled: bool
) -> None:
    u, v = (int(c) for c in np.round(view.project(point)[0, :2]))
    cv2.circle(picture, (u, v), radius, (255, 255, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, (u, v), radius, colour, -1 if filled else SUPERSAMPLE, cv2.LINE_AA)


def _tool(picture: Picture, view: View, point: Array) -> None:
    """Draw the fingers that hold `point` (3,) as one stroke with a light rim."""
    stroke = np.vstack([point, np.asarray(point) + np.array([0.0, 0.0, TOOL_LENGTH])])
    _line(picture, view, stroke, (250, 250, 250), 9 * SUPERSAMPLE)
    _line(picture, view, stroke, TOOL, 6 * SUPERSAMPLE)
