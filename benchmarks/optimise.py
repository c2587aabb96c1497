"""How good the optimised folds are: every garment and step, all methods on one budget, judged by another mesh.

    foldcell bench optimise [--quick] [--peers] [--json]

What is optimised on the optimiser's mesh is judged on a finer one, by the median of D over arcs whose inner
control points were moved by half a millimetre: neither the luck of the draw nor the mesh's own habits count. D is
the paper's, three-dimensional and unaligned. Beside it stand D of the paper's initial arc, at the same grasp, mesh
and duration, and D_relax, the ideal fold left to settle: the median over three meshes, because now and then a
stack that starts exactly folded is flung. Earlier steps are ideal and settled.

Grasps are released at their mirror image, as in the paper and in D_relax. What the cell adds, some millimetres of
tension, moves the garment by as much whatever the arc (small_towel, first fold, initial arc: D 4.4 mm with it, 1.1
without), so that a share of the gap would say nothing of the optimiser.

Seconds are of the wall, with two threads; cpu_seconds are what all threads spent: on a machine that does other
things too, these say more. A look-up in another size or fabric is accepted or refused as in a run (one simulation
on the optimiser's mesh against what the entry promises); what is refused would be optimised, so it is told but not
counted.

--quick: towels' first folds on a small budget. --peers: the paper's method too (it takes as long as all others).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.d_relax import EDGE, d_relax, distance_to_target
from cell.garments import list_garments, load_garment
from cell.library import load_library
from robots.ports import Array, Side
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.predict import predict_fold
from skills.garments.garment import Garment
from skills.planning.plan import plan_folds
from skills.trajectory.bezier import initial_controls
from skills.trajectory.frame import frames_of
from skills.trajectory.library import Library, LibraryEntry, entry_from, lookup, trajectory_from
from skills.trajectory.optimise import optimise_fold
from skills.trajectory.paths import fold_paths
from skills.vocabulary import FoldStep, GraspTrajectory, Material

Tell = Callable[[str], None]
Controls = Mapping[Side, Array]

BUDGET, QUICK_BUDGET = 25, 10
PERTURBED, SHIFT = 5, 0.0005
"""Arcs that judge one, and how far their inner control points are moved [m]."""
FINER = 0.85
"""Edges of the mesh that judges, to those of the mesh that was optimised on, at most."""
NEIGHBOURS = (0.95, 1.0, 1.05)
"""Edges of the meshes that D_relax is the median of, to that of the finest."""
GAP = 0.002
"""A fold whose initial arc is this much worse than D_relax can be made better [m]."""
LARGE_GAP = 0.005
SIZES = (0.8, 1.2)
LOOKUPS = 200


@dataclass(frozen=True, eq=False)
class Case:
    """One step of one garment, ready to be folded. coarse, fine: mesh and its vertices (n, 3) before the step."""

    garment: Garment
    step: FoldStep
    coarse: tuple[ClothMesh, Array]
    fine: tuple[ClothMesh, Array]
    d_relax: float

    @property
    def name(self) -> str:
        return f"{self.garment.name}/{self.step.name}"


def measure(tell: Tell, *, peers: bool, quick: bool, garments: Sequence[str] | None = None) -> Mapping[str, Any]:
    """The figures of every step and the worst of them. garments: names (default: all; towels if quick)."""
    names = garments or [n for n in list_garments() if not quick or n.endswith("_towel")]
    budget = QUICK_BUDGET if quick else BUDGET
    methods = ["default", "two_parameter", *(["paper"] if peers else [])]
    rows: list[dict[str, Any]] = []
    looked_up: list[LookedUp] = []
    with ThreadPoolExecutor(2) as pool:
        for name in names:
            garment = load_garment(name, "bare_table")
            for index in range(1 if quick else len(garment.plan)):
                case = prepare(garment, index)
                found = {m: _optimised(case, m, budget) for m in methods}
                judged = _judge_all(case, found, pool)
                rows += judged
                for row in judged:
                    tell(_line(row))
                if not quick and (trajectory := found["default"].trajectory) is not None:
                    looked_up += _scaled(case, trajectory, judged[0], pool, tell)
        figures = _worst(rows) | _lookups(looked_up)
        figures |= _lookup_times(names) | _workers(names[0])
    return {**figures, "steps": rows}


def prepare(garment: Garment, index: int, scale: float = 1.0, material: Material | None = None) -> Case:
    """The `index`-th step of a garment laid in the middle of its poses, in another size or fabric if asked."""
    plan = tuple(replace(step, tension=(0.0, 0.0)) for step in garment.plan)
    garment = replace(garment, plan=plan, material=material or garment.material)
    state = garment.flat_state(*garment.poses.middle, scale=scale)
    step = plan_folds(state, garment).unwrap()[index]
    edge = garment.mesh_edge_m * scale
    fine = min(EDGE, FINER * edge)
    relaxed = []
    for share in NEIGHBOURS:
        mesh = mesh_from_contour(state.contour, share * fine, garment.layers)
        relaxed.append((d_relax(mesh, step.lines, garment.material)[0], mesh))
    d, judging = sorted(relaxed, key=lambda pair: pair[0])[len(relaxed) // 2]
    optimised = mesh_from_contour(state.contour, edge, garment.layers)
    return Case(garment, step, _before(optimised, step, garment), _before(judging, step, garment), d)


def _before(mesh: ClothMesh, step: FoldStep, garment: Garment) -> tuple[ClothMesh, Array]:
    """The mesh with its vertices (n, 3) before the step."""
    if not step.earlier:
        return mesh, mesh.lay_flat(garment.material.thickness)
    return mesh, d_relax(mesh, step.earlier, garment.material)[1]


def judge(case: Case, controls: Controls, duration: float, pool: ThreadPoolExecutor, n: int = PERTURBED) -> float:
    """Median of D [m] on the fine mesh over arcs with their inner control points moved a little."""
    rng = np.random.default_rng(0)
    moved = []
    for _ in range(n):
        arcs = {side: np.array(c) for side, c in sorted(controls.items())}
        for arc in arcs.values():
            arc[1:-1] += rng.uniform(-SHIFT, SHIFT, arc[1:-1].shape)
        moved.append(arcs)
    return float(np.median(list(pool.map(partial(_miss, case, duration), moved))))


def _miss(case: Case, duration: float, controls: Controls) -> float:
    mesh, before = case.fine
    headings = {side: grasp.heading for side, grasp in case.step.grasps.items()}
    after = predict_fold(mesh, before, case.garment.material, fold_paths(controls, headings, duration)).vertices
    return distance_to_target(mesh, case.step.lines, case.garment.material, after)


def _initial(case: Case) -> dict[Side, Array]:
    frames = frames_of(case.step, case.garment.material.thickness)
    return {side: initial_controls(frame.start, frame.end) for side, frame in frames.items()}


@dataclass(frozen=True, eq=False)
class Optimised:
    """What a method found, and what it took [s] with two threads."""

    trajectory: GraspTrajectory | None
    simulations: int
    seconds: float
    cpu_seconds: float


def _optimised(case: Case, method: str, budget: int) -> Optimised:
    mesh, before = case.coarse
    began, cpu = time.monotonic(), time.process_time()
    outcome = optimise_fold(
        case.step, mesh, before, case.garment.material, method, budget,
        max_tool_speed=case.garment.max_tool_speed,
    )  # fmt: skip
    return Optimised(
        outcome.value,
        int(outcome.notes.get("simulations", 0)),
        time.monotonic() - began,
        time.process_time() - cpu,
    )


def _judge_all(case: Case, found: Mapping[str, Optimised], pool: ThreadPoolExecutor) -> list[dict[str, Any]]:
    """One row a method; the initial arc is judged once, at the duration of the default's."""
    ours = found["default"].trajectory
    initial = 1e3 * judge(case, _initial(case), ours.duration, pool) if ours else None
    rows = []
    for method, it in found.items():
        d = (
            1e3 * judge(case, it.trajectory.control_points, it.trajectory.duration, pool)
            if it.trajectory
            else None
        )
        rows.append({
            "garment": case.garment.name, "step": case.step.name, "method": method, "layers": case.garment.layers,
            "D_relax_mm": 1e3 * case.d_relax, "D_initial_mm": initial, "D_mm": d,
            "simulations": it.simulations, "seconds": it.seconds, "cpu_seconds": it.cpu_seconds,
        })  # fmt: skip
    return rows


def _worst(rows: list[dict[str, Any]]) -> dict[str, Any]:
    default = [r for r in rows if r["method"] == "default" and r["D_mm"] is not None]
    two = {(r["garment"], r["step"]): r["D_mm"] for r in rows if r["method"] == "two_parameter"}
    paper = {(r["garment"], r["step"]): r["D_mm"] for r in rows if r["method"] == "paper"}
    closed = [_closed(r) for r in default if r["D_initial_mm"] - r["D_relax_mm"] >= 1e3 * GAP]

    def over(other: Mapping[tuple[str, str], float | None]) -> float | None:
        return max((r["D_mm"] - d for r in default if (d := other.get((r["garment"], r["step"]))) is not None),
                   default=None)  # fmt: skip

    return {
        "steps_optimised": len(default),
        "steps_failed": sum(r["method"] == "default" for r in rows) - len(default),
        "gap_closed_min": min(closed, default=None),
        "gap_closed_median": float(np.median(closed)) if closed else None,
        "worse_than_initial_mm_max": max((r["D_mm"] - r["D_initial_mm"] for r in default), default=None),
        "worse_than_two_parameter_mm_max": over(two),
        "worse_than_paper_mm_max": over(paper),
        "towel_step_s_max": max((r["seconds"] for r in default if r["layers"] == 1), default=None),
        "two_layer_step_s_max": max((r["seconds"] for r in default if r["layers"] == 2), default=None),
        "towel_step_cpu_s_max": max((r["cpu_seconds"] for r in default if r["layers"] == 1), default=None),
        "two_layer_step_cpu_s_max": max((r["cpu_seconds"] for r in default if r["layers"] == 2), default=None),
    }


def _closed(row: Mapping[str, Any]) -> float:
    """Share of the gap between the initial arc and the ideal fold's rest that was closed."""
    return float((row["D_initial_mm"] - row["D_mm"]) / (row["D_initial_mm"] - row["D_relax_mm"]))


@dataclass(frozen=True)
class LookedUp:
    """An arc looked up for another size or fabric. D and gaps in metres, on the fine mesh; closed: the share of
    this case's gap that it closes, and of its own case's that it closed there."""

    accepted: bool
    initial: float
    ours: float
    relaxed: float
    closed_at_home: float

    @property
    def kept(self) -> float:
        """Share of what is closed at home."""
        return (self.initial - self.ours) / (self.initial - self.relaxed) / self.closed_at_home


def _scaled(
    case: Case, trajectory: GraspTrajectory, row: Mapping[str, Any], pool: ThreadPoolExecutor, tell: Tell
) -> list[LookedUp]:
    """The same arcs, looked up in other sizes and fabrics."""
    if row["D_mm"] is None:
        return []
    garment, index = case.garment, case.step.index
    entry = _entry(case, trajectory)
    m = garment.material
    fabrics = {
        "friction x0.75": m.with_friction(0.75 * m.friction_static),
        "friction x1.25": m.with_friction(1.25 * m.friction_static),
        "stretch x2": replace(m, stretch_fraction=2.0 * m.stretch_fraction),
        "bending x1.3": replace(m, bending_length=1.3 * m.bending_length),
        "mass x1.3": replace(m, areal_mass=1.3 * m.areal_mass),
    }
    cases = {f"size x{s}": prepare(garment, index, s) for s in SIZES}
    cases |= {name: prepare(garment, index, material=fabric) for name, fabric in fabrics.items()}
    results = []
    for name, other in cases.items():
        found = trajectory_from(entry, other.step, m.thickness)
        if found is None:
            continue
        result = LookedUp(
            _accepted(other, found),
            judge(other, _initial(other), found.duration, pool, 3),
            judge(other, found.control_points, found.duration, pool, 3),
            other.d_relax,
            _closed(row),
        )
        results.append(result)
        verdict = "" if result.accepted else ", refused: would be optimised"
        tell(f"  {case.name} {name}: initial {result.initial * 1e3:.1f} mm, looked up {result.ours * 1e3:.1f} mm"
             f" (relaxed ideal {result.relaxed * 1e3:.1f}){verdict}")  # fmt: skip
    return results


def _accepted(case: Case, found: GraspTrajectory) -> bool:
    """Whether a run would take the arcs as they are."""
    mesh, before = case.coarse
    outcome = optimise_fold(
        case.step, mesh, before, case.garment.material, "initial", start=dict(found.control_points),
        promised=found.dissimilarity, max_tool_speed=case.garment.max_tool_speed,
    )  # fmt: skip
    return outcome.value is not None and outcome.value.source == "library"


def _lookups(results: Sequence[LookedUp]) -> dict[str, Any]:
    taken = [r for r in results if r.accepted]
    large = [r for r in taken if r.initial - r.relaxed >= LARGE_GAP and r.closed_at_home > 0.0]
    return {
        "lookups": len(results),
        "lookups_accepted": len(taken),
        "lookups_with_large_gap": len(large),
        "scaled_gap_kept_min": min((r.kept for r in large), default=None),
        "scaled_worse_than_initial_mm_max": max((1e3 * (r.ours - r.initial) for r in taken), default=None),
    }


def _entry(case: Case, trajectory: GraspTrajectory) -> LibraryEntry:
    garment, step = case.garment, case.step
    return entry_from(
        trajectory, step, category=garment.category, variant=garment.plan[step.index].variants[0].name,
        garment=garment.name, material=garment.material, size_m=garment.size_m, edge_length=garment.mesh_edge_m,
        method="default", dissimilarity_initial=0.0, max_tool_speed=garment.max_tool_speed, version="benchmark",
    )  # fmt: skip


def _lookup_times(names: list[str]) -> dict[str, Any]:
    """Looking an arc up in the shipped library, among all its entries, and scaling it."""
    library: Library = load_library().library
    times, found = [], 0
    for name in names:
        garment = load_garment(name, "bare_table")
        for step in plan_folds(garment.flat_state(*garment.poses.middle), garment).unwrap():
            for _ in range(LOOKUPS // len(names)):
                began = time.perf_counter()
                entry = lookup(library, garment.category, step.name, garment.material, garment.size_m)
                if entry is not None:
                    trajectory_from(entry, step, garment.material.thickness, garment.max_tool_speed)
                times.append(time.perf_counter() - began)
            found += entry is not None
    return {"lookup_ms_p99": 1e3 * float(np.percentile(times, 99)), "steps_in_library": found}


def _workers(name: str) -> dict[str, float]:
    """Wall time of one step's search with one thread over that with two."""
    case = prepare(load_garment(name, "bare_table"), 0)
    seconds = []
    for threads in (1, 2):
        began = time.monotonic()
        mesh, before = case.coarse
        optimise_fold(case.step, mesh, before, case.garment.material, "default", QUICK_BUDGET, threads=threads)
        seconds.append(time.monotonic() - began)
    return {"two_threads_x_faster": seconds[0] / seconds[1]}


def _line(row: Mapping[str, Any]) -> str:
    head = f"{row['garment']} {row['step']} {row['method']}: "
    if row["D_mm"] is None:
        return head + f"no trajectory after {row['simulations']} simulations"
    return head + (
        f"D {row['D_initial_mm']:.1f} -> {row['D_mm']:.1f} mm (relaxed ideal {row['D_relax_mm']:.1f}), "
        f"{row['simulations']} simulations, {row['seconds']:.1f} s"
    )
