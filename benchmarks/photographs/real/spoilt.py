"""Garments that are not flat and whole: folded in half, a heap, a sleeve folded over or pushed together.

Each is a stack of polygons, from below upwards, as the camera sees them.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from shapely import affinity
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import unary_union

from benchmarks.photographs.outline import Points
from benchmarks.photographs.real.outlines import Flat

FAR = 5.0
"""[m] Beyond any garment."""
HEAP_SHARE = 0.35
"""Of the ground that the flat garment covered, a heap covers about this or less."""
FOLDABLE = ("t_shirt", "long_sleeve_shirt", "vest", "pants", "shorts")
"""Of these one half on the other looks like no whole garment. Half a towel is a smaller towel."""


def folded_in_half(rng: np.random.Generator, lying: Flat) -> list[Points]:
    """One side on the other, not quite edge on edge."""
    points = lying.keypoints
    if "crotch" in points:
        top, bottom = (points["waist_near"] + points["waist_far"]) / 2, points["crotch"]
    else:
        top = (points["collar_left"] + points["collar_right"]) / 2
        bottom = (points["hem_left"] + points["hem_right"]) / 2
    along = _turned(top - bottom, rng.normal(0, 0.03))
    beside = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    start = bottom + rng.normal(0, 0.012) * beside
    return [_points(p) for p in _fold([Polygon(lying.outline)], start, along * rng.choice([-1, 1]), 0.02, rng)]


def heap(rng: np.random.Generator, lying: Flat) -> list[Points]:
    """Folded over many times at random lines, and crumpled."""
    layers = [Polygon(lying.outline)]
    smallest = HEAP_SHARE * layers[0].area
    for _ in range(12):
        middle = np.array(unary_union(layers).centroid.coords[0])
        angle = rng.uniform(0, 2 * np.pi)
        start = middle + rng.normal(0, 0.05, 2)
        layers = _fold(layers, start, np.array([np.cos(angle), np.sin(angle)]), 0.35, rng)[-14:]
        if unary_union(layers).area < smallest:
            break
    return [_crumpled(rng, _points(p), 0.014) for p in layers if p.area > 1e-3]


def bunched_sleeve(rng: np.random.Generator, lying: Flat) -> list[Points]:
    """A shirt with one sleeve folded back over, or pushed together towards the shoulder."""
    side = str(rng.choice(["left", "right"]))
    sleeve = lying.arc(f"shoulder_{side}", f"armpit_{side}")
    points = lying.keypoints
    root = (points[f"shoulder_{side}"] + points[f"armpit_{side}"]) / 2
    cuff = (points[f"cuff_upper_{side}"] + points[f"cuff_lower_{side}"]) / 2
    long = lying.category == "long_sleeve_shirt"
    whole, part = Polygon(lying.outline).buffer(0), Polygon(sleeve).buffer(0.002)
    body = _largest(whole.difference(part))
    if long and rng.random() < 0.5:
        along = (cuff - root) / np.linalg.norm(cuff - root)
        line = np.vstack([sleeve, sleeve[:1]])
        step = (line - root) @ along
        pushed = line - np.outer(np.clip(step, 0, None) * rng.uniform(0.5, 0.65), along)
        return [_points(body), _crumpled(rng, pushed, 0.009), _crumpled(rng, pushed[::2] * 0.7 + root * 0.3, 0.01)]
    share = rng.uniform(0.35, 0.6) if long else rng.uniform(0.0, 0.25)
    start = root + share * (cuff - root)
    across = _turned(np.array([-(cuff - root)[1], (cuff - root)[0]]), rng.normal(0, 0.3))
    if (cuff - start) @ np.array([-across[1], across[0]]) < 0:
        across = -across
    kept, *flaps = _fold([_largest(part)], start, across, 0.1, rng)
    return [_points(_largest(body.union(kept.buffer(0.003)))), *(_points(f) for f in flaps)]


def _fold(
    layers: list[Polygon], start: Points, along: Points, askew: float, rng: np.random.Generator
) -> list[Polygon]:
    """What lies to the left of the line is turned over it, and lies on top in reverse order."""
    u = along / np.linalg.norm(along)
    left = np.array([-u[1], u[0]])
    moving = Polygon([start - FAR * u, start + FAR * u, start + FAR * (u + left), start + FAR * (left - u)])
    c, s = u[0] ** 2 - u[1] ** 2, 2 * u[0] * u[1]
    mirror = [c, s, s, -c, *(start - np.array([[c, s], [s, -c]]) @ start)]
    turn = np.degrees(rng.normal(0, askew))
    stay = [_largest(p.difference(moving)) for p in layers]
    over = [
        affinity.rotate(affinity.affine_transform(_largest(p.intersection(moving)), mirror), turn, tuple(start))
        for p in layers[::-1]
    ]
    return [p for p in (*stay, *over) if p.area > 1e-4]


def _crumpled(rng: np.random.Generator, line: Points, amount: float) -> Points:
    """The border with waves and dents of about `amount` [m]."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    n = max(40, round(run[-1] / 0.004))
    at = np.linspace(0, run[-1], n, endpoint=False)
    dense = np.column_stack([np.interp(at, run, line[:, k]) for k in (0, 1)])
    waves = sum(
        gaussian_filter1d(rng.normal(0, 1, (n, 2)), s, axis=0, mode="wrap") * np.sqrt(2 * np.sqrt(np.pi) * s) * k
        for s, k in ((12.0, 1.0), (4.0, 0.35))
    )
    return np.asarray(gaussian_filter1d(dense, 3.0, axis=0, mode="wrap") + amount * waves)


def _turned(v: Points, angle: float) -> Points:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(np.array([[c, -s], [s, c]]) @ v)


def _largest(shape: BaseGeometry) -> Polygon:
    whole = shape.buffer(0)
    if isinstance(whole, MultiPolygon):
        return max(whole.geoms, key=lambda p: p.area)
    return whole if isinstance(whole, Polygon) else Polygon()


def _points(shape: Polygon) -> Points:
    return np.asarray(shape.exterior.coords)[:-1]
