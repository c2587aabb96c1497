"""Solver settings, their validation, and the choice of substeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.robots.errors import ConfigurationError
from foldcell.skills.cloth.contact.contacts import PHASE
from foldcell.skills.cloth.crease_set import largest_crease_set
from foldcell.skills.cloth.elasticity import stretch_excess
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.vocabulary import Material

# Largest accepted estimate of the stretch error, as a fraction of the length. The error itself is then below
# 0.1 percentage points.
MOST_ESTIMATE = 3e-4
MOST_RESIDUAL = 1000.0  # [1/m] largest residual_curvature
CREASE_TIME = 1.0  # [s] default of crease_time (assumed; range 0.3 to 3 s)
CREASE_TIMES = (0.01, 100.0)  # [s] accepted values
LEAST_SUBSTEPS, MOST_SUBSTEPS = 16, 64  # bounds of the chosen substeps per frame; contacts need at least 16


@dataclass(frozen=True)
class SolverSettings:
    """Solver settings, and the properties of a fabric that a lab does not measure.

    frame_rate [1/s] times substeps is the number of steps per second. If substeps is None, the solver uses the
    fewest substeps with which the stretch is accurate (MOST_ESTIMATE), and raises ConfigurationError if too many
    would be needed. A given number of substeps is used unchanged. gravity [m/s2]: to simulate a tilted table, tilt
    this vector (the table stays at z = 0).

    stretch_damping, bend_damping: Rayleigh times [s], damping force = time x stiffness x rate (bending damping is
    reduced on meshes so fine that it would be unstable). drag [1/s] of the air. max_speed [m/s] caps every vertex.
    sleep_distance [m], sleep_frames: a vertex falls asleep if it stays within sleep_distance of one point for
    sleep_frames frames without gaining speed, or for three times as many frames in any case. A sleeping vertex
    costs no computing time until something moves near it. (With sleep_frames = 0, no vertex ever sleeps. The
    solver limits sleep_distance to a twelfth of the mean edge length.)

    anisotropy: stretch stiffness ratio of material y to material x. bending_ratio, 1/4 to 4: rigidity along
    material y (the warp) divided by the rigidity along x (the weft); the material's bending length belongs to
    their geometric mean. residual_curvature [1/m], 0 to 1000: bending friction, given as the largest curvature
    that released cloth keeps; with 0, cloth keeps no bend. This curvature is HB / B, as measured by the KES-F
    bending test: B is the rigidity, and the hysteresis loop is 2 HB high (six denims: 23 to 54, Journal of
    Textiles 2016, 4614168). crease_set: share of the turn beyond the elastic bend that a crease has taken as a
    plastic set after 5 min under 500 g on 15 x 18 mm; 0: creases take no set, only friction holds them.
    crease_time [s]: shortest of the times of the law of the set (crease_set.py), under the same load.
    """

    frame_rate: int = 60
    substeps: int | None = None
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    stretch_damping: float = 0.002
    bend_damping: float = 0.014
    drag: float = 0.05
    max_speed: float = 4.0
    sleep_distance: float = 1e-3
    sleep_frames: int = 10
    anisotropy: float = 1.0
    residual_curvature: float = 0.0
    bending_ratio: float = 1.0
    crease_set: float = 0.0
    crease_time: float = CREASE_TIME

    @property
    def frame(self) -> float:
        """Duration of a frame [s]."""
        return 1.0 / self.frame_rate


def check_cloth(material: Material, settings: SolverSettings, mesh: ClothMesh) -> None:
    """Raise ConfigurationError for a material, settings or mesh that cannot be simulated."""
    bounds = {
        "areal_mass": (0.01, 5.0),
        "stretch_fraction": (1e-4, 0.5),
        "bending_length": (1e-3, 0.5),
        "thickness": (1e-4, 0.02),
        "friction_static": (0.0, 5.0),
        "friction_dynamic": (0.0, material.friction_static),
        "friction_layers": (0.0, 5.0),
    }
    for name, (low, high) in bounds.items():
        _expect(f"material {name}", getattr(material, name), low, high)
    _expect("residual_curvature", settings.residual_curvature, 0.0, MOST_RESIDUAL)
    _expect("bending_ratio", settings.bending_ratio, 0.25, 4.0)
    _expect("crease_time", settings.crease_time, *CREASE_TIMES)
    most = largest_crease_set(settings.crease_time)
    why = ": a crease cannot keep more than its whole turn after a longer time"
    _expect("crease_set", settings.crease_set, 0.0, most, why)
    n = settings.substeps
    if settings.frame_rate <= 0 or (n is not None and (n % PHASE or n <= 0)):
        raise ConfigurationError(
            f"substeps must be a positive multiple of {PHASE}",
            "",
            substeps=n,
            frame_rate=settings.frame_rate,
        )
    if mesh.area.min() <= 0.0:
        raise ConfigurationError("the mesh has a triangle without area", "", index=int(mesh.area.argmin()))
    if mesh.edge_length.min() < material.thickness:
        raise ConfigurationError(
            "the mesh is finer than the cloth is thick",
            "use a longer edge length",
            shortest_edge=float(mesh.edge_length.min()),
            thickness=material.thickness,
        )


def _expect(name: str, value: float, low: float, high: float, why: str = "") -> None:
    if not low <= value <= high:
        raise ConfigurationError(f"{name} = {value} is out of range", f"{low:g} to {high:.4g}{why}", value=value)


def choose_substeps(mesh: ClothMesh, material: Material, settings: SolverSettings) -> int:
    """Return the number of substeps per frame (see SolverSettings)."""
    if settings.substeps is not None:
        return settings.substeps

    def error(n: int) -> float:
        return stretch_excess(mesh, material, settings.frame / n, settings.anisotropy)

    needed = LEAST_SUBSTEPS
    while error(needed) > MOST_ESTIMATE and needed < 1000:
        needed += PHASE
    if needed <= MOST_SUBSTEPS:
        return needed
    raise ConfigurationError(
        f"{MOST_SUBSTEPS} substeps a frame cannot hold the stretch of this cloth",
        f"{needed} substeps, a longer edge or a softer cloth",
        stretch_fraction=material.stretch_fraction,
        stretch_error=error(MOST_SUBSTEPS),
        needed_substeps=needed,
        edge_length=float(np.median(mesh.edge_length)),
    )
