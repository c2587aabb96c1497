"""Evaluates optimised arcs in other sizes and fabrics, and measures the time of a look-up."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.optimise.cases import Case, initial, judge, prepare
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import entry_of, load_library
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.search.optimise import optimise_fold
from foldcell.skills.trajectory.trajectory_library import LibraryEntry, lookup, trajectory_from
from foldcell.skills.vocabulary import GraspId, GraspTrajectory, Material

SIZES = (0.8, 1.2)
JUDGES = 3
LARGE_GAP_MM = 5.0
LOOKUPS = 200


def fabrics(m: Material) -> dict[str, Material]:
    """Return fabrics for which the arcs were not optimised, by name. m: the fabric for which they were
    optimised."""
    return {
        "friction x0.75": m.with_friction(0.75 * m.friction_static),
        "friction x1.25": m.with_friction(1.25 * m.friction_static),
        "stretch x2": replace(m, stretch_fraction=2.0 * m.stretch_fraction),
        "bending x1.3": replace(m, bending_length=1.3 * m.bending_length),
        "mass x1.3": replace(m, areal_mass=1.3 * m.areal_mass),
    }


def measure_lookups(case: Case, row: Mapping[str, Any], pool: ThreadPoolExecutor) -> list[dict[str, Any]]:
    """Evaluate arcs in other sizes and fabrics than those for which they were optimised; return one row per case.
    row: the result of the default method, which contains the arcs."""
    garment, index = case.garment, case.step.index
    entry = _entry(case, row)
    cases = {f"size x{s}": prepare(garment, index, s) for s in SIZES}
    cases |= {name: prepare(garment, index, material=m) for name, m in fabrics(garment.material).items()}
    told = []
    for name, other in cases.items():
        found = trajectory_from(entry, other.step, garment.material.thickness)
        if found is None:
            continue
        told.append({
            "garment": garment.name, "step": case.step.name, "case": name, "accepted": _accepted(other, found),
            "D_initial_mm": 1e3 * judge(other, initial(other), found.duration, pool, JUDGES),
            "D_mm": 1e3 * judge(other, found.control_points, found.duration, pool, JUDGES),
            "D_relax_mm": 1e3 * other.d_relax,
            "closed_at_home": (row["D_initial_mm"] - row["D_mm"]) / (row["D_initial_mm"] - row["D_relax_mm"]),
        })  # fmt: skip
    return told


def summary_of_lookups(told: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise the look-ups: their numbers, and the worst figures of those that a run would accept unchanged."""
    taken = [r for r in told if r["accepted"]]
    large = [r for r in taken if r["D_initial_mm"] - r["D_relax_mm"] >= LARGE_GAP_MM and r["closed_at_home"] > 0.0]
    return {
        "lookups": len(told),
        "lookups_accepted": len(taken),
        "lookups_with_large_gap": len(large),
        "scaled_gap_kept_min": min((_kept(r) for r in large), default=None),
        "scaled_worse_than_initial_mm_max": max((r["D_mm"] - r["D_initial_mm"] for r in taken), default=None),
    }


def _kept(row: Mapping[str, Any]) -> float:
    """Share of the gap that the arcs close in this case, relative to the share that they close in the case for
    which they were optimised."""
    closed = (row["D_initial_mm"] - row["D_mm"]) / (row["D_initial_mm"] - row["D_relax_mm"])
    return float(closed / row["closed_at_home"])


def _accepted(case: Case, found: GraspTrajectory) -> bool:
    """Whether a run would accept the arcs unchanged."""
    mesh, before = case.coarse
    outcome = optimise_fold(
        case.step, mesh, before, case.garment.material, "initial", start=dict(found.control_points),
        promised=found.dissimilarity, promised_initial=found.dissimilarity_initial,
        max_tool_speed=case.garment.max_tool_speed,
    )  # fmt: skip
    return outcome.value is not None and outcome.value.source == "library"


def _entry(case: Case, row: Mapping[str, Any]) -> LibraryEntry:
    controls = {GraspId(i): np.array(c) for i, c in row["arcs_m"].items()}
    trajectory = GraspTrajectory(
        controls, row["duration_s"], "optimised", 0.0, 1e-3 * row["D_promised_mm"], row["simulations"]
    )
    initial = 1e-3 * row["D_promised_initial_mm"]
    return entry_of(case.garment, case.step, trajectory, "default", initial)


def measure_lookup_times(names: Sequence[str]) -> dict[str, Any]:
    """Measure the time to look up an arc among all entries of the shipped library and to scale it: wall time, and
    CPU time, which is more reliable on a busy machine."""
    library = load_library().library
    times, spent, found = [], [], 0
    for name in names:
        garment = load_garment(name, "bare_table")
        for step in plan_folds(garment.flat_state(*garment.poses.middle), garment).unwrap():
            for _ in range(LOOKUPS // len(names)):
                began, cpu = time.perf_counter(), time.thread_time()
                entry = lookup(library, garment.category, step.name, garment.material, garment.size_m)
                if entry is not None:
                    trajectory_from(entry, step, garment.material.thickness, garment.max_tool_speed)
                times.append(time.perf_counter() - began)
                spent.append(time.thread_time() - cpu)
            found += entry is not None
    wall, own = (1e3 * float(np.percentile(t, 99)) for t in (times, spent))
    return {"lookup_ms_p99": wall, "lookup_cpu_ms_p99": own, "steps_in_library": found}
