"""Draws synthetic photographs, such as a person takes with a telephone.

The code uses numpy and cv2 only. It shares nothing with perception or with the labelled scenes of the simulated
camera. A cloth, whose shape is not that of a shipped garment, lies on a floor or a table (boards, a painted table,
tiles, carpet). The camera looks down with some tilt, from any place and with any resolution. The lens darkens the
corners, the light is uneven and coloured, wrinkles are shaded, and the cloth casts a soft shadow. The picture is
stored as JPEG. Lengths on the floor are in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["CRUMPLED", "GARMENTS", "Photograph", "photograph"]

Points = NDArray[np.float64]
Picture = NDArray[np.uint8]
Plane = NDArray[np.float32]

SIZES = ((640, 480), (1024, 768), (1280, 960), (800, 800), (720, 960), (1600, 1200))
GROUNDS = ("boards", "boards", "painted", "tiles", "carpet")
CLOTHS = ("grey", "dark", "white", "coloured", "striped", "denim")
STEP = 0.0025
"""Edge length of a cell of the floor map, in which ground and cloth are drawn [m]."""
SPAN = 2.6
"""Edge length of the whole floor map [m]."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph and its true labels. rgb: (H, W, 3). category: of the garment, '' if no garment lies flat.
    points: key points, name -> (2,) [px] (column, row). outline: (n, 2) [px]. ground, cloth: names of the drawn
    materials. contrast: between cloth and ground, see `_contrast` [CIE delta E]."""

    rgb: Picture
    category: str
    points: Mapping[str, Points]
    outline: Points
    ground: str
    cloth: str
    contrast: float


def _towel(rng: np.random.Generator) -> Mapping[str, tuple[float, float]]:
    a, b = 0.5 * rng.uniform(0.30, 0.42), 0.5 * rng.uniform(0.45, 0.62)
    return {"near_right": (-a, -b), "far_right": (a, -b), "far_left": (a, b), "near_left": (-a, b)}


def _both(right: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Complete a symmetric outline: return the points of the right half (y < 0) in order, then their mirror images
    in reverse order."""
    left = {f"{name}_left": (x, -y) for name, (x, y) in reversed(right.items())}
    return {**{f"{name}_right": p for name, p in right.items()}, **left}


def _shirt(rng: np.random.Generator, sleeve: float, drop: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Draw the key points of a shirt. sleeve: its length [m]. drop: range of the sleeve's angle below the shoulder
    line [rad]."""
    w, h = 0.5 * rng.uniform(0.44, 0.52), 0.5 * rng.uniform(0.60, 0.68)
    angle, cuff = rng.uniform(*drop), rng.uniform(0.055, 0.07) + (0.03 if sleeve < 0.3 else 0.0)
    shoulder = np.array([h - rng.uniform(0.03, 0.05), -(w - rng.uniform(0.03, 0.05))])
    along, across = np.array([-np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
    end = shoulder + sleeve * along - cuff * across
    tip = shoulder + sleeve * along
    armpit = (h - rng.uniform(0.21, 0.25), -w)
    neck = rng.uniform(0.075, 0.095)
    return _both({
        "hem": (-h, -w), "armpit": armpit, "cuff_lower": (end[0], end[1]), "cuff_upper": (tip[0], tip[1]),
        "shoulder": (shoulder[0], shoulder[1]), "collar": (h, -neck),
    })  # fmt: skip


def _legs(rng: np.random.Generator, length: float, rise: float, hem: float, gap: float) -> Mapping:
    """Draw the key points of trousers, with the waist on the left (y > 0). length: of a leg with the waist; rise:
    from waist to crotch; hem: width of a leg at the ankle; gap: half the distance between the legs at the ankles;
    all [m]."""
    w, h = 0.5 * rng.uniform(0.36, 0.44), 0.5 * length * rng.uniform(0.94, 1.06)
    gap *= rng.uniform(0.8, 1.3)
    return {
        "waist_near": (-w, h), "ankle_outer_near": (-gap - hem, -h), "ankle_inner_near": (-gap, -h),
        "crotch": (0.0, h - rise), "ankle_inner_far": (gap, -h), "ankle_outer_far": (gap + hem, -h),
        "waist_far": (w, h),
    }  # fmt: skip


def _skirt(rng: np.random.Generator) -> Mapping[str, tuple[float, float]]:
    h, top = 0.5 * rng.uniform(0.48, 0.58), 0.5 * rng.uniform(0.30, 0.36)
    return _both({"hem": (-h, -top * rng.uniform(1.65, 1.95)), "waist": (h, -top)})


def _vest(rng: np.random.Generator) -> Mapping[str, tuple[float, float]]:
    w, h, s = 0.5 * rng.uniform(0.42, 0.47), 0.5 * rng.uniform(0.58, 0.66), rng.uniform(0.135, 0.15)
    armpit, shoulder, collar = (0.26 * h, -w), (0.94 * h, -s), (h, -0.5 * s)
    points = _both({"hem": (-h, -w), "armpit": armpit, "shoulder": shoulder, "collar": collar})
    names = list(points)
    at = names.index("collar_left")
    neck = {"neck": (h - rng.uniform(0.07, 0.09), 0.0)}
    return {**{n: points[n] for n in names[:at]}, **neck, **{n: points[n] for n in names[at:]}}


GARMENTS: Mapping[str, Callable[[np.random.Generator], Mapping[str, tuple[float, float]]]] = {
    "towel": _towel,
    "long_sleeve_shirt": lambda rng: _shirt(rng, rng.uniform(0.36, 0.42), (0.7, 0.95)),
    "t_shirt": lambda rng: _shirt(rng, rng.uniform(0.22, 0.27), (0.35, 0.6)),
    "pants": lambda rng: _legs(rng, 0.96, rng.uniform(0.27, 0.31), rng.uniform(0.155, 0.18), 0.045),
    "shorts": lambda rng: _legs(rng, 0.50, rng.uniform(0.25, 0.29), rng.uniform(0.22, 0.25), 0.022),
    "skirt": _skirt,
    "vest": _vest,
}
CRUMPLED = ("thrown", "hung")
"""Kinds of garments that do not lie flat: thrown down, or hung by a corner."""


def photograph(kind: str, seed: int) -> Photograph:
    """Draw a photograph of a garment. kind: its category, or a kind in `CRUMPLED`. The same kind and seed give the
    same photograph."""
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    if kind in CRUMPLED:
        points, outline = {}, _lump(rng) if kind == "thrown" else _hung(rng)
    else:
        named = GARMENTS[kind](rng)
        points = {name: np.array(p, dtype=float) for name, p in named.items()}
        outline = np.array(list(named.values()), dtype=float)
    size = SIZES[int(rng.integers(len(SIZES)))]
    H = _camera(rng, outline, size)
    mask = _filled(_softened(outline, rng))
    ground_name, cloth_name = str(rng.choice(GROUNDS)), str(rng.choice(CLOTHS))
    for _ in range(30):
        ground, cloth = _ground(rng, ground_name), _cloth(rng, cloth_name)
        contrast = _contrast(cloth, ground, mask)
        if contrast > 12.0:
            break
    lumpy = kind in CRUMPLED
    scene = _lit(rng, ground, cloth, mask, 2.5 if lumpy else 1.0)
    rgb = _taken(rng, scene, H, size)
    placed = {name: _project(H, p[None])[0] for name, p in points.items()}
    return Photograph(rgb, "" if lumpy else kind, placed, _project(H, outline), ground_name, cloth_name, contrast)


def _lump(rng: np.random.Generator) -> Points:
    a = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    r = 0.22 * (1 + sum(rng.uniform(0.06, 0.17) * np.cos(k * a + rng.uniform(0, 6)) for k in (2, 3, 4, 6, 9)))
    return np.asarray(r[:, None] * np.stack([np.cos(a), np.sin(a)], axis=1))


def _hung(rng: np.random.Generator) -> Points:
    """Draw the outline (n, 2) of a shirt held at one point: narrow at the top, wavy at the bottom [m]."""
    x = np.linspace(0.5, -0.5, 30)
    half = 0.02 + 0.16 * (0.5 - x) ** rng.uniform(0.6, 0.9) + 0.02 * np.sin(14 * x + rng.uniform(0, 6))
    bow = 0.05 * np.sin(3 * x + rng.uniform(0, 6))
    right = np.stack([x, bow - half], axis=1)[::-1]
    tail = [(-0.5 - rng.uniform(0.02, 0.1), y) for y in np.linspace(-half[-1], half[-1], 5)[1:-1] + bow[-1]]
    left = np.stack([x, bow + half], axis=1)
    return np.concatenate([right, left, np.array(tail)[::-1]])


def _camera(rng: np.random.Generator, outline: Points, size: tuple[int, int]) -> Points:
    """Draw the homography (3, 3) from the floor [m] to the picture [px], with some tilt and turn. The garment
    extends over about two thirds of the picture."""
    w, h = size
    tilt, towards = rng.uniform(0.0, np.deg2rad(18)), rng.uniform(0, 2 * np.pi)
    axis = tilt * np.array([np.cos(towards), np.sin(towards), 0.0])
    turn = rng.normal(0.0, np.deg2rad(8))
    R, _ = cv2.Rodrigues(axis)
    Rz, _ = cv2.Rodrigues(np.array([0.0, 0.0, turn]))
    R = R @ Rz @ np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # x up, y to the left
    focal = rng.uniform(0.8, 1.3) * max(w, h)
    K = np.array([[focal, 0, w / 2], [0, focal, h / 2], [0, 0, 1.0]])
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    fill = rng.uniform(0.55, 0.75)
    away = 1.0
    for _ in range(40):
        t = np.array([0.0, 0.0, away]) - R @ np.array([*middle, 0.0])
        H = K @ np.column_stack([R[:, 0], R[:, 1], t])
        seen = _project(H, outline)
        used = float((np.ptp(seen, axis=0) / (w, h)).max())
        away *= used / fill
    shift = (0.5 + rng.uniform(-0.05, 0.05, 2)) * (w, h) - 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    return np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1.0]]) @ H


def _project(H: Points, points: Points) -> Points:
    p = np.column_stack([points, np.ones(len(points))]) @ H.T
    return np.asarray(p[:, :2] / p[:, 2:])


def _cells(points: Points) -> Points:
    """Convert points on the floor (n, 2) [m] to cells of the floor map (column along y, row along x)."""
    return np.asarray((points[:, ::-1] + SPAN / 2) / STEP)


def _softened(outline: Points, rng: np.random.Generator) -> Points:
    """Curve the edges of the outline slightly. Its corners stay sharp; `_filled` rounds them."""
    out = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        n = max(int(np.linalg.norm(b - a) / 0.01), 2)
        s = np.linspace(0, 1, n, endpoint=False)[:, None]
        chord = b - a
        bow = rng.normal(0.0, 0.008) * np.linalg.norm(chord)
        away = np.array([chord[1], -chord[0]]) / max(float(np.linalg.norm(chord)), 1e-9)
        wave = 0.0015 * np.sin(np.pi * rng.uniform(3, 8) * s) * np.sin(np.pi * s)
        out.append(a + s * chord + (4 * s * (1 - s) * bow + wave) * away)
    return np.concatenate(out)


def _filled(outline: Points) -> Plane:
    n = int(SPAN / STEP)
    mask = np.zeros((n, n), np.uint8)
    cv2.fillPoly(mask, [np.round(_cells(outline) * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, ball), dtype=np.float32) / 255


def _noise(rng: np.random.Generator, along: float, across: float) -> Plane:
    """Draw smooth noise of unit variance over the floor map. along, across: correlation lengths down and across
    the map [m]."""
    n = int(SPAN / STEP)
    small = max(min(along, across) / STEP / 2, 1.0)
    m = max(int(n / small), 8)
    field = rng.standard_normal((m, m)).astype(np.float32)
    sigma = (across / STEP / small, along / STEP / small)
    field = np.asarray(cv2.GaussianBlur(field, (0, 0), sigmaX=max(sigma[0], 0.4), sigmaY=max(sigma[1], 0.4)))
    field = cv2.resize(field, (n, n), interpolation=cv2.INTER_CUBIC)
    return np.asarray((field - field.mean()) / max(float(field.std()), 1e-9), dtype=np.float32)


def _ground(rng: np.random.Generator, name: str) -> Plane:
    """Draw the reflectance (n, n, 3) of the ground, linear RGB."""
    n = int(SPAN / STEP)
    if name == "painted":
        base = rng.uniform(0.15, 0.75) * (1 + rng.normal(0, 0.12, 3))
        field = 1 + 0.02 * _noise(rng, 0.004, 0.004) + 0.04 * _noise(rng, 0.3, 0.3)
        return np.asarray(base * field[..., None], dtype=np.float32)
    if name == "carpet":
        base = rng.uniform(0.1, 0.5) * (1 + rng.normal(0, 0.2, 3))
        field = 1 + 0.16 * _noise(rng, 0.003, 0.003) + 0.08 * _noise(rng, 0.05, 0.05)
        return np.asarray(base * np.clip(field, 0.2, 3)[..., None], dtype=np.float32)
    if name == "tiles":
        base = rng.uniform(0.3, 0.7) * (1 + rng.normal(0, 0.06, 3))
        edge = int(rng.uniform(0.2, 0.4) / STEP)
        grid = np.ones((n, n), np.float32)
        for k in range(int(rng.integers(edge)), n, edge):
            grid[k : k + 2] = 0.6
            grid[:, k : k + 2] = 0.6
        tones = 1 + 0.05 * rng.standard_normal((n // edge + 2, n // edge + 2))
        tone = np.kron(tones, np.ones((edge, edge)))[:n, :n]
        field = grid * tone * (1 + 0.03 * _noise(rng, 0.02, 0.02))
        return np.asarray(base * field[..., None], dtype=np.float32)
    dark = np.array([0.16, 0.085, 0.04]) * rng.uniform(0.6, 1.6)
    light = dark * rng.uniform(1.6, 2.6) + 0.02
    board = int(rng.uniform(0.07, 0.16) / STEP)
    rows = np.arange(n) // board
    offset = rng.uniform(0, 40, n // board + 1)[rows][:, None]
    bend = 0.012 * _noise(rng, 0.05, 0.5) + 0.004 * _noise(rng, 0.015, 0.25)
    height = (np.arange(n)[:, None] * STEP + offset + bend).astype(np.float32)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * height / rng.uniform(0.010, 0.025))
    pores = np.clip(_noise(rng, 0.0015, 0.03) - 1.2, 0, None)
    tone = rng.normal(0, 0.10, n // board + 1)[rows][:, None]
    mix = np.clip(0.45 + 0.35 * (rings**2 - 0.4) + 0.15 * _noise(rng, 0.01, 0.4) + tone, 0, 1)
    wood = dark + mix[..., None] * (light - dark)
    seam = (np.arange(n) % board < 1)[:, None]
    wood = wood * (1 - 0.25 * np.minimum(pores, 1))[..., None] * np.where(seam, 0.5, 1.0)[..., None]
    return np.asarray(wood if rng.random() < 0.5 else np.swapaxes(wood, 0, 1), dtype=np.float32)


def _cloth(rng: np.random.Generator, name: str) -> Plane:
    n = int(SPAN / STEP)
    weave = 1 + 0.05 * _noise(rng, 0.003, 0.003)
    level = {"grey": rng.uniform(0.12, 0.4), "dark": rng.uniform(0.01, 0.04), "white": rng.uniform(0.7, 0.9)}
    if name in level:
        base = level[name] * (1 + rng.normal(0, 0.03, 3))
    elif name == "denim":
        base = np.array([0.05, 0.09, 0.2]) * rng.uniform(0.6, 1.8)
        weave = 1 + 0.18 * _noise(rng, 0.002, 0.006)
    else:
        hue = np.float32([[[rng.uniform(0, 360), rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.8)]]])
        base = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0] ** 2.2
    cloth = base * weave[..., None]
    if name == "striped":
        other = np.clip(rng.uniform(0.02, 0.8, 3), 0, 1)
        width = rng.uniform(0.02, 0.06)
        band = (np.arange(n) * STEP / width).astype(int) % 2 == 0
        where = band[:, None] if rng.random() < 0.5 else band[None, :]
        cloth = np.where(where[..., None], cloth, other * weave[..., None])
    return np.asarray(cloth, dtype=np.float32)


def _contrast(cloth: Plane, ground: Plane, mask: Plane) -> float:
    """CIE delta E between the ground around the cloth and the cloth. The cloth is divided into its darker and its
    lighter half; the half whose mean colour is nearer to that of the ground counts."""
    ring = cv2.dilate(mask, np.ones((41, 41))) - mask > 0.5
    there = _lab(ground[ring].mean(axis=0))
    inner = cloth[mask > 0.5]
    light = inner.mean(axis=1)
    halves = (inner[light <= np.median(light)].mean(axis=0), inner[light > np.median(light)].mean(axis=0))
    return min(float(np.linalg.norm(_lab(h) - there)) for h in halves)


def _lab(linear: Points) -> Points:
    encoded = np.clip(np.asarray(linear, dtype=np.float32), 0, 1) ** (1 / 2.2)
    return np.asarray(cv2.cvtColor(encoded[None, None], cv2.COLOR_RGB2LAB)[0, 0], dtype=np.float64)


def _lit(rng: np.random.Generator, ground: Plane, cloth: Plane, mask: Plane, wrinkled: float) -> Plane:
    """Light the scene: wrinkles are shaded by their slope; a contact shadow and a cast shadow are added."""
    relief = 0.0025 * np.abs(_noise(rng, 0.12, 0.04)) + 0.0012 * _noise(rng, 0.03, 0.06)
    relief = cv2.GaussianBlur(relief * wrinkled, (0, 0), 2.0)
    slope_x = cv2.Sobel(relief, cv2.CV_32F, 1, 0, ksize=3) / (8 * STEP)
    slope_y = cv2.Sobel(relief, cv2.CV_32F, 0, 1, ksize=3) / (8 * STEP)
    a = rng.uniform(0, 2 * np.pi)
    shading = np.clip(1 + 1.8 * (np.cos(a) * slope_x + np.sin(a) * slope_y), 0.45, 1.6)
    reach = rng.uniform(0.004, 0.014) / STEP
    M = np.float32([[1, 0, reach * np.cos(a)], [0, 1, reach * np.sin(a)]])
    cast = cv2.GaussianBlur(cv2.warpAffine(mask, M, mask.shape[::-1]), (0, 0), rng.uniform(1.5, 4.0))
    contact = cv2.GaussianBlur(mask, (0, 0), 2.5)
    shade = 1 - rng.uniform(0.2, 0.5) * cast - 0.25 * contact
    scene = mask[..., None] * cloth * shading[..., None] + (1 - mask[..., None]) * ground * shade[..., None]
    return np.asarray(scene, dtype=np.float32)


def _taken(rng: np.random.Generator, scene: Plane, H: Points, size: tuple[int, int]) -> Picture:
    """Take the picture as a camera stores it: perspective, vignetting, uneven and coloured light, exposure, noise,
    sharpening, JPEG."""
    w, h = size
    floor = np.array([[0.0, STEP, -SPAN / 2], [STEP, 0.0, -SPAN / 2], [0.0, 0.0, 1.0]])
    zoom = np.diag([2.0, 2.0, 1.0])
    picture = cv2.warpPerspective(
        scene, zoom @ H @ floor, (2 * w, 2 * h), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    picture = cv2.resize(picture, (w, h), interpolation=cv2.INTER_AREA)
    v, u = np.mgrid[0:h, 0:w].astype(np.float32)
    u, v = (u - w / 2) / max(w, h), (v - h / 2) / max(w, h)
    a, lamp = rng.uniform(0, 2 * np.pi), rng.uniform(-0.4, 0.4, 2)
    light = 1 + rng.uniform(0.0, 0.5) * (np.cos(a) * u + np.sin(a) * v)
    light += rng.uniform(0.0, 0.5) * np.exp(-((u - lamp[0]) ** 2 + (v - lamp[1]) ** 2) / 0.08)
    light *= 1 / (1 + rng.uniform(0.2, 0.9) * (u * u + v * v)) ** 2
    white = np.array([rng.uniform(0.85, 1.2), 1.0, rng.uniform(0.75, 1.15)], np.float32)
    picture = picture * light[..., None] * white
    picture *= rng.uniform(0.75, 1.1) * 0.65 / max(float(np.quantile(picture, 0.97)), 1e-3)
    noise = rng.normal(0, 0.004, picture.shape) * np.sqrt(np.maximum(picture, 0.01) * 10)
    picture = np.clip(picture + noise, 0, 1)
    encoded = np.asarray(picture, dtype=np.float32) ** (1 / 2.2) * 255
    encoded += 0.5 * (encoded - cv2.GaussianBlur(encoded, (0, 0), 1.2))
    bgr = np.clip(encoded, 0, 255).astype(np.uint8)[..., ::-1]
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 95))]
    _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(bgr), quality)
    return np.ascontiguousarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[..., ::-1])
