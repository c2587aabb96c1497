"""The garment of the simulated world: its true outline, mesh and fabric, and its cloth on the table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.garment.cloth_body import FRAME_RATE, BodyTraits, ClothBody, build_body
from foldcell.cell.simulation.garment.outline import draw_outline
from foldcell.cell.simulation.garment.pressing import draw_crease, tip_pressure
from foldcell.cell.simulation.noise import GarmentNoise
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry, PinchReport
from foldcell.skills.fold_plan.crease_mesh import creases_of, mesh_near_creases
from foldcell.skills.garments.garment import Garment, Span
from foldcell.skills.vocabulary import Array, Material

COARSEST = 0.0265
"""Largest edge length of the mesh, away from creases [m]."""
GRID_TURNS = (4.0, 34.0)
"""Turns of the mesh's grid [degrees] at which the rigidities along warp and weft are right (`bending_shares`). The
grid of a world is turned from one of these by up to GRID_SPREAD."""
GRID_SPREAD = 3.0
CATCH = 0.02
"""Cloth counts as under a fingertip if it is at most this far above the tip [m] or lower."""


@dataclass(frozen=True)
class _Pose:
    x: float
    y: float
    angle: float

    def place(self, xy: Array) -> Array:
        return np.asarray(np.add(_turned(xy, self.angle), (self.x, self.y)))


class WorldGarment:
    """One garment. `lay` puts it on the table. All its properties are drawn from `rng` at the start.

    world: solver of its cloth. ideal: without errors. Raises ConfigurationError like `check_body`.
    """

    def __init__(
        self, garment: Garment, noise: GarmentNoise, rng: np.random.Generator, ideal: bool, world: str = "xpbd"
    ) -> None:
        self._noise, self._ideal, self.solver = noise, ideal, world
        self.name, self.layers = garment.name, garment.layers
        outline = draw_outline(garment, noise, rng, ideal)
        self.material = garment.material if ideal else _vary(garment, noise, rng)
        self.pose = _Pose(*garment.poses.sample(rng))
        self._poses = garment.poses
        self._edge = float(noise.edge_length * self.material.bending_length * rng.uniform(0.95, 1.05))
        turn = np.deg2rad(GRID_TURNS[int(rng.integers(2))] + GRID_SPREAD * rng.uniform(-1.0, 1.0))
        self.mesh: ClothMesh = mesh_near_creases(
            outline.contour, COARSEST, garment.layers, turn, creases_of(garment, outline.keypoints,
            outline.contour), self.material.bending_length, self._edge
        )  # fmt: skip
        self._corners = np.ascontiguousarray(self.mesh.triangles.T)
        self.keypoints: Mapping[str, Array] = {n: self.pose.place(p) for n, p in outline.keypoints.items()}
        share = 0.0 if ideal else 1.0
        damping = 1.0 + share * noise.damping * rng.uniform(-1.0, 1.0)
        anisotropy = 1.0 - share * noise.anisotropy * rng.uniform()
        self.pads = PadGeometry()
        self._wrinkles = int(rng.integers(2**31))
        # a separate generator, so that the other random numbers of a seed stay the same as in older versions
        spread = noise.residual_curvature_spread * np.random.default_rng((self._wrinkles, 1)).uniform(-1.0, 1.0)
        ratio = 1.0 if ideal or garment.fabric is None else _log_uniform(garment.fabric.bending_ratio, rng)
        crease_set, crease_time = draw_crease(
            share * self.material.crease_set, noise, np.random.default_rng((self._wrinkles, 2))
        )
        residual = share * noise.residual_curvature * (1.0 + spread)
        self.traits = BodyTraits(anisotropy, damping, residual, ratio, crease_set, crease_time)
        self._relief = self._draw_relief(rng)
        self._body: ClothBody | None = None
        self._pressed = False
        self.away = False
        """Whether somebody has taken the garment off the table."""

    # position

    @property
    def laid(self) -> bool:
        return self._body is not None and not self.away

    @property
    def flat(self) -> Array:
        """Vertices (n, 2) of the perfectly flat garment in the pose in which it is laid, table frame [m]."""
        return self.pose.place(self.mesh.rest)

    @property
    def positions(self) -> Array:
        """(n, 3) vertices, table frame [m]."""
        return self._cloth.positions

    @property
    def _cloth(self) -> ClothBody:
        assert self._body is not None, "no garment lies on the table"
        return self._body

    def lay(self) -> None:
        """Put the garment on the table with small wrinkles and let it come to rest."""
        self._body, self.away = self._build(self._wrinkled()), False
        self._cloth.advance(round(self._noise.settle_time * FRAME_RATE))

    def put(self, vertices: Array) -> None:
        """Put the garment on the table at rest at `vertices` (n, 3), table frame [m], for pictures of a known
        shape. It moves from there as soon as time passes."""
        self._body = self._build(vertices)

    def _build(self, positions: Array) -> ClothBody:
        return build_body(self.solver, self.mesh, self.material, positions, self.traits, self.pads)

    def _wrinkled(self) -> Array:
        """Return vertices (n, 3) with waves in random directions. The outline shrinks, so that the cloth keeps its
        length."""
        lying = self.mesh.lay_flat(self.material.thickness)
        if self._ideal:
            return np.column_stack((self.flat, lying[:, 2]))
        rng = np.random.default_rng(self._wrinkles)
        rest = self.mesh.rest
        height = np.zeros(len(rest))
        shrunk = rest.copy()
        for _ in range(3):
            angle, phase = rng.uniform(0.0, np.pi), rng.uniform(0.0, 2 * np.pi)
            along = np.array([np.cos(angle), np.sin(angle)])
            k = 2 * np.pi / (self._noise.wrinkle_length * rng.uniform(0.8, 1.6))
            amplitude = self._noise.wrinkle_height * abs(rng.normal()) / 2
            height += amplitude * (1.0 + np.sin(k * (rest @ along) + phase))
            shrunk -= np.outer(0.25 * (k * amplitude) ** 2 * (rest @ along), along)
        return np.column_stack((self.pose.place(shrunk), lying[:, 2] + height))

    def _draw_relief(self, rng: np.random.Generator) -> Array:
        """Draw heights (n,) of small creases in the fabric [m]. Only the camera sees them."""
        height = np.zeros(len(self.mesh.rest))
        for _ in range(6):
            angle, phase = rng.uniform(0.0, np.pi), rng.uniform(0.0, 2 * np.pi)
            k = 2 * np.pi / (self._noise.relief_length * rng.uniform(0.8, 2.0))
            height += np.sin(k * (self.mesh.rest @ (np.cos(angle), np.sin(angle))) + phase)
        height *= self._noise.relief / np.sqrt(3.0)
        return np.zeros_like(height) if self._ideal else np.maximum(height - height.min(), 0.0)

    @property
    def seen(self) -> Array:
        """(n, 3) vertices for the camera, with small creases that the solver does not simulate [m]."""
        x = self._cloth.positions
        x[:, 2] += self._relief
        return x

    # actions of the robot

    def grip(self, hand: int, position: Array, rotation: Array, stroke: float, force: float) -> PinchReport:
        """Close the pads from an opening of `stroke` [m] with `force` [N], at a pose in the table frame."""
        self._cloth.pads = replace(self._cloth.pads, stroke=stroke)
        return self._cloth.grip(hand, position, rotation, force)

    def release(self, hand: int) -> None:
        if self.laid:
            self._cloth.release(hand)

    def holds(self, hand: int) -> bool:
        return self.laid and self._cloth.held(hand)

    def squeeze(self, hand: int, force: float) -> None:
        self._cloth.set_grip_force(hand, force)

    def pull(self, hand: int) -> Array:
        """Return the force (3,) [N] of the cloth on the hand."""
        return self._cloth.pinch_force(hand)

    def press(self, tips: Array, force: Array, area: float) -> None:
        """Let fingertips at `tips` (k, 3) [m] press with `force` (k,) [N], each on a contact of `area` [m2], until
        the next call."""
        if self.laid and (self._pressed or force.any()):
            self._pressed = bool(force.any())
            x = self._cloth.positions
            self._cloth.press(tip_pressure(x, tips, force, area, self._edge))

    def frame(self, position: Array, rotation: Array, capsules: tuple[Array, Array, Array] | None) -> None:
        """Advance by one frame. position (2, 2, 3), rotation (2, 2, 3, 3): of both hands at the start and the end
        of the frame. capsules: both ends (2, k, 3) and radius (k,) [m]."""
        if self.laid:
            self._cloth.advance_along(position, rotation, capsules)

    # actions of a person

    def shove(self, shift: Array, turn: float) -> None:
        """Move the garment, as it lies, by `shift` (2,) [m] and turn it about its middle by `turn` [rad]. Held
        cloth is released."""
        x = self._cloth.positions
        middle = x[:, :2].mean(axis=0)
        x[:, :2] = _turned(x[:, :2] - middle, turn) + middle + shift
        self._cloth.set_positions(x)

    def outside_poses(self, shift: Array, turn: float) -> float:
        """Return how far a shove would move the garment out of its permitted poses [m]; 0 if it stays within them.
        A radian counts as the distance by which it moves a point 0.3 m away."""
        x = self._cloth.positions[:, :2]
        flat = self.flat
        middle = x.mean(axis=0)
        centred, lying = flat - flat.mean(axis=0), x - middle
        angle = np.arctan2(
            np.sum(centred[:, 0] * lying[:, 1] - centred[:, 1] * lying[:, 0]), np.sum(centred * lying)
        )
        centre = middle + shift + _turned((self.pose.x, self.pose.y) - flat.mean(axis=0), float(angle) + turn)
        values = (*centre, self.pose.angle + angle + turn)
        ranges = (self._poses.x, self._poses.y, self._poses.angle)
        beyond = [max(low - v, v - high, 0.0) for v, (low, high) in zip(values, ranges, strict=True)]
        return float(np.hypot(beyond[0], beyond[1]) + 0.3 * beyond[2])

    # measurements

    def stack(self, point: Array) -> float:
        """Return the thickness that all layers under a fingertip at `point` (3,) have when they are pressed flat
        [m]."""
        if not self.laid:
            return 0.0
        x = self._cloth.positions
        along, across = x[:, 0] - point[0], x[:, 1] - point[1]
        near = np.sqrt(along * along + across * across) < 2.0 * self._edge
        if not near.any():
            return 0.0
        a, b, c = self._corners
        corners = x[self.mesh.triangles[near[a] & near[b] & near[c]]]
        if len(corners) == 0:
            return 0.0
        a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        r = point - a
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        area = np.where(np.abs(area) < 1e-12, np.inf, area)  # vertical triangles cover nothing
        s, t = (r[:, 0] * v[:, 1] - r[:, 1] * v[:, 0]) / area, (u[:, 0] * r[:, 1] - u[:, 1] * r[:, 0]) / area
        height = a[:, 2] + s * u[:, 2] + t * v[:, 2]
        under = (s >= 0) & (t >= 0) & (s + t <= 1) & (height < point[2] + CATCH)
        return float(np.count_nonzero(under) * self.material.thickness)

    def highest(self) -> float:
        return float(self._cloth.positions[:, 2].max()) if self.laid else 0.0

    def clear_of(self, p0: Array, p1: Array, radius: float) -> bool:
        """Whether no vertex is within `radius` [m] of the segment p0-p1."""
        if not self.laid:
            return True
        x = self._cloth.positions
        axis = p1 - p0
        s = np.clip((x - p0) @ axis / (axis @ axis), 0.0, 1.0)
        return bool(np.min(np.linalg.norm(x - p0 - s[:, None] * axis, axis=1)) > radius)

    def checkpoint(self) -> dict[str, NDArray] | None:
        return self._cloth.checkpoint() if self._body is not None else None

    def restore(self, saved: Mapping[str, NDArray] | None) -> None:
        self.away = False
        if saved is None:
            self._body = None
            return
        if self._body is None:
            self._body = self._build(self.mesh.lay_flat(self.material.thickness))
        self._cloth.restore(saved)
        self._pressed = True  # perhaps: the next frame sets the pressure anew


def _turned(xy: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(xy @ np.array([[c, s], [-s, c]]))


def _vary(garment: Garment, noise: GarmentNoise, rng: np.random.Generator) -> Material:
    """Draw the true fabric. Properties that a lab can measure easily differ from the garment file by at most their
    share in the noise table. The other properties are drawn from the whole range of the class of fabrics."""
    nominal, fabric = garment.material, garment.fabric

    def near(value: float, share: float) -> float:
        return value * (1.0 + share * rng.uniform(-1.0, 1.0))

    def within(name: str) -> float:
        span: Span | None = getattr(fabric, name, None)
        return near(getattr(nominal, name), getattr(noise, name)) if span is None else float(rng.uniform(*span))

    varied = replace(
        nominal,
        areal_mass=near(nominal.areal_mass, noise.areal_mass),
        stretch_fraction=near(nominal.stretch_fraction, noise.stretch_fraction),
        bending_length=within("bending_length"),
        thickness=within("thickness"),
        friction_layers=within("friction_layers"),
    )
    return varied.with_friction(near(nominal.friction_static, noise.friction))


def _log_uniform(span: Span, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(span))))
