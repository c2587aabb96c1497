"""MuJoCo's flex as an independent cloth: the optional extra `peers`, never needed at run time.

The same mesh, areal mass, membrane modulus Y, flexural rigidity B and friction. MuJoCo's shell is a plate of
Young modulus E and thickness t with Y = E t and B = E t^3 / (12 (1 - nu^2)), so t = sqrt(12 (1 - nu^2) B / Y); it
is not the thickness of its contacts. A hand holds one vertex (ours a line of 20 mm).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.cloth.physics import (
    CREEP_RATIO,
    FRICTIONS,
    PATCH,
    SLIDE_RATIOS,
    STRETCHES,
    STRIP,
    Figures,
    slide_expected,
)
from benchmarks.cloth.scenes import MATERIAL, RELEASE, SETTLE, SharedFold, grid_mesh, optimised_fold, plain_fold
from calibration.bending import peirce
from robots.ports import Array, Side
from skills.cloth.elastic import GRAVITY, flexural_rigidity, membrane_modulus
from skills.cloth.mesh import ClothMesh
from skills.cloth.predict import predict_fold
from skills.vocabulary import REFERENCE_DROP, Material, ToolPath

POISSON = 1.0 / 3.0
STEP = 0.002
SOLREF = "0.005 1"
"""Of contacts: MuJoCo's own 0.02 s lets cloth creep by centimetres in a fold."""


@dataclass(frozen=True)
class _Scene:
    gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)
    table: bool = True
    selfcollide: bool = False
    damping: float = 0.002
    held: Sequence[int] = ()
    fixed: Sequence[int] = ()


class MujocoCloth:
    """One sheet of cloth, from positions (n, 3) at rest."""

    def __init__(self, mesh: ClothMesh, material: Material, positions: Array, scene: _Scene) -> None:
        self._model = mujoco.MjModel.from_xml_string(_xml(mesh, material, positions, scene))
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._hands = len(scene.held)

    @property
    def positions(self) -> Array:
        return np.array(self._data.flexvert_xpos)

    def advance(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            mujoco.mj_step(self._model, self._data)

    def fold(self, paths: Mapping[Side, ToolPath], settle: float) -> None:
        """Lead the held vertices along the paths, in their order, let go, and settle."""
        duration = max(float(p.t[-1]) for p in paths.values())
        for k in range(round(duration / STEP)):
            for hand, path in enumerate(paths.values()):
                self._data.mocap_pos[hand] = [np.interp(k * STEP, path.t, path.position[:, c]) for c in range(3)]
            mujoco.mj_step(self._model, self._data)
        self._data.eq_active[:] = 0
        self.advance(settle)


def _xml(mesh: ClothMesh, material: Material, x: Array, scene: _Scene) -> str:
    modulus, rigidity = membrane_modulus(material, REFERENCE_DROP), flexural_rigidity(material)
    plate = float(np.sqrt(12.0 * (1.0 - POISSON**2) * rigidity / modulus))
    contact = f'condim="3" solref="{SOLREF}"'
    table = f'<geom type="plane" size="3 3 .1" friction="{material.friction_static} 0 0" priority="1" {contact}/>'
    hands = "".join(f'<body name="h{k}" mocap="true" pos="{_text(x[v])}"/>' for k, v in enumerate(scene.held))
    holds = "".join(
        f'<connect name="e{k}" body1="c_{v}" body2="h{k}" anchor="0 0 0" solref="0.004 1"/>'
        for k, v in enumerate(scene.held)
    )
    pins = f'<pin id="{" ".join(map(str, scene.fixed))}"/>' if len(scene.fixed) else ""
    return f"""<mujoco>
<option timestep="{STEP}" integrator="discrete" solver="CG" cone="elliptic" impratio="10" iterations="50"
 tolerance="1e-8" gravity="{_text(np.array(scene.gravity))}"/>
<size memory="500M"/>
<worldbody>{table if scene.table else ""}{hands}
<flexcomp name="c" type="direct" dim="2" point="{_text(x.ravel())}" element="{_text(mesh.triangles.ravel())}"
 radius="{0.5 * material.thickness}" mass="{material.areal_mass * float(mesh.area.sum())}">
<elasticity young="{modulus / plate}" poisson="{POISSON}" thickness="{plate}" damping="{scene.damping}"
 elastic2d="both"/>
<contact friction="{material.friction_layers} 0 0" selfcollide="{"auto" if scene.selfcollide else "none"}"
 {contact}/>{pins}</flexcomp></worldbody>
<equality>{holds}</equality></mujoco>"""


def _text(values: Array | NDArray[np.int32]) -> str:
    return " ".join(f"{v:.9g}" for v in values)


def _patch(size: Array, edge: float) -> ClothMesh:
    low, high = size.min(axis=0), size.max(axis=0)
    return grid_mesh(*(np.linspace(a, b, round((b - a) / edge) + 1) for a, b in zip(low, high, strict=True)))


def tilt(figures: Figures, frictions: Sequence[float] = FRICTIONS) -> None:
    mesh = _patch(PATCH, 0.025)
    creep, error = 0.0, 0.0
    for mu in frictions:
        material = replace(MATERIAL, friction_static=mu, friction_dynamic=mu)
        for ratio in (CREEP_RATIO, *SLIDE_RATIOS):
            angle = float(np.arctan(ratio * mu))
            scene = _Scene(gravity=(GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)))
            cloth = MujocoCloth(mesh, material, mesh.lay_flat(material.thickness), scene)
            before = cloth.positions
            cloth.advance(1.0)
            way = (cloth.positions - before)[:, 0]
            if ratio < 1.0:
                creep = max(creep, 1e3 * float(np.abs(way).max()))
            else:
                error = max(error, abs(float(way.mean()) / slide_expected(mu, angle) - 1.0))
    figures["mujoco_tilt_creep_mm_max"], figures["mujoco_tilt_slide_error_rel_max"] = creep, error


def hang(figures: Figures, stretches: Sequence[float] = STRETCHES) -> None:
    width, length = STRIP
    mesh = _patch(np.array([[0.0, 0.0], [width, length]]), 0.025)
    top, bottom = mesh.rest[:, 1] > length - 1e-9, mesh.rest[:, 1] < 1e-9
    x = np.column_stack([mesh.rest[:, 0], np.zeros(len(mesh.rest)), mesh.rest[:, 1]])
    worst = 0.0
    for stretch in stretches:
        scene = _Scene(table=False, damping=0.01, fixed=np.flatnonzero(top).tolist())
        cloth = MujocoCloth(mesh, replace(MATERIAL, stretch_fraction=stretch), x, scene)
        cloth.advance(3.0)
        worst = max(worst, abs(-float(cloth.positions[bottom, 2].mean()) / length - stretch))
    figures["mujoco_hang_error_pp_max"] = 100.0 * worst


def bending(figures: Figures, edge: float = 0.020) -> None:
    """A strip whose overhang is twice its bending length."""
    material = replace(MATERIAL, bending_length=0.08)
    overhang = 2.0 * material.bending_length
    mesh = _patch(np.array([[-2 * edge, 0.0], [overhang, 3 * edge]]), edge)
    x = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    scene = _Scene(table=False, damping=0.05, fixed=np.flatnonzero(mesh.rest[:, 0] < 1e-9).tolist())
    cloth = MujocoCloth(mesh, material, x, scene)
    cloth.advance(6.0)
    tip = cloth.positions[mesh.rest[:, 0] > overhang - 1e-9].mean(axis=0)
    angle = float(np.arctan2(-tip[2], tip[0]))
    figures["mujoco_bending_error_rel"] = peirce(overhang, angle) / material.bending_length - 1.0


def _both(fold: SharedFold) -> tuple[Array, Array, float]:
    """Ends of a fold in our simulation and in MuJoCo's, and MuJoCo's speed (x real time)."""
    ours = predict_fold(fold.mesh, fold.start, fold.material, fold.paths, RELEASE, SETTLE)
    scene = _Scene(selfcollide=True, held=[fold.held[side] for side in fold.paths])
    cloth = MujocoCloth(fold.mesh, fold.material, fold.start, scene)
    start = time.thread_time()
    cloth.fold(fold.paths, RELEASE + SETTLE)
    seconds = max(float(p.t[-1]) for p in fold.paths.values()) + RELEASE + SETTLE
    return ours.vertices, cloth.positions, seconds / (time.thread_time() - start)


def folds(figures: Figures) -> None:
    plain = plain_fold()
    a, b, speed = _both(plain)
    figures["mujoco_towel_x_realtime"] = speed
    figures["mujoco_towel_shape_difference_mm_mean"] = 1e3 * float(np.linalg.norm(a - b, axis=1).mean())
    figures["mujoco_towel_error_mm"], figures["towel_same_fold_error_mm"] = (
        1e3 * plain.error(b),
        1e3 * plain.error(a),
    )
    best = optimised_fold()
    a, b, _ = _both(best)
    ours, theirs = 1e3 * best.error(a), 1e3 * best.error(b)
    figures["optimised_towel_error_mm"], figures["mujoco_optimised_towel_error_mm"] = ours, theirs
    figures["mujoco_optimised_shape_difference_mm_mean"] = 1e3 * float(np.linalg.norm(a - b, axis=1).mean())
    figures["mujoco_final_error_difference_mm"] = theirs - ours


def measure(figures: Figures) -> None:
    tilt(figures)
    hang(figures)
    bending(figures)
    folds(figures)
    figures["mujoco_version"] = mujoco.__version__
