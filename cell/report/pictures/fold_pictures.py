"""Pictures of a fold, drawn from mesh snapshots: shaded cloth on a table, the hands' paths in blue, and the
outline of the flat garment in green.

This is a small software renderer (z-buffer, smooth shading, soft shadow). It needs no graphics driver and draws
the same picture on every machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.report.camera_pictures.projected_drawing import Colour, Picture, dashed
from foldcell.cell.report.pictures.cloth_raster import (
    darken,
    draw_cloth,
    raster_cloth,
    raster_shadow,
)
from foldcell.cell.report.pictures.mesh_raster import Lens
from foldcell.robots.ports import Array, Side
from foldcell.skills.vocabulary import Table

FRONT, BACK = (196, 84, 92), (231, 178, 170)
TABLE_COLOUR, FLOOR_COLOUR = (203, 184, 158), (238, 239, 241)
PATH, PATH_END, RIM = (36, 104, 214), (20, 66, 150), (250, 250, 250)
TAPE, TAPE_RIM = (52, 190, 90), (18, 84, 40)
TOOL, INK = (52, 55, 62), (40, 42, 48)
LIGHT = np.array([-0.35, 0.45, 0.82]) / np.linalg.norm([-0.35, 0.45, 0.82])
AMBIENT = 0.45
NEAREST = 0.05
"""Points nearer to the camera than this are not drawn [m]."""
SHADOW = 0.38
"""Share of the light that a shadow takes away."""
SUPERSAMPLE = 2
SLIVER = 3
"""See `raster_cloth` [px of the picture]."""
WORKERS = 4
"""Pictures that are drawn at the same time."""
DASH = 0.012
"""Length of a dash, and of a gap, of an outline that cloth hides [m]."""
TOOL_LENGTH = 0.09
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class ClothColours:
    """RGB colours of both sides of a garment, fully lit."""

    front: Colour
    back: Colour


CLOTH = ClothColours(FRONT, BACK)
"""The colours of cloth that no camera has seen."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """What is drawn beside the cloth: the table, the tool paths [(k, 3), ...] on top, and the tape, which is a
    closed line (k, 2) on the table. Table frame [m]. Cloth hides the tape: it is dashed there."""

    table: Table | None = None
    arcs: Sequence[Array] = ()
    tape: Array | None = None
    colours: ClothColours = CLOTH


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

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the table frame in the camera's frame."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.rotation, -self.rotation @ self.eye
        return T

    @property
    def lens(self) -> Lens:
        centre = (self.width / 2 + self.shift[0], self.height / 2 + self.shift[1])
        return Lens((self.focal, self.focal), centre, NEAREST, AMBIENT, 1.0 - AMBIENT)

    def project(self, points: Array) -> Array:
        """Project points (n, 3) to (n, 3): column, row [px] and depth [m]."""
        p = (np.asarray(points, dtype=np.float64) - self.eye) @ self.rotation.T
        uv = self.focal * p[:, :2] / p[:, 2:] + self.lens.centre
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
    frame: KeyFrame, triangles: NDArray[np.integer], view: View, scenery: Scenery | None = None
) -> Picture:
    """Draw one picture (H, W, 3). triangles: (m, 3)."""
    return fold_strip([frame], triangles, view, scenery or Scenery())[0]


def motion_view(
    frames: Sequence[KeyFrame], arcs: Sequence[Array] = (), size: tuple[int, int] = (300, 230)
) -> View:
    """Return the view that shows all frames, tools and tool paths. size: width, height [px]."""
    points = [f.vertices for f in frames] + [np.asarray(a) for a in arcs]
    above = np.array([0.0, 0.0, 0.5 * TOOL_LENGTH])
    points += [np.array(list(f.tools.values())) + above for f in frames if f.tools]
    return View.around(np.vstack(points), *size)


def fold_strip(
    frames: Sequence[KeyFrame],
    triangles: NDArray[np.integer],
    view: View,
    scenery: Scenery,
) -> list[Picture]:
    """Draw one picture per frame, all from the same view. triangles: (m, 3)."""
    background = _background(view.scaled(SUPERSAMPLE), scenery)
    dashes = [] if scenery.tape is None else dashed(_closed(scenery.tape), DASH)
    with ThreadPoolExecutor(WORKERS) as workers:
        return list(workers.map(lambda f: _draw(f, triangles, view, scenery, background, dashes), frames))


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


def _background(view: View, scenery: Scenery) -> Picture:
    """Draw what lies under the cloth: the table and the tape."""
    canvas = np.empty((view.height, view.width, 3), dtype=np.uint8)
    canvas[:] = FLOOR_COLOUR if scenery.table is not None else (255, 255, 255)
    if scenery.table is not None:
        _table(canvas, view, scenery.table)
    if scenery.tape is not None:
        for colour, width in ((TAPE_RIM, 3), (TAPE, 2)):
            _lines(canvas, view, [_closed(scenery.tape)], colour, width * SUPERSAMPLE)
    return canvas


def _draw(
    frame: KeyFrame,
    triangles: NDArray[np.integer],
    view: View,
    scenery: Scenery,
    background: Picture,
    dashes: Sequence[Array],
) -> Picture:
    picture, big = background.copy(), view.scaled(SUPERSAMPLE)
    _shadow(picture, view, frame.vertices, triangles)
    _cloth(picture, big, frame.vertices, triangles, scenery.colours)
    if dashes:
        _lines(picture, big, dashes, TAPE, SUPERSAMPLE + 1)
    for path in scenery.arcs:
        _lines(picture, big, [path], RIM, 4 * SUPERSAMPLE)
        _lines(picture, big, [path], PATH, 2 * SUPERSAMPLE)
        for end, filled in ((path[:1], False), (path[-1:], True)):
            _dot(picture, big, end, PATH_END, 4 * SUPERSAMPLE, filled)
    for point in frame.tools.values():
        _tool(picture, big, point)
    return np.asarray(cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _table(canvas: Picture, view: View, table: Table) -> None:
    """Draw the table top. Points behind the eye or too close to it cannot be projected and are left out."""
    x, y = np.linspace(*table.x, 40), np.linspace(*table.y, 40)
    rim = np.vstack([
        np.column_stack([x, np.full(40, table.y[0])]), np.column_stack([np.full(40, table.x[1]), y]),
        np.column_stack([x[::-1], np.full(40, table.y[1])]), np.column_stack([np.full(40, table.x[0]), y[::-1]]),
    ])  # fmt: skip
    p = view.project(np.column_stack([rim, np.zeros(len(rim))]))
    p = p[p[:, 2] > NEAREST]
    if len(p) >= 3:
        cv2.fillPoly(canvas, [np.round(p[:, :2] * 16).astype(np.int32)], TABLE_COLOUR, cv2.LINE_AA, 4)


def _shadow(canvas: Picture, view: View, vertices: Array, triangles: NDArray[np.integer]) -> None:
    """Darken the table by the garment's shadow: its blurred projection along the light onto z = 0. view: of the
    picture; the canvas is larger, and a shadow has no sharp edges."""
    reach = vertices[:, 2:].clip(min=0.0) / LIGHT[2]
    flat = np.column_stack([vertices[:, :2] - reach * LIGHT[:2], np.zeros(len(vertices))])
    soft = raster_shadow(flat, triangles, view.pose, view.lens, (view.height, view.width), 3.0)
    darken(canvas, cv2.resize(soft, (canvas.shape[1], canvas.shape[0])), SHADOW)


def _cloth(
    canvas: Picture, view: View, vertices: Array, triangles: NDArray[np.integer], colours: ClothColours
) -> None:
    light, shape = view.rotation @ LIGHT, (view.height, view.width)
    tone, front = raster_cloth(vertices, triangles, view.pose, view.lens, light, shape, SLIVER * SUPERSAMPLE)
    draw_cloth(canvas, tone, front, np.array([colours.back, colours.front], float))


def _closed(line: Array) -> Array:
    return np.vstack([line, line[:1]])


def _lines(picture: Picture, view: View, paths: Sequence[Array], colour: Colour, width: int) -> None:
    """Draw lines, each (k, 3), or (k, 2) on the table [m]."""
    ends = np.cumsum([len(path) for path in paths])[:-1]
    points = np.vstack(paths)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    pixels = np.round(view.project(points)[:, :2] * 16).astype(np.int32)
    cv2.polylines(picture, np.split(pixels, ends), False, colour, width, cv2.LINE_AA, 4)


def _dot(
    picture: Picture, view: View, point: Array, colour: tuple[int, int, int], radius: int, filled: bool
) -> None:
    u, v = (int(c) for c in np.round(view.project(point)[0, :2]))
    cv2.circle(picture, (u, v), radius, (255, 255, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, (u, v), radius, colour, -1 if filled else SUPERSAMPLE, cv2.LINE_AA)


def _tool(picture: Picture, view: View, point: Array) -> None:
    """Draw the fingers that hold `point` (3,) as one stroke with a light rim."""
    stroke = np.vstack([point, np.asarray(point) + np.array([0.0, 0.0, TOOL_LENGTH])])
    _lines(picture, view, [stroke], RIM, 9 * SUPERSAMPLE)
    _lines(picture, view, [stroke], TOOL, 6 * SUPERSAMPLE)
