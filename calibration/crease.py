"""The crease recovery test (AATCC 66 kind): a coupon is folded, loaded, unloaded, and its kept angle measured.

A coupon of 40 x 15 mm is folded in half. A weight lies for some minutes on the folded end, 18 mm deep. Then the
coupon recovers. The standard turns the clamped coupon so that the free limb hangs vertically, where its weight
bends the crease little. The virtual coupon therefore has no weight. Its lower limb is clamped behind the
weight, as in the standard's holder. The kept angle is 180 degrees less the angle between the limbs (the crease
recovery angle).

The weight is a capsule of large radius, which comes down until it touches two layers, and a pressure on the cloth
below it. While the weight lies, the shape does not change, so the set is computed in few large steps, with some
frames of the solver between them (`ClothSimulation.dwell`). The simulated cloth does not recover further once it
is at rest, so the five minutes of recovery are two seconds of simulated motion.

As in the standard, the result is the mean of several specimens. Here they differ by the direction of the mesh: a
crease across a mesh of 2 or 4 mm keeps 94 to 117 degrees, since few triangles lie in its width.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.crease_set import largest_crease_set
from foldcell.skills.cloth.elasticity import GRAVITY
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import CREASE_TIME, SolverSettings
from foldcell.skills.cloth.solver import Capsules, ClothSimulation
from foldcell.skills.vocabulary import Material

LENGTH, WIDTH, LOADED = 0.040, 0.015, 0.018
"""Length and width of the coupon, and depth of the weight on its folded end [m]."""
LOADED_AREA = WIDTH * LOADED
EDGE = 0.004
RADIUS = 0.5
"""Radius of the capsule that stands for the weight [m]. Its underside rises by 0.1 mm at the rim of the weight."""
LOOP = 0.003
"""Radius of the bend with which the coupon is laid [m]."""
SUBSTEPS = 128
"""Substeps per frame. With 64, coupons of fabrics that stretch by less than 1.1 % become unstable."""
DRAG = 30.0
"""Drag of the air [1/s], which lets the limbs come to rest without swinging."""
LOWER_S, DWELL_STEPS, RISE_S, RECOVER_S = 0.5, 8, 0.25, 1.5
"""Time in which the weight comes down, number of steps of the dwell, time in which the weight rises, and time in
which the coupon then comes to rest [s]."""
CLOSE, AGREEMENT = math.radians(1.0), math.radians(3.0)
"""CLOSE: difference of the angles at which the search ends. AGREEMENT: largest accepted difference between the
simulated and the measured angle [rad]."""
MOST_TRIES = 8
SPECIMENS = 6
RESIDUAL_CURVATURE = 44.0
"""Bending friction of the coupon [1/m], the mean of six denims (Journal of Textiles 2016, 4614168)."""
MOST_THICKNESS = 0.25
"""Largest thickness of the simulated coupon in edges of its mesh. A thicker fabric is simulated as if the weight
pressed it to this thickness."""


def load_pressure(load: float) -> float:
    """Return the pressure [Pa] of a weight of `load` [kg] on the folded end of the coupon."""
    return load * GRAVITY / LOADED_AREA


@dataclass(frozen=True, eq=False)
class PressedCoupon:
    """One simulated specimen. kept: kept angle [rad]; mesh; pictures (k, n, 3), times (k,) [s]: the coupon."""

    kept: float
    mesh: ClothMesh
    pictures: Array
    times: Array


def press_coupons(
    material: Material,
    crease_set: float,
    pressure: float,
    seconds: float,
    residual_curvature: float = RESIDUAL_CURVATURE,
    edge: float = EDGE,
    specimens: int = SPECIMENS,
) -> tuple[float, PressedCoupon]:
    """Simulate the test. Returns the mean kept angle [rad] and the first specimen.

    pressure [Pa] and seconds [s]: of the weight; a pressure of 0 means that the coupon is held closed. edge [m]:
    of the mesh. The other arguments are as in `SolverSettings`.
    """
    settings = SolverSettings(
        substeps=SUBSTEPS, gravity=(0.0, 0.0, 0.0), drag=DRAG, sleep_frames=0,
        residual_curvature=residual_curvature, crease_set=crease_set,
    )  # fmt: skip
    pressed = replace(material, thickness=min(material.thickness, MOST_THICKNESS * edge))
    coupons = [
        _pressed(_coupon(edge, k / specimens), pressed, settings, pressure, seconds) for k in range(specimens)
    ]
    return float(np.mean([coupon.kept for coupon in coupons])), coupons[0]


def _coupon(edge: float, rotate: float) -> ClothMesh:
    corners = 0.5 * np.array([[-LENGTH, -WIDTH], [LENGTH, -WIDTH], [LENGTH, WIDTH], [-LENGTH, WIDTH]])
    return mesh_from_contour(corners, edge, rotate=rotate)


def _pressed(
    mesh: ClothMesh, material: Material, settings: SolverSettings, pressure: float, seconds: float
) -> PressedCoupon:
    t = material.thickness
    x = _folded(mesh.rest, t)
    s = ClothSimulation(mesh, material, x, settings, fixed=mesh.rest[:, 0] < -0.99 * 0.5 * LENGTH)
    film = _Film(s)
    high, low = 2.0 * LOOP + 2.0 * t, 2.0 * t
    film.advance(LOWER_S, high, low)
    s.press(np.where(np.abs(mesh.rest[:, 0]) < LOADED, pressure, 0.0))
    part = seconds / DWELL_STEPS
    for _ in range(DWELL_STEPS):
        film.advance(min(0.1, part), low, low)
        s.dwell(max(0.0, part - 0.1))
    s.press(0.0)
    film.advance(RISE_S, low, high + LENGTH)
    film.advance(RECOVER_S)
    return PressedCoupon(
        kept_angle(mesh, s.positions), mesh, frozen(np.array(film.pictures)), frozen(np.array(film.times))
    )


class _Film:
    """Advances the coupon under the weight, and collects pictures of it."""

    def __init__(self, simulation: ClothSimulation) -> None:
        self._s = simulation
        self.pictures: list[Array] = [simulation.positions]
        self.times: list[float] = [0.0]

    def advance(self, seconds: float, z0: float | None = None, z1: float = 0.0) -> None:
        """Advance by `seconds`. z0, z1: height of the weight's underside before and after [m]; None: no weight."""
        s, frame = self._s, self._s.settings.frame
        frames = max(1, round(seconds / frame))
        height = None if z0 is None else np.linspace(z0, z1, frames + 1)
        for k in range(frames):
            weight = None if height is None else _weight(float(height[k]), float(height[k + 1]))
            s.advance(1, weight)
            if k % 3 == 2 or k + 1 == frames:
                self.pictures.append(s.positions)
                self.times.append(s.time)


def _weight(z0: float, z1: float) -> Capsules:
    """Return the capsule of the weight while its underside moves from z0 to z1 [m] in one frame."""
    end = np.array([[[0.5 * LOOP - 0.5 * LOADED, -WIDTH, z + RADIUS]] for z in (z0, z1)])
    return end, end * [1.0, -1.0, 1.0], np.array([RADIUS])


def _folded(rest: Array, thickness: float) -> Array:
    """Return (n, 3): the coupon folded at x = 0 with the half at x > 0 on top; the bend has the radius LOOP."""
    s, half = rest[:, 0], 0.5 * np.pi * LOOP
    angle = np.clip(s, -half, half) / LOOP  # from -90 to 90 degrees
    x = LOOP * np.cos(angle) - np.maximum(np.abs(s) - half, 0.0)
    z = 0.5 * thickness + LOOP + LOOP * np.sin(angle)
    return np.column_stack([x, rest[:, 1], z])


def kept_angle(mesh: ClothMesh, positions: Array) -> float:
    """Return the kept angle [rad] of a coupon at positions (n, 3)."""
    s = mesh.rest[:, 0]
    limbs = []
    for sign in (-1.0, 1.0):
        of = sign * s > 0.25 * LENGTH
        out = np.abs(s[of]) - np.abs(s[of]).mean()
        direction = out @ (positions[of][:, [0, 2]])
        limbs.append(direction / np.linalg.norm(direction))
    (ax, az), (bx, bz) = limbs
    opening = math.atan2(ax * bz - az * bx, ax * bx + az * bz)  # from the lower limb to the upper one
    return (1.5 * math.pi + opening) % (2.0 * math.pi) - 0.5 * math.pi  # from -90 to 270 degrees


@dataclass(frozen=True, eq=False)
class CreaseCalibration:
    """Result of the crease recovery test.

    crease_set: as in `SolverSettings`. kept, simulated: measured angle, and mean of the simulated specimens [rad].
    pressure [Pa], seconds [s]: of the weight. coupon: the first specimen.
    """

    crease_set: float
    kept: float
    simulated: float
    pressure: float
    seconds: float
    coupon: PressedCoupon

    @property
    def agrees(self) -> bool:
        return abs(self.error) <= AGREEMENT

    @property
    def error(self) -> float:
        """Simulated less measured angle [rad]."""
        return self.simulated - self.kept


def check_crease(kept: float, load: float, seconds: float) -> None:
    """Check a measurement: kept angle [rad], load [kg], time [s]. Raises ConfigurationError."""
    for name, value, low, high, unit in (
        ("angle", math.degrees(kept), 1.0, 179.0, "degrees, kept of 180"),
        ("load", load, 0.01, 10.0, "kg"),
        ("time", seconds, 1.0, 86400.0, "s"),
    ):
        if not (math.isfinite(value) and low <= value <= high):
            raise ConfigurationError(
                f"{name} = {value:g} is not possible in this test", f"give {low:g} to {high:g} {unit}", value=value
            )


def calibrate_crease(
    material: Material,
    kept: float,
    load: float,
    seconds: float,
    residual_curvature: float = RESIDUAL_CURVATURE,
    tell: Callable[[str], None] = lambda line: None,
    edge: float = EDGE,
) -> CreaseCalibration:
    """Find the crease_set with which simulated coupons keep the measured angle in the mean, by regula falsi.

    kept: angle that the crease keeps [rad], 180 degrees less the crease recovery angle; load [kg]; seconds: time
    under load [s]; residual_curvature [1/m]: bending friction of the simulated cloth. If friction alone keeps more
    than the measured angle, or full set keeps less, the result is the end of the range and does not agree. Raises
    ConfigurationError for an impossible measurement.
    """
    check_crease(kept, load, seconds)
    pressure = load_pressure(load)

    def test(value: float) -> tuple[float, PressedCoupon]:
        angle, coupon = press_coupons(material, value, pressure, seconds, residual_curvature, edge)
        tell(f"crease_set {value:.3f}: the virtual crease keeps {math.degrees(angle):.1f} degrees")
        return angle, coupon

    low, high = 0.0, largest_crease_set(CREASE_TIME)
    ends = {value: test(value) for value in (low, high)}
    best = min(ends, key=lambda value: abs(ends[value][0] - kept))
    (below, _), (above, _) = ends[low], ends[high]
    angle, coupon = ends[best]
    for _ in range(MOST_TRIES):
        if abs(angle - kept) <= CLOSE or not below < kept < above:
            break
        best = low + (high - low) * float(np.clip((kept - below) / (above - below), 0.1, 0.9))
        angle, coupon = test(best)
        if angle < kept:
            low, below = best, angle
        else:
            high, above = best, angle
    return CreaseCalibration(best, kept, angle, pressure, seconds, coupon)
