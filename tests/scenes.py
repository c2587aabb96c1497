"""Rendered pictures of a garment on a table with known key points. They use none of the code under test, only
numpy and cv2.

A pinhole camera sees a textured table and a garment, which is a textured slab with rounded corners and wavy edges.
The light is uneven, the slab casts a soft shadow, the camera has blur and noise, and the exposure differs between
two pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np

from foldcell.robots.ports import CameraFrame, Intrinsics
from foldcell.skills.vocabulary import CameraCalibration, Table

TABLE = Table(height=-0.10, x=(0.20, 1.05), y=(-0.60, 0.60))
TOWEL = np.array([[0.20, 0.30], [-0.20, 0.30], [-0.20, -0.30], [0.20, -0.30]])
TOWEL_NAMES = ("far_left", "near_left", "near_right", "far_right")


def camera(position=(0.12, 0.0, 1.05), target=(0.6, 0.0, 0.0), width=640, height=480) -> CameraCalibration:
    """The nominal camera in the table frame, with a view of 58 x 45 degrees."""
    z = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = position
    intrinsics = Intrinsics(
        width,
        height,
        width / 2 / np.tan(np.deg2rad(29)),
        height / 2 / np.tan(np.deg2rad(22.5)),
        (width - 1) / 2,
        (height - 1) / 2,
    )
    return CameraCalibration(intrinsics, T)


def place(polygon, x, y, angle):
    """The polygon (k, 2) turned by `angle` [rad] about 0 and moved to (x, y)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(polygon) @ np.array([[c, s], [-s, c]]) + (x, y)


@dataclass
class Scene:
    """The objects on the table and the light. Colours are linear RGB, 0..1."""

    seed: int = 0
    table_colour: tuple = (0.45, 0.35, 0.25)
    table_contrast: float = 0.12
    planks: float = 0.0  # difference in brightness between the table's boards (sigma of the logarithm)
    polygons: list = field(default_factory=list)  # polygons (k, 2) in the table frame, all of one fabric
    fabric: tuple = (0.15, 0.25, 0.55)
    stripes: float = 0.0
    thickness: float = 0.003
    bumps: list = field(default_factory=list)  # (x, y, radius, height)
    rounding: float = 0.006
    wobble: float = 0.0015
    gradient: tuple = (0.25, 0.15)
    shadow: float = 0.45
    light: tuple = (0.5, 0.6)  # tangent of the light's angle along x and y
    gain: float = 1.0
    noise: float = 0.012
    blur: float = 0.6
    depth_noise: float = 1.4e-3
    floor: tuple | None = None  # colour beyond the table's edges; None: the table has no edges


def render(scene: Scene, calibration: CameraCalibration | None = None, sequence: int = 0) -> CameraFrame:
    """Take the picture."""
    calibration = calibration or camera()
    rng = np.random.default_rng([scene.seed, sequence])
    k = calibration.intrinsics
    points, _ = _intersect(calibration, 2, 0.0)
    layout = _Layout(scene)
    colour = _table(scene, points)
    inside, top = _garment(scene, layout, calibration)
    shade = layout.sample(layout.shadow, points)
    colour = colour * (1 - scene.shadow * shade[..., None])
    covered = inside > 0.5
    colour[covered] = _cloth(scene, top[covered])
    light = 1 + scene.gradient[0] * (points[..., 0] - 0.6) + scene.gradient[1] * points[..., 1]
    colour = cv2.resize(
        np.float32(colour * light[..., None] * scene.gain), (k.width, k.height), interpolation=cv2.INTER_AREA
    )
    if scene.blur:
        colour = cv2.GaussianBlur(colour, (0, 0), scene.blur)
    encoded = np.clip(colour, 0, 1) ** (1 / 2.2) + scene.noise * rng.standard_normal(colour.shape)
    rgb = np.uint8(np.clip(encoded, 0, 1) * 255 + 0.5)
    return CameraFrame(float(sequence), sequence, rgb, _depth(scene, layout, calibration, rng), k)


def _intersect(calibration, factor, z):
    """Table points (h, w, 2) at height z seen by each (sub)pixel, and their depth."""
    k, T = calibration.intrinsics, calibration.T_table_camera
    pinhole = k.width, k.height, k.fx, k.fy, k.cx, k.cy
    return _seen_at(pinhole, tuple(T.ravel().tolist()), factor, z)


@lru_cache(maxsize=4)  # pictures of one camera differ in the height of the garment only
def _seen_at(pinhole, pose, factor, z):
    T = np.reshape(pose, (4, 4))
    d = _directions(pinhole, pose, factor)
    depth = (z - T[2, 3]) / d[..., 2]
    return _kept(T[:2, 3] + d[..., :2] * depth[..., None]), _kept(depth)


@lru_cache(maxsize=2)
def _directions(pinhole, pose, factor):
    """Directions (h, w, 3) of the rays of the (sub)pixels, table frame."""
    width, height, fx, fy, cx, cy = pinhole
    u, v = np.meshgrid(np.arange(width * factor), np.arange(height * factor))
    rays = np.stack(
        [((u + 0.5) / factor - 0.5 - cx) / fx, ((v + 0.5) / factor - 0.5 - cy) / fy, np.ones_like(u, dtype=float)],
        axis=-1,
    )
    return _kept(rays @ np.reshape(pose, (4, 4))[:3, :3].T)


def _kept(array):
    array.flags.writeable = False
    return array


class _Layout:
    """The garment, its shadow and its height on a fine grid of the table (1 mm)."""

    def __init__(self, scene: Scene) -> None:
        self.step, self.origin, shape = 0.001, np.array([-0.3, -1.2]), (1800, 2400)
        if not scene.polygons:
            self.mask = self.height = self.shadow = np.zeros(shape, np.float32)
            return
        rng = np.random.default_rng(scene.seed + 1000)
        mask = np.zeros(shape, np.uint8)
        for polygon in scene.polygons:
            wavy = _wavy(polygon, scene.wobble, rng)
            cells = np.round(((wavy - self.origin) / self.step)[:, ::-1] * 16).astype(np.int32)
            cv2.fillPoly(mask, [cells], 255, shift=4)
        if scene.rounding > 0:
            size = 2 * round(scene.rounding / self.step) + 1
            ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
            mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, ball)
        self.mask = np.float32(mask) / 255
        self.height = self.mask * np.float32(scene.thickness)
        for x, y, radius, height in scene.bumps:
            gx = self.origin[0] + self.step * np.arange(shape[0])[:, None] - x
            gy = self.origin[1] + self.step * np.arange(shape[1])[None, :] - y
            self.height += np.float32(self.mask * height * np.exp(-(gx**2 + gy**2) / (2 * radius**2)))
        shift = np.array(scene.light) * (scene.thickness + 0.004) / self.step
        M = np.float32([[1, 0, shift[1]], [0, 1, shift[0]]])
        cast = np.maximum(cv2.warpAffine(self.mask, M, self.mask.shape[::-1]), self.mask)
        self.shadow = cv2.GaussianBlur(cast, (0, 0), 2.5)

    def sample(self, field_, points):
        grid = (points - self.origin) / self.step
        return cv2.remap(field_, np.float32(grid[..., 1]), np.float32(grid[..., 0]), cv2.INTER_LINEAR)


def _wavy(polygon, amplitude, rng):
    """The polygon resampled every 5 mm, with waves along the normals of its edges. Corners stay in place."""
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        length = np.linalg.norm(b - a)
        s = np.linspace(0, 1, max(int(length / 0.005), 2), endpoint=False)
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / length
        wave = sum(rng.normal() * np.sin(np.pi * n * s) / n for n in (1, 2, 3, 5, 7)) * amplitude
        out.append(a + np.outer(s, b - a) + np.outer(wave, normal))
    return np.concatenate(out)


def _table(scene, points):
    """The colour of wood, with soft streaks along y."""
    rng = np.random.default_rng(scene.seed + 2000)
    streaks = cv2.GaussianBlur(rng.standard_normal((512, 512)).astype(np.float32), (0, 0), sigmaX=12, sigmaY=1.2)
    streaks /= streaks.std()
    grid = np.float32((points * (350, 350)) % 512)
    texture = cv2.remap(streaks, grid[..., 1], grid[..., 0], cv2.INTER_LINEAR)
    boards = np.exp(scene.planks * rng.standard_normal(64))[(np.floor(points[..., 0] / 0.12).astype(int)) % 64]
    colour = np.array(scene.table_colour) * ((1 + scene.table_contrast * texture) * boards)[..., None]
    if scene.floor is None:
        return colour
    x, y = points[..., 0], points[..., 1]
    on = (x > TABLE.x[0]) & (x < TABLE.x[1]) & (y > TABLE.y[0]) & (y < TABLE.y[1])
    return np.where(on[..., None], colour, np.array(scene.floor))


def _cloth(scene, points):
    """The colour of woven cloth, with optional stripes and the soft shading of shallow waves."""
    weave = 1 + 0.05 * np.sin(points[..., 0] * 1500) * np.sin(points[..., 1] * 1400)
    waves = 1 + 0.05 * np.sin(points[..., 0] * 25 + 1) * np.cos(points[..., 1] * 18)
    stripe = 1 + scene.stripes * np.sign(np.sin(points[..., 1] * 60))
    return np.array(scene.fabric) * (weave * waves * stripe)[..., None]


def _garment(scene, layout, calibration):
    """Which subpixels see the slab's top, and at which point. The slab's side is thinner than a pixel."""
    top, _ = _intersect(calibration, 2, scene.thickness)
    return layout.sample(layout.mask, top), top


def _depth(scene, layout, calibration, rng):
    points, depth = _intersect(calibration, 1, 0.0)
    _, unit = _intersect(calibration, 1, 1.0)
    per_metre = unit - depth
    depth = depth + layout.sample(layout.height, points) * per_metre
    depth = depth + scene.depth_noise * depth**2 * rng.standard_normal(depth.shape)
    depth = np.float32(np.round(depth / 0.001) * 0.001)
    depth[rng.random(depth.shape) < 0.01] = np.nan
    return depth


def towel_scene(seed: int) -> tuple[Scene, np.ndarray]:
    """A random towel and its true key points (4, 2), in the order of `TOWEL_NAMES`."""
    rng = np.random.default_rng(seed)
    truth = place(TOWEL, rng.uniform(0.50, 0.68), rng.uniform(-0.10, 0.10), rng.uniform(-0.3, 0.3))
    fabrics = [(0.15, 0.25, 0.55), (0.75, 0.72, 0.68), (0.5, 0.08, 0.08), (0.1, 0.35, 0.15), (0.6, 0.5, 0.15)]
    tables = [(0.45, 0.35, 0.25), (0.3, 0.22, 0.14), (0.5, 0.5, 0.5), (0.55, 0.48, 0.38)]
    scene = Scene(
        seed=seed,
        polygons=[truth],
        fabric=fabrics[rng.integers(5)],
        table_colour=tables[rng.integers(4)],
        stripes=float(rng.choice([0.0, 0.3])),
        light=tuple(rng.uniform(-1, 1, 2)),
        shadow=rng.uniform(0.3, 0.6),
        gain=rng.uniform(0.9, 1.1),
        thickness=rng.uniform(0.002, 0.005),
    )
    return scene, truth


def empty(scene: Scene) -> CameraFrame:
    """An earlier picture of the same table without the garment, with another exposure and other noise."""
    bare = Scene(**{**scene.__dict__, "polygons": [], "bumps": [], "gain": 1.0})
    return render(bare, sequence=100_000)


SHIRT_NAMES = (
    "hem_right", "armpit_right", "cuff_right_in", "cuff_right_out", "shoulder_right", "neck_right",
    "neck_left", "shoulder_left", "cuff_left_out", "cuff_left_in", "armpit_left", "hem_left",
)  # fmt: skip
TROUSERS_NAMES = (
    "waist_right", "waist_left", "hem_left_out", "hem_left_in", "crotch", "hem_right_in", "hem_right_out",
)  # fmt: skip


def shirt(left=0.0, right=0.0, width=0.42, length=0.55, sleeve=0.42):
    """A long-sleeve shirt (12, 2), neck towards +x, counter-clockwise.

    left, right: angle of the sleeves [rad], positive towards the body; 0 means 40 degrees below the shoulder line.
    """

    def arm(side, swing):
        angle = np.deg2rad(40) + swing
        along = np.array([-np.sin(angle), side * np.cos(angle)])
        across = np.array([along[1], -along[0]]) * side
        shoulder = np.array([length / 2 - 0.03, side * width / 2])
        armpit = np.array([length / 2 - 0.20, side * width / 2])
        out = shoulder + sleeve * along
        return shoulder, armpit, out, out - 0.10 * across

    sl, al, ol, il = arm(1, left)
    sr, ar, orr, ir = arm(-1, right)
    hem = -length / 2
    neck = [(length / 2, -0.09), (length / 2, 0.09)]
    return np.array([(hem, -width / 2), ar, ir, orr, sr, *neck, sl, ol, il, al, (hem, width / 2)])


def trousers(left=0.0, right=0.0, length=0.92, waist=0.38):
    """Trousers (7, 2), waist towards +x, counter-clockwise. left, right: outward angle of the legs [rad]."""

    def leg(side, swing):
        hip = np.array([0.15, side * (waist / 2 + 0.02)])
        crotch = np.array([0.16, 0.0])
        c, s = np.cos(side * swing), np.sin(side * swing)
        R = np.array([[c, s], [-s, c]])
        out = hip + R @ (np.array([-length / 2, side * 0.20]) - hip)
        inner = crotch + R @ (np.array([-length / 2, side * 0.04]) - crotch)
        return out, inner

    ol, il = leg(1, left)
    orr, ir = leg(-1, right)
    half = waist / 2
    return np.array([(length / 2, -half), (length / 2, half), ol, il, (0.16, 0.0), ir, orr])


def with_arm(frame, calibration, tip, start, height=0.06, width=0.08, colour=(224, 172, 140)):
    """The picture `frame` with a person's arm over the table: from `start` to `tip` (2,) [m], `height` above
    it."""
    tip, start = np.asarray(tip, float), np.asarray(start, float)
    across = (tip - start)[::-1] * (1.0, -1.0)
    across *= 0.5 * width / np.linalg.norm(across)
    outline = np.array([start + across, tip + across, tip - across, start - across])
    points = np.column_stack([outline, np.full(4, height)])
    k, T = calibration.intrinsics, calibration.T_table_camera
    seen = (points - T[:3, 3]) @ T[:3, :3]
    pixels = np.round(seen[:, :2] / seen[:, 2:] * (k.fx, k.fy) + (k.cx, k.cy)).astype(np.int32)
    mask = np.zeros(frame.depth.shape, np.uint8)
    cv2.fillPoly(mask, [pixels], 1)
    _, depth = _intersect(calibration, 1, height)
    rgb, measured = frame.rgb.copy(), frame.depth.copy()
    rgb[mask > 0] = colour
    measured[mask > 0] = depth[mask > 0]
    return replace(frame, rgb=rgb, depth=measured)
