"""The paper's friction test: a table is lifted at one side until the garment on it slides.

The operator measures the table's length L_t and the height H_s of the lifted side when the garment begins to
slide: angle = asin(H_s / L_t), and by Coulomb friction = tan(angle) (Li et al. 2015, IV-B). The virtual table is
lifted to that angle with ample friction, and the friction is lowered little by little until the virtual garment
slides: a check that the simulation's coefficient is Coulomb's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robots.errors import ConfigurationError
from robots.ports import Array, frozen
from skills.cloth.elasticity import GRAVITY
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.settings import SolverSettings
from skills.cloth.solver import ClothSimulation
from skills.vocabulary import Material

__all__ = ["FrictionCalibration", "calibrate_friction", "friction_angle", "slides", "tilted"]

LEAST, MOST = math.radians(2.0), math.radians(60.0)
START, MOST_FRICTION, STEP = 1.25, 5.0, 0.01
"""Friction begins START times tan(angle), or more where the garment slides even then, and falls by STEP of it."""
WATCH_S = 0.25
"""[s] that the garment is watched at each friction."""
MOVED = 5e-4
"""[m] in WATCH_S that count as sliding; what a garment settles by when the slope is new is less."""
AGREEMENT = 0.02
"""Of the simulated coefficient with tan(angle), relative."""
LIFTS, LIFT_S = 10, 0.1
EDGE = 0.026


def friction_angle(height: float, length: float) -> float:
    """asin(H_s / L_t) [rad] of the lifted height H_s and the table's length L_t [m].

    Raises ConfigurationError for lengths that are none, or an angle outside 2 to 60 degrees.
    """
    for name, value in (("height", height), ("length", length)):
        if not (math.isfinite(value) and 0.005 <= value <= 5.0):
            raise ConfigurationError(
                f"{name} = {value:g} m cannot be measured on a table", "give metres, from 0.005 to 5", value=value
            )
    if height >= length:
        raise ConfigurationError(
            f"a side of a table {length:g} m long cannot stand {height:g} m higher than the other",
            "height: of the lifted edge over the other; length: along the table's slope",
            height=height, length=length,
        )  # fmt: skip
    angle = math.asin(height / length)
    if not LEAST <= angle <= MOST:
        raise ConfigurationError(
            f"{height:g} m on {length:g} m are {math.degrees(angle):.1f} degrees; garments slide at 2 to 60",
            "measure the height of the lifted edge at the moment when the garment begins to slide",
            angle_rad=angle,
        )  # fmt: skip
    return angle


@dataclass(frozen=True, eq=False)
class FrictionCalibration:
    """angle: measured [rad]. coefficient: tan(angle). simulated: the friction at which the virtual garment began
    to slide. tried: (friction, how far it moved down the slope [m]). pictures (k, n, 3) in the table's frame at
    times (k,) [s] with the table lifted by lifts (k,) [rad]; frictions (k,)."""

    angle: float
    coefficient: float
    simulated: float
    tried: tuple[tuple[float, float], ...]
    mesh: ClothMesh
    pictures: Array
    times: Array
    lifts: Array
    frictions: Array

    @property
    def agrees(self) -> bool:
        return abs(self.error) <= AGREEMENT

    @property
    def error(self) -> float:
        """Of the simulated coefficient, relative."""
        return self.simulated / self.coefficient - 1.0


def tilted(points: Array, angle: float) -> Array:
    """(..., 3) from the table's frame to the room's: its side at x < 0 is lifted by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points) @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def slides(
    mesh: ClothMesh, material: Material, angle: float, positions: Array | None = None, seconds: float = WATCH_S
) -> tuple[float, Array]:
    """How far the garment, at rest first, moves down the slope in `seconds` [m], and where it is then (n, 3)."""
    table = _Table(mesh, material, positions)
    moved = table.watch(material, angle, seconds)
    return moved, table.positions


class _Table:
    """The garment on the table from one slope and friction to the next: what its contacts bear is kept. Laid
    down anew, a garment of two layers shifts its weight first, and slips while it does."""

    def __init__(self, mesh: ClothMesh, material: Material, positions: Array | None = None) -> None:
        self._mesh = mesh
        self._saved: dict[str, Array] | None = None
        self.positions = mesh.lay_flat(material.thickness) if positions is None else positions

    def watch(self, material: Material, angle: float, seconds: float) -> float:
        """How far it moves down the slope in `seconds` [m]."""
        gravity = (GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle))
        settings = SolverSettings(gravity=gravity, drag=0.0, sleep_frames=0)
        simulation = ClothSimulation(self._mesh, material, self.positions, settings)
        if self._saved is not None:
            simulation.restore(self._saved)
        before = simulation.positions
        simulation.advance(max(1, round(seconds * settings.frame_rate)))
        self._saved, self.positions = simulation.checkpoint(), simulation.positions
        return float((self.positions - before)[:, 0].mean())


def calibrate_friction(
    template: Array,
    layers: int,
    material: Material,
    height: float,
    length: float,
    tell: Callable[[str], None] = lambda line: None,
) -> FrictionCalibration:
    """The friction with the table of a garment of outline `template` (k, 2) [m].

    Raises ConfigurationError for a measurement that cannot be. Whether the virtual garment slides where
    tan(angle) says is the result's `agrees`.
    """
    angle = friction_angle(height, length)
    wanted = math.tan(angle)
    mesh = mesh_from_contour(template, EDGE, layers)
    held, table, film = _lift(mesh, material, angle, wanted)
    tried: list[tuple[float, float]] = []
    slid = 0.0
    while not slid and held > STEP * wanted:
        mu = held - STEP * wanted
        moved = table.watch(material.with_friction(mu), angle, WATCH_S)
        tried.append((mu, moved))
        film.take(table, WATCH_S, angle, mu)
        if moved > MOVED:
            slid = mu
        else:
            held = mu
    tell(f"holds at {held:.4f}, slides at {slid:.4f}; tan({math.degrees(angle):.2f} degrees) = {wanted:.4f}")
    return FrictionCalibration(
        angle, wanted, 0.5 * (held + slid), tuple(tried), mesh, frozen(np.array(film.pictures)),
        frozen(np.cumsum(film.seconds)), frozen(np.array(film.lifts)), frozen(np.array(film.frictions)),
    )  # fmt: skip


class _Film:
    """What is shown of the test, picture by picture."""

    def __init__(self) -> None:
        self.pictures: list[Array] = []
        self.seconds: list[float] = []
        self.lifts: list[float] = []
        self.frictions: list[float] = []

    def take(self, table: _Table, seconds: float, lift: float, friction: float) -> None:
        self.pictures.append(table.positions)
        self.seconds.append(seconds)
        self.lifts.append(lift)
        self.frictions.append(friction)


def _lift(mesh: ClothMesh, material: Material, angle: float, wanted: float) -> tuple[float, _Table, _Film]:
    """Lift the table with a friction that holds the garment: that friction, and the garment on the slope."""
    factor = START
    while True:
        mu, table, film = factor * wanted, _Table(mesh, material), _Film()
        for lift in np.linspace(0.0, angle, LIFTS):
            table.watch(material.with_friction(mu), float(lift), LIFT_S)
            film.take(table, LIFT_S, float(lift), mu)
        moved = table.watch(material.with_friction(mu), angle, WATCH_S)
        if moved <= MOVED or factor >= MOST_FRICTION:
            return mu, table, film
        factor *= 1.25
