"""Simulation of a piece of cloth on a table, used by the predictor and by the simulated cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.errors import ConfigurationError, InternalError
from foldcell.robots.ports import Array
from foldcell.skills.cloth import kernel
from foldcell.skills.cloth.broad_phase.pairs import CALM_SLACK, SLACK
from foldcell.skills.cloth.contact.contacts import phase_length
from foldcell.skills.cloth.contact.ridges import flat_cosine
from foldcell.skills.cloth.crease_set import advance_set, build_crease_law
from foldcell.skills.cloth.elasticity import (
    SHARPEST,
    bend_stiffening,
    build_bending_friction,
    build_elastic,
    flexural_rigidity,
    hinge_extents,
    membrane_modulus,
    turns,
)
from foldcell.skills.cloth.intersections.resolve import Intersections, no_intersections
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry, Patch, PinchReport, find_pinched
from foldcell.skills.cloth.settings import SolverSettings, check_cloth, choose_substeps
from foldcell.skills.cloth.simd.aligned_arrays import aligned
from foldcell.skills.cloth.state import (
    ACTIVE,
    AWAKE,
    EE,
    FITTED,
    HANDS,
    PACE,
    PACKED,
    SEARCHED,
    VT,
    Body,
    Holds,
    SolverParameters,
    State,
    new_holds,
    new_pairs,
    new_state,
)
from foldcell.skills.cloth.topology import topology_of
from foldcell.skills.vocabulary import Material

Capsules = tuple[Array, Array, Array]
"""Capsules in motion: both ends, (frames + 1, k, 3) each, and radius (k,) [m]."""

MOST_PAIRS = 120
"""Largest number of candidate pairs per vertex; folded stacks have about 10. Cloth with more pairs than this has
lost its shape, and the lists would grow until the memory is full."""

HASTY = 1.0
"""If a hand that holds cloth, or the cloth itself, is faster than this, the positions may get lost [m/s]: in a
substep, cloth then turns and moves by a part of an edge. Folds are slower."""
UNSOUND = 2.0
"""The positions count as lost if a vertex is faster than this multiple of the largest speed of free vertices
(`max_speed`). Contacts, pads and edges add less than this."""
FINER = 2, 4
"""Frames in which the positions were lost are repeated with more substeps. These factors of their number are tried
in turn."""


RELEASE_SPEED = 0.1  # [m/s] largest speed of held points when the pads open
SLEEP_SHARE = 1.0 / 12.0
"""Upper bound of the sleep distance, as a share of the edge length of the finest part of the mesh."""
FINE_SHARE = 0.1
"""Quantile of the edge lengths that is taken as the edge length of the finest part of the mesh."""
DAMPED = 4.0
"""Factor by which damping may multiply the bending stiffness before bent hinges may stiffen: where both would be
unstable, as on meshes much finer than the bends, damping comes first."""
IN_PLANE = 0.2
"""Largest bending stiffness with its damping, as a share of the stiffness of the edges. Hinges also resist
in-plane gradients of strain. Damping multiplies this resistance, and so does the stiffening of bent hinges. If
this share exceeds about 0.4, the alternating sweeps over edges and hinges amplify each other (measured on edges
of 4 to 15 mm)."""


class ClothSimulation:
    """Simulation of one garment. Raises ConfigurationError for a material that cannot be simulated, InternalError
    when the simulation has become unstable.

    positions: (n, 3) initial positions, without velocity (default: laid flat). at_rest: the positions are an
    equilibrium. All of the cloth then sleeps until something moves, and bending friction, if any, holds the
    present bends. Without at_rest, bending friction assumes that the cloth was flat before. fixed: (n,) True for
    vertices that never move (the upper hem of hung cloth). substeps: number of substeps per frame, given or
    chosen. Two threads must not use the same simulation at the same time; they may use two simulations.
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
        check_cloth(material, self.settings, mesh)
        self.substeps = choose_substeps(mesh, material, self.settings)
        self._solver_parameters = _solver_parameters(
            mesh, material, self.settings, self.substeps, self.pads, table
        )
        self._body = _body(mesh, material, self.settings, self._solver_parameters, fixed)
        n = len(mesh.rest)
        friction_hinges, set_hinges = len(self._body.bending_friction.limit), len(self._body.crease_law.length)
        self._state = new_state(
            n, len(mesh.edges), len(self._body.batch_start), len(mesh.hinges), friction_hinges,
            self._body.clusters, set_hinges,
        )  # fmt: skip
        self._pairs = new_pairs(16 * n, 12 * n)
        self._holds = new_holds()
        self._intersections = no_intersections(n)
        self._finer: dict[tuple[int, PadGeometry], ClothSimulation] = {}
        self._tool_p = np.zeros((HANDS, 3))
        self._tool_r = np.tile(np.diag([1.0, -1.0, -1.0]), (HANDS, 1, 1))
        self.set_positions(mesh.lay_flat(material.thickness) if positions is None else positions)
        if at_rest:
            self._sleep()

    @property
    def positions(self) -> Array:
        """(n, 3) present positions [m], table frame (a copy)."""
        return self._state.x[:, :3].copy()

    @property
    def velocities(self) -> Array:
        """(n, 3) present velocities [m/s], table frame (a copy)."""
        return self._state.v[:, :3].copy()

    @property
    def asleep(self) -> NDArray[np.bool_]:
        """(n,) True for vertices at rest."""
        return ~self._state.awake

    def press(self, pressure: Array | float) -> None:
        """Let bodies press on the cloth with `pressure` [Pa], (n,) or equal for all vertices, until the next call.
        Creases take a set meanwhile (`SolverSettings.crease_set`). The pressure itself moves no cloth; capsules
        do."""
        if len(self._state.pressure):
            self._state.pressure[:] = pressure

    def dwell(self, seconds: float) -> None:
        """Let creases take set for `seconds` while nothing moves; `time` advances. This is exact if the cloth is
        held in its present shape for that time, as under a weight."""
        s = self._state
        if len(s.set_rest):
            advance_set(
                self._body.crease_law, self._body.hinge, s.x, s.pressure, float(seconds), s.side, s.set_parts,
                s.set_rest,
            )  # fmt: skip
        self.time += seconds

    def set_positions(self, positions: Array, velocities: Array | None = None) -> None:
        """Put the cloth at positions (n, 3), at rest or with `velocities` (n, 3), and release held points.

        Bending friction, if any, treats the change of shape as bending. A pure rotation or translation is no
        bending.
        """
        x = np.asarray(positions, dtype=float)
        if x.shape != self._state.ref.shape or not np.isfinite(x).all():
            raise InternalError("positions must be finite and (n, 3)", shape=tuple(x.shape), n=len(self._state.x))
        s = self._state
        for place in (s.x, s.xp, s.u, s.ref, s.last):
            place[:, :3] = x
        s.v[:, :3] = 0.0 if velocities is None else velocities
        s.quiet[:], s.kept[:] = 0, 0
        s.awake[:], s.expired[:], s.wa[:] = self._body.w > 0.0, True, self._body.w
        s.turned[:], s.moving[:] = False, False
        s.press[:], s.still[:] = 0.0, False
        s.counts[:] = 0
        free = np.flatnonzero(s.awake)
        s.awake_list[: len(free)] = free
        s.counts[AWAKE], s.counts[PACE] = len(free), self._solver_parameters.phase
        for part in self._intersections:
            part[...] = 0
        self._holds.hand[:] = -1
        self._holds.points[:] = 0
        self._holds.force[:] = 0.0

    def _sleep(self) -> None:
        s = self._state
        s.awake[:], s.expired[:], s.wa[:] = False, False, 0.0
        s.quiet[:] = self._solver_parameters.sleep_frames
        s.base[:], s.course[:] = s.x[self._body.clusters.corner, :3].T, 0.0
        s.ridge_searched[:] = -1  # as if every edge had been searched as a ridge
        s.slack[:] = min(SLACK, CALM_SLACK * self.material.thickness)
        s.counts[AWAKE] = 0
        if len(s.slip):
            s.slip[:], s.held[:] = turns(self._body.hinge, s.x[:, :3]), 0.0

    def grip(
        self, hand: int, position: Array, rotation: Array, force: float = 20.0, patch: Patch | None = None
    ) -> PinchReport:
        """Close the pads of `hand` (0 or 1) at a pose in the table frame, squeezing with `force` [N]. patch: the
        only cloth that they take; None: any.

        From now on, the pads hold the cloth between them, which follows the tool motions given to `advance`.
        """
        self.release(hand)
        p, r = np.asarray(position, dtype=float), np.asarray(rotation, dtype=float)
        found = find_pinched(self.mesh, self._state.x[:, :3], p, r, self.pads, self.material.thickness, patch)
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
        """Open the pads of `hand`. The held points leave at no more than RELEASE_SPEED.

        While pads pull against contacts, the velocities of the held vertices are high although nothing moves. If
        the vertices kept these velocities on release, a corner would be flung away.
        """
        held = np.unique(self._holds.vertex[self._holds.hand == hand])
        speed = np.linalg.norm(self._state.v[held], axis=1, keepdims=True)
        self._state.v[held] *= np.minimum(1.0, RELEASE_SPEED / np.maximum(speed, RELEASE_SPEED))
        self._holds.hand[self._holds.hand == hand] = -1
        self._holds.points[hand] = 0
        self._holds.force[hand] = 0.0

    def set_grip_force(self, hand: int, force: float) -> None:
        """Change the grip force [N]; the pinch slips beyond 2 * pad friction * force."""
        self._holds.limit[hand] = 2.0 * self.pads.friction * force

    def held(self, hand: int) -> bool:
        """Return whether `hand` still has cloth between its pads."""
        return bool((self._holds.hand == hand).any())

    def pinch_force(self, hand: int) -> Array:
        """Return (3,): mean force of the cloth on the hand over the last frame [N], table frame."""
        return self._holds.force[hand].copy()

    def advance(self, frames: int = 1, capsules: Capsules | None = None) -> None:
        """Advance by `frames` while the tools rest. capsules: see `advance_along`."""
        p, r = (np.repeat(pose[None], frames + 1, axis=0) for pose in (self._tool_p, self._tool_r))
        self.advance_along(p, r, capsules)

    def advance_along(self, position: Array, rotation: Array, capsules: Capsules | None = None) -> None:
        """Advance along sampled motions, one sample at each frame boundary: position (frames + 1, 2, 3) and
        rotation (frames + 1, 2, 3, 3) R_table_tool of both hands. capsules: fingers and wrists that push the
        cloth, as both ends, (frames + 1, k, 3) each, and radius (k,). Lengths in metres, table frame."""
        none = np.zeros((len(position), 0, 3))
        path = (none, none, np.zeros(0)) if capsules is None else capsules
        p, r = np.ascontiguousarray(position, dtype=float), np.ascontiguousarray(rotation, dtype=float)
        before = self.checkpoint() if self._hasty(p) else None
        kept = self._advanced(p, r, path)
        if before is not None and not (kept and self._sound()):
            for times in FINER:
                finer = self._with_substeps(times * self.substeps, before)
                if finer._advanced(p, r, path) and finer._sound():
                    self._continue_from(finer.checkpoint())
                    return
        if kept:
            return
        raise InternalError(
            "the cloth simulation lost its positions: its cloth is too stiff for so fine a mesh and so few "
            "substeps, or a tool moved too far in a frame",
            time_s=self.time,
            substeps=self.substeps,
            shortest_edge=float(self.mesh.edge_length.min()),
            bending_length=self.material.bending_length,
            fastest_m_s=float(np.abs(np.nan_to_num(self._state.v, posinf=0.0, neginf=0.0)).max()),
        )

    def _advanced(self, p: Array, r: Array, capsules: Capsules) -> bool:
        """Advance along the motions of `advance_along`. Returns False if the positions are lost."""
        frames, lost = len(p) - 1, False
        motion = p, r, *capsules, frames
        try:
            while (
                kernel.run_frames(
                    self._body,
                    self._solver_parameters,
                    self._state,
                    self._pairs,
                    self._holds,
                    self._intersections,
                    *motion,
                )
                == kernel.PAIRS_FULL
            ):
                if len(self._pairs.vt) > MOST_PAIRS * len(self.mesh.rest):
                    lost = True
                    break
                self._grow_pairs()
        except ZeroDivisionError:  # edge lengths or relative speeds are NaN
            lost = True
        self._tool_p[:], self._tool_r[:] = p[-1], r[-1]
        self.time += frames * self.settings.frame
        return not lost and bool(np.isfinite(self._state.x).all())

    def _hasty(self, p: Array) -> bool:
        """Whether a hand that holds cloth, or the cloth itself, is so fast that the positions may get lost. p:
        (frames + 1, 2, 3) positions of the hands [m]."""
        holding = self._holds.points > 0
        way = np.linalg.norm(np.diff(p, axis=0), axis=2)[:, holding]
        fast = HASTY * self.settings.frame
        return bool((way > fast).any() or np.abs(self._state.v[:, :3]).max() > HASTY)

    def _sound(self) -> bool:
        """Whether no vertex is faster than it can have become."""
        return float(np.abs(self._state.v[:, :3]).max()) < UNSOUND * self.settings.max_speed

    def _with_substeps(self, substeps: int, state: Mapping[str, Array]) -> ClothSimulation:
        """Return a simulation of the same cloth with other substeps, in the given state."""
        other = self._finer.get((substeps, self.pads))
        if other is None:
            settings = replace(self.settings, substeps=substeps)
            other = self._finer[substeps, self.pads] = ClothSimulation(
                self.mesh, self.material, settings=settings, table=bool(self._solver_parameters.table),
                pads=self.pads, fixed=self._body.w == 0.0,
            )  # fmt: skip
        other._continue_from(state)
        return other

    def _continue_from(self, saved: Mapping[str, Array]) -> None:
        """Continue from a checkpoint with other substeps: all contacts are examined anew and the packed lists are
        filled anew, because waiting times, impulses and compliances depend on the length of a substep."""
        self.restore(saved)
        self._state.counts[PACKED] = self._state.counts[SEARCHED] = 0
        for remembered in (self._pairs.vt_due, self._pairs.ee_due, self._pairs.vt_j, self._pairs.ee_j):
            remembered[...] = 0

    def checkpoint(self) -> dict[str, Array]:
        """Return the complete state as named arrays; `restore` continues from it bit for bit."""
        out = {f"state.{k}": v.copy() for k, v in self._state._asdict().items()}
        out |= {f"pairs.{k}": v.copy() for k, v in _remembered(self._pairs, self._state.counts).items()}
        out |= {f"holds.{k}": v.copy() for k, v in self._holds._asdict().items()}
        out |= {f"intersections.{k}": v.copy() for k, v in self._intersections._asdict().items()}
        out |= {"tool_p": self._tool_p.copy(), "tool_r": self._tool_r.copy(), "time": np.array(self.time)}
        out["kernel"] = np.array(kernel.SOURCES)
        return out

    def restore(self, saved: Mapping[str, Array]) -> None:
        """Return to a checkpoint of a simulation with the same mesh, material and settings. Raises
        ConfigurationError for a checkpoint from another version of the compiled loop, whose arrays may have
        another meaning."""
        if "kernel" not in saved or str(saved["kernel"]) != kernel.SOURCES:
            raise ConfigurationError(
                "the state of the cloth was written by another foldcell",
                "go on with the version that began the run, or start a new one",
            )
        for name, a in self._state._asdict().items():
            if saved[f"state.{name}"].shape != a.shape:
                raise InternalError(
                    "a checkpoint of another mesh, or of cloth with other friction in bending",
                    array=name, shape=tuple(saved[f"state.{name}"].shape), here=tuple(a.shape),
                )  # fmt: skip

        def part(name: str) -> dict[str, Any]:
            return {k.split(".")[1]: aligned(v) for k, v in saved.items() if k.startswith(name + ".")}

        self._state = State(**part("state"))
        counts = self._state.counts
        while counts[VT] > len(self._pairs.vt) or counts[EE] > len(self._pairs.ee):
            self._grow_pairs()
        for name, rows in _remembered(self._pairs, counts).items():
            rows[...] = saved[f"pairs.{name}"][: len(rows)]
        self._holds = Holds(**part("holds"))
        self._intersections = Intersections(**part("intersections"))
        self._tool_p, self._tool_r = saved["tool_p"].copy(), saved["tool_r"].copy()
        counts[FITTED] = 0  # the clusters are not part of the checkpoint
        self.time = float(saved["time"])

    def _grow_pairs(self) -> None:
        old = self._pairs
        new = new_pairs(2 * len(old.vt), 2 * len(old.ee))
        for name, a in old._asdict().items():
            getattr(new, name)[tuple(slice(0, k) for k in a.shape)] = a
        self._pairs = new


def _remembered(pairs: Any, counts: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Return views of what the loop remembers from one call to the next: the pairs, and the vertices of the latest
    contacts, which keep their neighbours awake. The loop fills all other lists anew, because each call begins with
    a narrow phase."""
    lengths = {
        VT: ("vt", "side", "vt_due", "vt_j"),
        EE: ("ee", "near", "normal", "ee_due", "ee_j"),
        ACTIVE: ("contact_vertices",),
    }
    return {name: getattr(pairs, name)[: counts[k]] for k, names in lengths.items() for name in names}


def _body(
    mesh: ClothMesh,
    material: Material,
    settings: SolverSettings,
    parameters: SolverParameters,
    fixed: NDArray[np.bool_] | None,
) -> Body:
    h, w = parameters.h, 1.0 / (material.areal_mass * mesh.vertex_area)
    if fixed is not None:
        w[fixed] = 0.0  # must precede build_elastic, whose sweep compliance depends on w
    e = build_elastic(mesh, material, w, h, settings.anisotropy, settings.bending_ratio)
    rate = np.minimum(0.4, settings.stretch_damping * e.stiffness * parameters.phase * h * w[e.edge].sum(axis=1))
    grow = 1.0 + parameters.bend_gamma
    own = grow * (w[e.hinge] * e.weight**2).sum(axis=1)
    topology = topology_of(mesh)
    order = topology.batch_order
    return Body(
        w,
        e.edge,
        topology.edge_tri,
        e.rim,
        e.edge[order].view(np.uint32),
        topology.batch_start,
        1.0 / e.length[order] ** 2,
        1.0 / (w[e.edge].sum(axis=1) + e.compliance / h**2)[order],
        rate[order],
        e.hinge,
        e.weight,
        grow / (own + e.bend / h**2),
        bend_stiffening(e, own, h),
        build_bending_friction(
            mesh, material, h, settings.residual_curvature, settings.bending_ratio, settings.crease_set > 0.0
        ),
        build_crease_law(*hinge_extents(mesh), settings.crease_set, settings.crease_time),
        mesh.triangles.copy(),
        topology.tri_edge,
        topology.ring_start,
        topology.ring,
        topology.ring_edge,
        topology.clusters,
    )


def _solver_parameters(
    mesh: ClothMesh, material: Material, settings: SolverSettings, substeps: int, pads: PadGeometry, table: bool
) -> SolverParameters:
    h = settings.frame / substeps
    edge = float(np.quantile(mesh.edge_length, FINE_SHARE))
    softer = min(settings.anisotropy, 1.0 / settings.anisotropy) ** 0.5  # stiffness factor of the softer direction
    modulus = softer * membrane_modulus(material)
    stiffer = max(settings.bending_ratio, 1.0 / settings.bending_ratio) ** 0.5  # rigidity of the stiffer direction
    room = IN_PLANE * modulus * edge**2 / (stiffer * flexural_rigidity(material))
    sharpest = min(SHARPEST, max(0.0, 1.0 - DAMPED / room))
    most = max(0.0, room * (1.0 - sharpest) - 1.0)
    gx, gy, gz = settings.gravity
    return SolverParameters(
        h=h,
        substeps=substeps,
        phase=phase_length(h, substeps),
        flat=flat_cosine(material.thickness, edge),
        sharpest=sharpest,
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
