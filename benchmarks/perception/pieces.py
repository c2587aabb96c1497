"""Draws individual pieces of the shipped garments as a person lays them, with varied outlines, turned limbs and
wrinkles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.garment.outline import draw_outline
from foldcell.cell.simulation.noise import load_noise
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.garments.garment import Garment

Map = Callable[[Array], Array]
MESH_EDGE = 0.026  # [m]


@dataclass(frozen=True)
class Laying:
    """How inaccurately a garment is laid. sleeve, leg: maximum turn of a sleeve and of a leg [rad]. distortion:
    maximum smooth shift of the fabric [m]. rim: standard deviation of the outline's small waves [m]. wrinkle:
    standard deviation of a wrinkle's height [m]."""

    sleeve: float = float(np.deg2rad(12.0))
    leg: float = float(np.deg2rad(3.5))
    distortion: float = 0.003
    rim: float = 0.0008
    wrinkle: float = 0.0025


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece of a garment. mesh: undeformed, in the garment's own frame. vertices: (n, 3) as laid, table frame.
    keypoints: name -> (3,) true places, table frame."""

    mesh: ClothMesh
    vertices: Array
    keypoints: Mapping[str, Array]


def draw_piece(garment: Garment, rng: np.random.Generator, laying: Laying | None = None) -> Piece:
    """Draw one piece of `garment`, laid at a pose that its file allows."""
    laying = laying or Laying()
    outline = draw_outline(garment, load_noise().garment, rng)
    limbs, distorted = _limbs(garment, rng, laying), _distortion(rng, laying)
    contour = _wavy(dense(outline.contour, 0.006), rng, laying.rim)
    mesh = mesh_from_contour(
        distorted(limbs(contour)),
        MESH_EDGE * rng.uniform(0.95, 1.05),
        garment.layers,
        float(rng.uniform(0.2, 0.8)),
    )
    place, height = garment.poses.sample(rng), wrinkles(rng, laying)
    top = garment.material.thickness * (0.5 + mesh.layer)
    vertices = np.column_stack((_placed(mesh.rest, place), top + height(mesh.rest)))
    border = _border(mesh)
    keypoints = {
        name: _nearest(mesh.rest[border], vertices[border], distorted(limbs(point[None]))[0])
        for name, point in outline.keypoints.items()
    }
    return Piece(mesh, vertices, keypoints)


def _border(mesh: ClothMesh) -> NDArray[np.intp]:
    """Return the indices of the vertices along the outline, in order. In every mesh, these vertices are the
    first."""
    edges = {tuple(sorted(e)) for t in mesh.triangles.tolist() for e in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))}
    n = next(i for i in range(2, len(mesh.rest)) if (i, i + 1) not in edges and (0, i) in edges) + 1
    return np.arange(n)


def _nearest(rest: Array, lying: Array, point: Array) -> Array:
    """Find the point of the flat outline that is nearest to `point` (2,), and return its place (3,) on the laid
    garment. rest: (n, 2) flat, closed outline; lying: (n, 3) the same outline as laid."""
    edge = np.roll(rest, -1, axis=0) - rest
    t = np.clip(((point - rest) * edge).sum(axis=1) / (edge**2).sum(axis=1), 0.0, 1.0)
    i = int(np.argmin(np.linalg.norm(rest + t[:, None] * edge - point, axis=1)))
    return np.asarray((1.0 - t[i]) * lying[i] + t[i] * lying[(i + 1) % len(lying)])


def _placed(points: Array, pose: tuple[float, float, float]) -> Array:
    x, y, angle = pose
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + (x, y)


def _limbs(garment: Garment, rng: np.random.Generator, laying: Laying) -> Map:
    """Create a map that turns sleeves or legs about their seams. The turn grows over the first centimetres from
    the seam."""
    at = dict(zip(garment.keypoints, np.asarray(garment.template), strict=True))
    turns: list[Map] = []
    if "cuff_upper_left" in at:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            armpit, shoulder = at[f"armpit_{side}"], at[f"shoulder_{side}"]
            cuff = 0.5 * (at[f"cuff_lower_{side}"] + at[f"cuff_upper_{side}"])
            seam = (shoulder - armpit) / np.linalg.norm(shoulder - armpit)
            outward = sign * np.array([-seam[1], seam[0]])
            turns.append(_turn(0.5 * (armpit + shoulder), outward, cuff, laying.sleeve * rng.uniform(-1, 1), 0.07))
    if "crotch" in at:
        crotch = at["crotch"]
        for side in ("near", "far"):
            ankle = 0.5 * (at[f"ankle_outer_{side}"] + at[f"ankle_inner_{side}"])
            waist = at[f"waist_{side}"]
            sign = np.sign(waist[0] - crotch[0])
            spread = -sign * laying.leg * rng.uniform(-0.4, 1.0)  # outwards, seen from above
            down = np.array([0.0, np.sign(ankle[1] - crotch[1])])
            hip = np.array([0.5 * (crotch[0] + waist[0]), crotch[1]]) + 0.03 * down  # the crotch does not move
            turns.append(_turn(hip, down, ankle, -spread, 0.20, side=(crotch, np.array([sign, 0.0]))))

    def apply(points: Array) -> Array:
        for turn in turns:
            points = turn(points)
        return points

    return apply


def _turn(
    pivot: Array, outward: Array, end: Array, angle: float, over: float, side: tuple[Array, Array] | None = None
) -> Map:
    """Create a map that turns points about `pivot`, if they lie beyond it in the direction `outward`. The full
    angle [rad] is reached at a distance of `over` [m] from the pivot. side: (point, direction); if given,
    only points beyond this point in this direction are turned."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, s], [-s, c]])
    if (end - pivot) @ outward < 0:
        outward = -outward

    def apply(points: Array) -> Array:
        share = np.clip((points - pivot) @ outward / over, 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        if side is not None:
            share = np.where((points - side[0]) @ side[1] > 0, share, 0.0)
        return points + share[:, None] * ((points - pivot) @ R + pivot - points)

    return apply


def _distortion(rng: np.random.Generator, laying: Laying) -> Map:
    """Create a map that shifts the fabric smoothly, by three waves that are 0.25 to 0.6 m long."""
    waves = [
        (rng.uniform(0, np.pi), 2 * np.pi / rng.uniform(0.25, 0.6), rng.uniform(0, 6), rng.uniform(-1, 1, 2) / 3)
        for _ in range(3)
    ]

    def apply(points: Array) -> Array:
        out = points.copy()
        for angle, k, phase, amount in waves:
            wave = np.sin(k * points @ (np.cos(angle), np.sin(angle)) + phase)
            out += laying.distortion * wave[:, None] * amount
        return out

    return apply


def wrinkles(rng: np.random.Generator, laying: Laying) -> Callable[[Array], Array]:
    """Create a function that returns the height above the flat garment [m] at points (n, 2): the crests of three
    long wrinkles, and small creases as in the cell's simulated world."""
    noise = load_noise().garment
    long = [_wave(rng, rng.uniform(0.10, 0.30), abs(rng.normal()) * laying.wrinkle) for _ in range(3)]
    relief = noise.relief / np.sqrt(3.0)
    short = [_wave(rng, noise.relief_length * rng.uniform(0.8, 2.0), relief) for _ in range(6)]

    def height(points: Array) -> Array:
        crests = np.maximum(sum(wave(points) for wave in long), 0.0)
        creases = np.asarray(sum(wave(points) for wave in short))
        return np.asarray(crests + np.maximum(creases + 2.0 * noise.relief, 0.0))

    return height


def _wave(rng: np.random.Generator, length: float, amount: float) -> Callable[[Array], Array]:
    angle, phase, k = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi), 2 * np.pi / length
    along = np.array([np.cos(angle), np.sin(angle)])
    return lambda points: amount * np.sin(k * points @ along + phase)


def dense(contour: Array, step: float) -> Array:
    out = []
    for a, b in zip(contour, np.roll(contour, -1, axis=0), strict=True):
        n = max(int(np.linalg.norm(b - a) / step), 1)
        out.append(a + np.arange(n)[:, None] / n * (b - a))
    return np.concatenate(out)


def _wavy(contour: Array, rng: np.random.Generator, rim: float) -> Array:
    """Move the outline (n, 2) along its normals by waves that are some centimetres long."""
    tangent = np.roll(contour, -1, axis=0) - np.roll(contour, 1, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    length = np.linalg.norm(np.roll(contour, -1, axis=0) - contour, axis=1)
    s = 2 * np.pi * np.r_[0.0, np.cumsum(length)[:-1]] / length.sum()
    wave = np.zeros(len(contour))
    for _ in range(8):
        k = round(float(length.sum()) / rng.uniform(0.05, 0.2))
        wave += rng.normal() * np.sin(k * s + rng.uniform(0, 6))
    return contour + (rim / 2.0 * wave)[:, None] * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
