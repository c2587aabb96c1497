"""The paper's friction test: one side of a table is lifted until the garment on it slides.

The operator measures the table's length L_t and the height H_s of the lifted side when the garment begins to
slide. Then angle = asin(H_s / L_t), and the Coulomb friction is tan(angle) (Li et al. 2015, IV-B). The virtual
table is lifted to this angle with a high friction. The friction is then lowered in small steps until the virtual
garment slides. This checks that the coefficient in the simulation means Coulomb friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.elasticity import GRAVITY
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Material

MIN_ANGLE, MAX_ANGLE = math.radians(2.0), math.radians(60.0)
START, MAX_FACTOR, STEP = 1.25, 5.0, 0.01
"""Frictions in units of tan(angle). START: friction with which the virtual table is lifted first. If the garment
already slides with it, the table is lifted again with a higher friction, until the garment holds or MAX_FACTOR is
reached. STEP: amount by which the friction is then lowered in each step."""
WATCH_S = 0.25
"""Time that is simulated at each friction [s]."""
MOVED = 5e-4
"""The garment slides if its mean displacement in WATCH_S is larger than this [m]. A garment that only settles on a
new slope moves less."""
AGREEMENT = 0.02
"""Largest accepted relative difference between the simulated coefficient and tan(angle)."""
LIFTS, LIFT_S = 10, 0.1
"""Number of steps in which the table is lifted, and the duration of each [s]."""
EDGE = 0.026

Picture = tuple[Array, float, float, float]
"""Vertices (n, 3), time since the last picture [s], slope of the table [rad] and friction."""


def friction_angle(height: float, length: float) -> float:
    """Return asin(H_s / L_t) [rad], with the height H_s of the lifted side and the table's length L_t [m].

    Raises ConfigurationError for a length outside 0.005 to 5 m or an angle outside 2 to 60 degrees.
    """
    for name, value in (("height", height), ("length", length)):
        if not (math.isfinite(value) and 0.005 <= value <= 5.0):
            raise ConfigurationError(
                f"{name} = {value:g} m is not possible for a table", "give metres, from 0.005 to 5", value=value
            )
    if height >= length:
        raise ConfigurationError(
            f"one side of a table of {length:g} m cannot be {height:g} m higher than the other",
            "height: of the lifted edge over the other edge; length: along the slope of the table",
            height=height, length=length,
        )  # fmt: skip
    angle = math.asin(height / length)
    if not MIN_ANGLE <= angle <= MAX_ANGLE:
        raise ConfigurationError(
            f"{height:g} m on {length:g} m are {math.degrees(angle):.1f} degrees, not 2 to 60 degrees",
            "measure the height of the lifted edge when the garment begins to slide",
            angle_rad=angle,
        )  # fmt: skip
    return angle


@dataclass(frozen=True, eq=False)
class FrictionCalibration:
    """Result of the friction test. angle: measured slope [rad]. coefficient: tan(angle). simulated: friction at
    which the virtual garment began to slide. tried: pairs (friction, displacement down the slope [m]).

    pictures: (k, n, 3) vertices in the table's frame [m]. times (k,) [s], lifts (k,) [rad], frictions (k,): time,
    slope of the table and friction of each picture.
    """

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
        """Relative error of the simulated coefficient."""
        return self.simulated / self.coefficient - 1.0


def tilted(points: Array, angle: float) -> Array:
    """Transform points (..., 3) from the table's frame to the room's. The side at x < 0 is lifted by `angle`
    [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points) @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


class _TiltedTable:
    """The virtual garment on the table. When the slope or the friction changes, the contact forces are carried
    over. Otherwise a garment of two layers would redistribute its weight at each change and slip meanwhile."""

    def __init__(self, mesh: ClothMesh, material: Material) -> None:
        self._mesh = mesh
        self._saved: dict[str, Array] | None = None
        self.positions = mesh.lay_flat(material.thickness)

    def advance(self, material: Material, angle: float, seconds: float) -> float:
        """Simulate `seconds`. Returns the mean displacement down the slope [m]."""
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
    """Measure the friction between the table and a garment of outline `template` (k, 2) [m], and check it in
    simulation.

    height: height of the table's lifted side [m]; length: length of the table [m]. The result's `agrees` states
    whether the virtual garment slides at tan(angle). Raises ConfigurationError for an impossible measurement.
    """
    angle = friction_angle(height, length)
    wanted = math.tan(angle)
    mesh = mesh_from_contour(template, EDGE, layers)
    held, table, film = _lift(mesh, material, angle, wanted)
    tried: list[tuple[float, float]] = []
    slid = 0.0
    while not slid and held > STEP * wanted:
        mu = held - STEP * wanted
        moved = table.advance(material.with_friction(mu), angle, WATCH_S)
        tried.append((mu, moved))
        film.append((table.positions, WATCH_S, angle, mu))
        if moved > MOVED:
            slid = mu
        else:
            held = mu
    tell(
        f"the virtual garment holds at {held:.4f} and slides at {slid:.4f};"
        f" tan({math.degrees(angle):.2f} degrees) = {wanted:.4f}"
    )
    pictures, seconds, lifts, frictions = (np.array(column) for column in zip(*film, strict=True))
    return FrictionCalibration(
        angle, wanted, 0.5 * (held + slid), tuple(tried), mesh, frozen(pictures),
        frozen(np.cumsum(seconds)), frozen(lifts), frozen(frictions),
    )  # fmt: skip


def _lift(
    mesh: ClothMesh, material: Material, angle: float, wanted: float
) -> tuple[float, _TiltedTable, list[Picture]]:
    """Lift the virtual table with a friction that holds the garment. Returns that friction, the table and its
    pictures."""
    factor = START
    while True:
        mu, table = factor * wanted, _TiltedTable(mesh, material)
        film: list[Picture] = []
        for lift in np.linspace(0.0, angle, LIFTS):
            table.advance(material.with_friction(mu), float(lift), LIFT_S)
            film.append((table.positions, LIFT_S, float(lift), mu))
        moved = table.advance(material.with_friction(mu), angle, WATCH_S)
        if moved <= MOVED or factor >= MAX_FACTOR:
            return mu, table, film
        factor *= 1.25
