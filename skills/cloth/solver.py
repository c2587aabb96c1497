"""A piece of cloth on a table, advanced in time: the object that the predictor and the simulated cell share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from robots.errors import ConfigurationError, InternalError
from robots.ports import Array
from skills.cloth import kernel
from skills.cloth.contact import PHASE
from skills.cloth.elastic import (
    build_elastic,
    build_rub,
    flexural_rigidity,
    membrane_modulus,
    stretch_excess,
    turns,
)
from skills.cloth.mesh import ClothMesh
from skills.cloth.patches import Patches
from skills.cloth.pinch import PadGeometry, PinchReport, find_pinched
from skills.cloth.topology import topology_of
from skills.cloth.untangle import Tangles, no_tangles
from skills.vocabulary import Material

__all__ = ["CapsuleMotion", "ClothSimulation", "SolverSettings", "ToolMotion"]

HANDS = 2
MAX_HELD = 128
MOST_PAIRS = 120
"""For each vertex, that may touch: folded stacks have some 10. With more the cloth has lost its shape, and the
lists would grow until the memory is full."""


@dataclass(frozen=True)
class SolverSettings:
    """How the cloth is solved, and what of a fabric a lab does not measure.

    frame_rate [1/s] x substeps: steps a second. substeps None: as few as the stretch can be solved with, to within
    stretch_tolerance (of the length, default 0.001: 0.1 percentage points); ConfigurationError when too many would
    be needed. Given substeps are taken, and refused only if a stretch_tolerance is given which they do not meet.
    gravity [m/s2]: tilt it for a tilted table (the table stays z = 0). reference_drop [m]: the hanging length at
    which the material's stretch_fraction was measured (0.6 where the garment's own is not given). stretch_damping,
    bend_damping: Rayleigh times [s], force of damping = time x stiffness x rate (that of bending is less on meshes
    so fine that it would be unstable). drag [1/s] of the air. max_speed [m/s] caps every vertex. sleep_distance,
    sleep_frames: a vertex that stays so near for so long, and does not gather speed, is at rest and costs nothing
    until something moves near it (0 frames: nothing ever sleeps; the distance is at most a twelfth of an edge).
    anisotropy: stiffness along material y over that along x. seam_factor: stretch stiffness of the outline over
    the cloth's. residual_curvature [1/m]: friction in bending, as the curvature that it can keep in cloth that is
    let go: hysteresis HB over rigidity B of the KES-F test, where the loop is 2 HB high (six denims: 23 to 54,
    Journal of Textiles 2016, 4614168); 0 to 1000, and 0 is cloth that forgets how it was bent.
    """

    frame_rate: int = 60
    substeps: int | None = None
    stretch_tolerance: float | None = None
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    reference_drop: float = 0.6
    stretch_damping: float = 0.002
    bend_damping: float = 0.01
    drag: float = 0.05
    max_speed: float = 4.0
    sleep_distance: float = 1e-3
    sleep_frames: int = 10
    anisotropy: float = 1.0
    seam_factor: float = 1.0
    residual_curvature: float = 0.0

    @property
    def frame(self) -> float:
        """[s]"""
        return 1.0 / self.frame_rate


@dataclass(frozen=True, eq=False)
class ToolMotion:
    """One tool over the frames of a call: poses in the table frame at the start and the end.

    hand: 0 or 1. position: (3,) of the tool centre point; rotation: (3, 3) R_table_tool.
    """

    hand: int
    position0: Array
    rotation0: Array
    position1: Array
    rotation1: Array


@dataclass(frozen=True, eq=False)
class CapsuleMotion:
    """Fingers and wrists that push the cloth: ends of k capsules at the start and the end of the call.

    p0_start, p1_start, p0_end, p1_end: (k, 3) [m], table frame; radius: (k,) [m].
    """

    p0_start: Array
    p1_start: Array
    p0_end: Array
    p1_end: Array
    radius: Array


RELEASE_SPEED = 0.1  # [m/s]
SLEEP_SHARE = 1.0 / 12.0
"""Of the mean edge: so far a vertex at rest may have moved, however fine the mesh."""
IN_PLANE = 0.2
"""Quadratic hinges resist gradients of strain in the plane too, and damping multiplies that. Beyond some 0.4 of
the stiffness of the edges, sweeps over the two in turn drive each other (measured on edges of 4 to 15 mm)."""
STRETCH_TOLERANCE = 1e-3  # of the length
ESTIMATE_SHARE = 0.3  # of the tolerance: what the estimate of the error may take of it
MOST_RESIDUAL = 1000.0  # [1/m]
LEAST_SUBSTEPS, MOST_SUBSTEPS = 16, 64  # of a frame; contacts need the least


class ClothSimulation:
    """One garment. Raises ConfigurationError for an absurd material, InternalError when positions are lost.

    positions: (n, 3) to start from, without speed (default: laid flat); at_rest: they are known to be an
    equilibrium, so that all of it is asleep until something moves, and friction in bending, if there is any, does
    not pull there; else the cloth was flat before it came there. fixed: (n,) vertices that never move (a hung
    cloth's upper hem). substeps: a frame's, as given or chosen; stretch_error: by how much the cloth would hang
    longer than its material says, as a fraction of its length (an estimate). Not safe to be used by two threads
    at once; two simulations in two threads are.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        material: Material,
        positions: Array | None = None,
        settings: SolverSettings | None = None,
        table: bool = True,
        pads: PadGeometry | None = None,
        fixed: NDArray[np.bool_] | None = None,
        at_rest: bool = False,
    ) -> None:
        self.mesh = mesh
        self.material = material
        self.settings = settings or SolverSettings()
        self.pads = pads or PadGeometry()
        self.time = 0.0
        _check(material, self.settings, mesh)
        self.substeps, self.stretch_error = _choose_substeps(mesh, material, self.settings)
        self._body = _body(mesh, material, self.settings, self.substeps)
        if fixed is not None:
            self._body.w[fixed] = 0.0
        self._rules = _rules(mesh, material, self.settings, self.substeps, self.pads, table)
        n = len(mesh.rest)
        rubbing = len(self._body.rub.most)
        self._state = _new_state(n, len(mesh.edges), len(mesh.hinges), rubbing, self._body.patches)
        self._pairs = _new_pairs(16 * n, 12 * n)
        self._holds = _new_holds()
        self._tangles = no_tangles(n)
        self._tool_p = np.zeros((HANDS, 3))
        self._tool_r = np.tile(np.diag([1.0, -1.0, -1.0]), (HANDS, 1, 1))
        self.set_positions(mesh.lay_flat(material.thickness) if positions is None else positions)
        if at_rest:
            self._sleep()

    @property
    def positions(self) -> Array:
        """(n, 3) [m], table frame (a copy)."""
        return self._state.x.copy()

    @property
    def velocities(self) -> Array:
        """(n, 3) [m/s] (a copy)."""
        return self._state.v.copy()

    @property
    def asleep(self) -> NDArray[np.bool_]:
        """(n,) which vertices are at rest."""
        return ~self._state.awake

    @property
    def inverse_mass(self) -> Array:
        """(n,) [1/kg]"""
        return self._body.w.copy()

    @property
    def table_force(self) -> Array:
        """(3,) [N] force of the cloth on the table in the last substep, table frame."""
        press = self._state.press / np.where(self._body.w > 0.0, self._body.w, np.inf)[:, None]
        return -press.sum(axis=0) / self._rules.h**2

    def set_positions(self, positions: Array, velocities: Array | None = None) -> None:
        """Put the cloth somewhere (n, 3), at rest or with `velocities` (n, 3); what was held is released.

        Friction in bending remembers: it takes the cloth to have been bent from how it was to how it is put. One
        that is only turned or shifted feels nothing of it.
        """
        x = np.asarray(positions, dtype=float)
        if x.shape != self._state.x.shape or not np.isfinite(x).all():
            raise InternalError("positions must be finite and (n, 3)", shape=tuple(x.shape), n=len(self._state.x))
        s = self._state
        s.x[:], s.xp[:], s.ref[:], s.last[:] = x, x, x, x
        s.v[:] = 0.0 if velocities is None else velocities
        s.quiet[:], s.awake[:], s.expired[:], s.wa[:] = 0, self._body.w > 0.0, True, self._body.w
        s.turned[:], s.moving[:] = False, False
        s.u[:] = x
        s.press[:], s.still[:] = 0.0, False
        s.counts[:] = 0
        free = np.flatnonzero(s.awake)
        s.awake_list[: len(free)] = free
        s.counts[kernel.AWAKE] = len(free)
        for part in self._tangles:
            part[...] = 0
        self._holds.hand[:] = -1
        self._holds.points[:] = 0
        self._holds.force[:] = 0.0

    def _sleep(self) -> None:
        s = self._state
        s.awake[:], s.expired[:], s.wa[:] = False, False, 0.0
        s.quiet[:] = self._rules.sleep_frames
        s.base[:], s.course[:] = s.x[self._body.patches.corner].T, 0.0
        s.slack[:] = min(kernel.SLACK, kernel.CALM_SLACK * self.material.thickness)
        s.counts[kernel.AWAKE] = 0
        if len(s.slip):
            s.slip[:], s.held[:] = turns(self._body.hinge, s.x), 0.0

    def grip(self, hand: int, position: Array, rotation: Array, force: float = 20.0) -> PinchReport:
        """Close the pads of `hand` (0 or 1) at a pose in the table frame, squeezing with `force` [N].

        What is between them is held from now on and follows the tool that `advance` is given.
        """
        self.release(hand)
        p, r = np.asarray(position, dtype=float), np.asarray(rotation, dtype=float)
        found = find_pinched(self.mesh, self._state.x, p, r, self.pads, self.material.thickness)
        h = self._holds
        free = np.flatnonzero(h.hand < 0)[: len(found.vertex)]
        m = len(free)
        h.vertex[free], h.bary[free], h.offset[free] = found.vertex[:m], found.bary[:m], found.offset[:m]
        h.height[free] = found.height[:m]
        h.hand[free] = hand
        h.points[hand] = m
        h.age[hand] = 0.0
        h.force[hand] = 0.0
        h.limit[hand] = 2.0 * self.pads.friction * force
        self._tool_p[hand], self._tool_r[hand] = p, r
        return found.report

    def release(self, hand: int) -> None:
        """Open the pads of `hand`. What they held leaves at no more than RELEASE_SPEED.

        Between pads that pull against contacts, nodal velocities stand high while nothing moves: let go with
        them, a corner would be flung away.
        """
        held = np.unique(self._holds.vertex[self._holds.hand == hand])
        speed = np.linalg.norm(self._state.v[held], axis=1, keepdims=True)
        self._state.v[held] *= np.minimum(1.0, RELEASE_SPEED / np.maximum(speed, RELEASE_SPEED))
        self._holds.hand[self._holds.hand == hand] = -1
        self._holds.points[hand] = 0
        self._holds.force[hand] = 0.0

    def set_grip_force(self, hand: int, force: float) -> None:
        """Squeeze with another force [N]; the pinch lets go beyond 2 * pad friction * force."""
        self._holds.limit[hand] = 2.0 * self.pads.friction * force

    def held(self, hand: int) -> bool:
        """Whether `hand` still has cloth between its pads."""
        return bool((self._holds.hand == hand).any())

    def pinch_force(self, hand: int) -> Array:
        """(3,) [N] mean force of the cloth on the hand over the last frame, table frame."""
        return self._holds.force[hand].copy()

    def advance(
        self, frames: int = 1, tools: Sequence[ToolMotion] = (), capsules: CapsuleMotion | None = None
    ) -> None:
        """Go on by `frames`; tools and capsules move evenly from start to end over all of them."""
        p = np.repeat(self._tool_p[None], frames + 1, axis=0)
        r = np.repeat(self._tool_r[None], frames + 1, axis=0)
        at = np.linspace(0.0, 1.0, frames + 1)
        for tool in tools:
            p[:, tool.hand] = tool.position0 + at[:, None] * (np.asarray(tool.position1) - tool.position0)
            r[:, tool.hand] = _turn(tool.rotation0, tool.rotation1, at)
        self.advance_along(p, r, _capsule_path(capsules, at))

    def advance_along(
        self, position: Array, rotation: Array, capsules: tuple[Array, Array, Array] | None = None
    ) -> None:
        """Go on along sampled motions, one sample a frame bound: position (frames + 1, 2, 3) and rotation
        (frames + 1, 2, 3, 3) of both hands; capsules: ends (frames + 1, k, 3) twice and radius (k,)."""
        frames = len(position) - 1
        p0, p1, radius = capsules if capsules is not None else _capsule_path(None, np.zeros(frames + 1))
        p, r = np.ascontiguousarray(position, dtype=float), np.ascontiguousarray(rotation, dtype=float)
        lost = False
        motion = p, r, p0, p1, radius, frames
        try:
            while (
                kernel.run_frames(
                    self._body, self._rules, self._state, self._pairs, self._holds, self._tangles, *motion
                )
                == kernel.PAIRS_FULL
            ):
                if len(self._pairs.vt) > MOST_PAIRS * len(self.mesh.rest):
                    lost = True
                    break
                self._grow_pairs()
        except ZeroDivisionError:  # edges or relative speeds that are no longer numbers
            lost = True
        self._tool_p[:], self._tool_r[:] = p[-1], r[-1]
        self.time += frames * self.settings.frame
        if lost or not np.isfinite(self._state.x).all():
            raise InternalError(
                "the cloth simulation lost its positions: its cloth is too stiff for so fine a mesh and so few "
                "substeps, or a tool moved too far in a frame",
                time_s=self.time,
                substeps=self.substeps,
                shortest_edge=float(self.mesh.edge_length.min()),
                bending_length=self.material.bending_length,
                fastest_m_s=float(np.abs(np.nan_to_num(self._state.v, posinf=0.0, neginf=0.0)).max()),
            )

    def checkpoint(self) -> dict[str, Array]:
        """Everything that decides what comes next, as named arrays; `restore` takes it back bit for bit."""
        out = {f"state.{k}": v.copy() for k, v in self._state._asdict().items()}
        out |= {f"pairs.{k}": v.copy() for k, v in self._pairs._asdict().items()}
        out |= {f"holds.{k}": v.copy() for k, v in self._holds._asdict().items()}
        out |= {f"tangles.{k}": v.copy() for k, v in self._tangles._asdict().items()}
        out |= {"tool_p": self._tool_p.copy(), "tool_r": self._tool_r.copy(), "time": np.array(self.time)}
        return out

    def restore(self, saved: Mapping[str, Array]) -> None:
        """Back to a checkpoint of a simulation with the same mesh, material and settings."""
        if saved["state.x"].shape != self._state.x.shape:
            raise InternalError("a checkpoint of another mesh", shape=tuple(saved["state.x"].shape))
        if saved["state.slip"].shape != self._state.slip.shape:
            raise InternalError("a checkpoint of cloth with other friction in bending")

        def part(name: str) -> dict[str, Any]:
            return {k.split(".")[1]: v.copy() for k, v in saved.items() if k.startswith(name + ".")}

        self._state = kernel.State(**part("state"))
        self._pairs = kernel.Pairs(**part("pairs"))
        self._holds = kernel.Holds(**part("holds"))
        self._tangles = Tangles(**part("tangles"))
        self._tool_p, self._tool_r = saved["tool_p"].copy(), saved["tool_r"].copy()
        self._state.counts[kernel.FITTED] = 0  # the patches are not part of it
        self.time = float(saved["time"])

    def _grow_pairs(self) -> None:
        old = self._pairs
        new = _new_pairs(2 * len(old.vt), 2 * len(old.ee))
        for name, a in old._asdict().items():
            getattr(new, name)[tuple(slice(0, k) for k in a.shape)] = a
        self._pairs = new


def _check(material: Material, settings: SolverSettings, mesh: ClothMesh) -> None:
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
        value = getattr(material, name)
        if not low <= value <= high:
            raise ConfigurationError(f"material {name} = {value} is out of range", f"{low} to {high}", value=value)
    if not 0.0 <= settings.residual_curvature <= MOST_RESIDUAL:
        raise ConfigurationError(
            f"residual_curvature = {settings.residual_curvature} is out of range",
            f"0 to {MOST_RESIDUAL:g}",
            value=settings.residual_curvature,
        )
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


def _choose_substeps(mesh: ClothMesh, material: Material, settings: SolverSettings) -> tuple[int, float]:
    """Substeps of a frame and the error that they leave in the stretch (see SolverSettings)."""

    def error(n: int) -> float:
        step = settings.frame / n
        return stretch_excess(
            mesh, material, step, settings.reference_drop, settings.anisotropy, settings.seam_factor
        )

    tolerance = settings.stretch_tolerance if settings.stretch_tolerance is not None else STRETCH_TOLERANCE
    if not tolerance > 0.0:
        raise ConfigurationError("stretch_tolerance must be positive", "", stretch_tolerance=tolerance)
    n = settings.substeps
    if n is not None and (settings.stretch_tolerance is None or error(n) <= ESTIMATE_SHARE * tolerance):
        return n, error(n)
    needed = LEAST_SUBSTEPS
    while error(needed) > ESTIMATE_SHARE * tolerance and needed < 1000:
        needed += PHASE
    if n is None and needed <= MOST_SUBSTEPS:
        return needed, error(needed)
    raise ConfigurationError(
        f"{n or MOST_SUBSTEPS} substeps a frame cannot hold the stretch to the tolerance that was asked for",
        f"{needed} substeps, a longer edge, a greater stretch_tolerance or a softer cloth",
        stretch_fraction=material.stretch_fraction,
        stretch_tolerance=tolerance,
        stretch_error=error(n or MOST_SUBSTEPS),
        needed_substeps=needed,
        edge_length=float(np.median(mesh.edge_length)),
    )


def _body(mesh: ClothMesh, material: Material, settings: SolverSettings, substeps: int) -> kernel.Body:
    h = settings.frame / substeps
    w = 1.0 / (material.areal_mass * mesh.vertex_area)
    e = build_elastic(mesh, material, w, h, settings.reference_drop, settings.anisotropy, settings.seam_factor)
    rate = np.minimum(0.4, settings.stretch_damping * e.stiffness * PHASE * h * w[e.edge].sum(axis=1))
    topology = topology_of(mesh)
    return kernel.Body(
        w,
        e.edge,
        topology.edge_tri,
        e.rim,
        e.length,
        e.compliance,
        rate,
        e.hinge,
        e.weight,
        e.bend,
        build_rub(mesh, material, h, settings.residual_curvature),
        mesh.triangles.copy(),
        topology.tri_edge,
        topology.ring_start,
        topology.ring,
        topology.ring_edge,
        topology.patches,
    )


def _rules(
    mesh: ClothMesh, material: Material, settings: SolverSettings, substeps: int, pads: PadGeometry, table: bool
) -> kernel.Rules:
    h = settings.frame / substeps
    edge = float(mesh.edge_length.mean())
    softer = min(settings.anisotropy, 1.0 / settings.anisotropy) ** 0.5  # along one of the two directions
    modulus = softer * membrane_modulus(material, settings.reference_drop)
    most = max(0.0, IN_PLANE * modulus * edge**2 / flexural_rigidity(material) - 1.0)
    gx, gy, gz = settings.gravity
    return kernel.Rules(
        h=h,
        substeps=substeps,
        gx=gx,
        gy=gy,
        gz=gz,
        thickness=material.thickness,
        mu_static=material.friction_static,
        mu_dynamic=material.friction_dynamic,
        mu_layers=material.friction_layers,
        max_speed=settings.max_speed,
        drag=settings.drag,
        bend_gamma=min(settings.bend_damping / h, most),
        sleep_distance=min(settings.sleep_distance, SLEEP_SHARE * edge),
        sleep_frames=settings.sleep_frames if settings.sleep_frames > 0 else 2**30,
        table=table,
        hold_compliance=pads.compliance,
    )


def _new_state(n: int, edges: int, hinges: int, rubbing: int, patches: Patches) -> kernel.State:
    m, corners = len(patches.tri), len(patches.corner)

    def f(*shape: int) -> Array:
        return np.zeros(shape)

    return kernel.State(
        x=f(n, 3),
        xp=f(n, 3),
        v=f(n, 3),
        u=f(n, 3),
        ref=f(n, 3),
        last=f(n, 3),
        base=np.zeros((3, corners), np.float32),
        course=np.zeros((3, corners), np.float32),
        slack=np.zeros(m, np.float32),
        born=np.zeros(m, np.int32),
        moving=np.zeros(m, np.bool_),
        expired=np.ones(m, np.bool_),
        watched=np.zeros(m, np.int32),
        turned=np.zeros(n, np.bool_),
        wa=f(n),
        press=f(n, 3),
        quiet=np.zeros(n, np.int32),
        still=np.zeros(n, np.bool_),
        awake=np.ones(n, np.bool_),
        stirred=np.zeros(n, np.bool_),
        last_row=np.full(n, -1, np.int32),
        near=np.zeros(n, np.bool_),
        awake_list=np.zeros(n, np.int32),
        counts=np.zeros(16, np.int64),
        edge=np.zeros((edges, 2), np.int32),
        length=f(edges),
        wi=f(edges),
        wj=f(edges),
        rate=f(edges),
        hinge=np.zeros((hinges, 4), np.int32),
        weight=f(hinges, 4),
        inverse=f(hinges),
        which=np.zeros(rubbing, np.int32),
        slip=f(rubbing),
        held=f(rubbing + 1),
        axis=f(rubbing, 6),
        foot=f(rubbing, 2),
        turn=f(rubbing),
        rub_inverse=f(rubbing),
        moment=f(rubbing),
    )


def _new_pairs(vt: int, ee: int) -> kernel.Pairs:
    m, table = vt + ee, 1 << (2 * (vt + ee)).bit_length()
    return kernel.Pairs(
        np.zeros((vt, 2), np.int32),
        np.zeros(vt, np.int8),
        np.zeros(vt, np.int32),
        np.zeros((vt, 3)),
        np.zeros((ee, 2), np.int32),
        np.zeros(ee, np.bool_),
        np.zeros((ee, 3)),
        np.zeros(ee, np.int32),
        np.zeros((ee, 3)),
        np.zeros((vt, 2), np.int32),
        np.zeros((ee, 2), np.int32),
        np.zeros(table, np.int64),
        np.zeros(table, np.int32),
        np.zeros((m, 6)),
        np.zeros((m, 4), np.int32),
        np.zeros((m, 4)),
        np.zeros((m, 3)),
        np.zeros(m),
        np.zeros(m),
        np.zeros((m, 3)),
        np.zeros((m, 3)),
        np.zeros(m, np.int32),
        np.zeros((m, 4)),
        np.zeros(m, np.int32),
        np.zeros(m, np.int32),
        np.zeros(m),
    )


def _new_holds() -> kernel.Holds:
    return kernel.Holds(
        np.zeros((MAX_HELD, 3), np.int32),
        np.zeros((MAX_HELD, 3)),
        np.zeros((MAX_HELD, 3)),
        np.zeros(MAX_HELD),
        np.full(MAX_HELD, -1, np.int32),
        np.zeros(HANDS),
        np.zeros((HANDS, 3)),
        np.zeros((HANDS, 3)),
        np.zeros(HANDS),
        np.zeros(HANDS, np.int64),
    )


def _turn(rotation0: Array, rotation1: Array, at: Array) -> Array:
    """(len(at), 3, 3): evenly from one rotation to the other."""
    if np.array_equal(rotation0, rotation1):
        return np.repeat(np.asarray(rotation0, dtype=float)[None], len(at), axis=0)
    return Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([rotation0, rotation1])))(at).as_matrix()


def _capsule_path(capsules: CapsuleMotion | None, at: Array) -> tuple[Array, Array, Array]:
    if capsules is None:
        none = np.zeros((len(at), 0, 3))
        return none, none, np.zeros(0)
    s = at[:, None, None]
    return (
        np.ascontiguousarray((1.0 - s) * capsules.p0_start + s * capsules.p0_end),
        np.ascontiguousarray((1.0 - s) * capsules.p1_start + s * capsules.p1_end),
        np.asarray(capsules.radius, dtype=float).copy(),
    )
