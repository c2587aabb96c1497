"""Flat objects that are not part of the rendered world, drawn into a picture: a hand, a second garment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from foldcell.cell.simulation.camera.render_server import Picture
from foldcell.skills.vocabulary import Array

SKIN_RGB = (201, 152, 124)
FOREARM = 0.085
"""Width of a forearm [m]."""
PALM = (0.095, 0.055)
"""Half length and half width of a hand with closed fingers [m]."""
REACH = 1.5
"""Length of the arm from the hand on [m]; it leaves the picture."""
ROUND = 40
"""Corners of an ellipse."""


@dataclass(frozen=True, eq=False)
class Slab:
    """A flat horizontal object. outlines: polygons (k, 2), base frame [m]; height: of its upper side, base frame
    [m]; colour: RGB."""

    outlines: tuple[Array, ...]
    height: float
    colour: tuple[int, int, int]


def hand_over(point: Array, height: float, direction: float) -> Slab:
    """Return a hand whose palm is over `point` (2,) [m] at `height` [m]. direction: from which the forearm comes,
    base frame [rad]."""
    along = np.array([np.cos(direction), np.sin(direction)])
    across = np.array([-along[1], along[0]])
    turns = np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False)
    palm = point + np.outer(PALM[0] * np.cos(turns), along) + np.outer(PALM[1] * np.sin(turns), across)
    wrist, elbow, side = point + 0.05 * along, point + REACH * along, 0.5 * FOREARM * across
    forearm = np.array([wrist - side, wrist + side, elbow + side, elbow - side])
    return Slab((palm, forearm), height, SKIN_RGB)


def square_cloth(point: Array, side: float, angle: float, height: float, colour: tuple[int, int, int]) -> Slab:
    """Return a square piece of cloth with the given side [m] about `point` (2,) [m], turned by `angle` [rad]."""
    corners = 0.5 * side * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    c, s = np.cos(angle), np.sin(angle)
    return Slab((corners @ np.array([[c, s], [-s, c]]) + point,), height, colour)


def with_slabs(
    picture: Picture,
    slabs: Sequence[Slab],
    T_base_camera: Array,
    focal: tuple[float, float],
    centre: tuple[float, float],
) -> Picture:
    """Return the picture with the slabs where nothing is nearer to the camera. focal, centre: of the pinhole
    camera [px]."""
    rgb, depth = picture.rgb.copy(), picture.depth.copy()
    v, u = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]]
    rays = np.stack(((u - centre[0]) / focal[0], (v - centre[1]) / focal[1], np.ones_like(u, float)), axis=-1)
    down = rays @ T_base_camera[2, :3]
    for slab in slabs:
        inside = np.zeros(depth.shape, np.uint8)
        for outline in slab.outlines:
            points = np.column_stack((outline, np.full(len(outline), slab.height), np.ones(len(outline))))
            p = (points @ np.linalg.inv(T_base_camera).T)[:, :3]
            pixels = p[:, :2] / p[:, 2:] * focal + centre
            cv2.fillPoly(inside, [np.rint(pixels).astype(np.int32)], 1)
        away = ((slab.height - T_base_camera[2, 3]) / down).astype(np.float32)
        shown = inside.astype(bool) & ~(depth <= away)
        rgb[shown], depth[shown] = slab.colour, away[shown]
    return Picture(rgb, depth)
