"""Measures the quality of the optimised folds of every garment and step. All methods have the same budget.

    foldcell bench optimise [--quick] [--garment A,B] [--json]

Arcs are optimised on the optimiser's mesh and evaluated on three finer meshes. For an evaluation, the inner
control points of an arc are moved several times by up to half a millimetre, on the three meshes in turn; the
figure is the median of D. It therefore depends neither on chance nor on the peculiarities of one mesh. D is
defined as in the paper: three-dimensional and unaligned. It is compared with D of the paper's initial arc at the
same grasp, meshes and duration, and with D_relax, the median over the same meshes for the settled ideal fold
(benchmarks/attainable_dissimilarity.py). Earlier steps are ideal and settled. All arcs are simulated with the lift
before them, as the cell executes them.

Here, a grasp is released at its mirror image, as in the paper and in D_relax. The cell adds some millimetres of
tension, which moves the garment by the same distance for every arc (small_towel, first fold, initial arc: D 4.4 mm
with tension, 1.1 mm without). With tension, the share of the gap that an arc closes would therefore not measure
the optimiser. The gap is the difference between D of the initial arc and D_relax.

`seconds` is wall time with two threads. `cpu_seconds` is the CPU time of all threads, which is more reliable on a
busy machine. Arcs of the library are also looked up for other sizes and fabrics. A look-up is accepted or refused
as in a run: one or two simulations on the optimiser's mesh are compared with the entry's promised D. A run would
optimise the fold after a refused look-up, so refused look-ups are reported, but do not count in the figures.

The figures of each step are saved as soon as they are measured (logs/bench-optimise.json). They are reused as long
as solver, optimiser and garment are unchanged. An interrupted benchmark can therefore be continued, and garments
can be measured separately.

--quick: only the towels' first folds with a small budget, without the paper's method and look-ups; nothing is
saved.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from benchmarks.kept import Kept, fingerprint
from benchmarks.optimise.cases import Case, initial, judge, prepare
from benchmarks.optimise.lookups import measure_lookup_times, measure_lookups, summary_of_lookups
from foldcell.cell.config.garments.garment_file import garment_path, list_garments, load_garment
from foldcell.cell.support.files.paths import logs_directory
from foldcell.skills.trajectory.search.optimise import optimise_fold
from foldcell.skills.vocabulary import GraspTrajectory

Tell = Callable[[str], None]

METHODS = ("default", "two_parameter", "paper")
BUDGET, QUICK_BUDGET = 25, 10
MEASURED = ("skills/cloth", "skills/trajectory", "skills/fold_plan", "benchmarks/optimise")
GAP = 0.002
"""If D of the initial arc exceeds D_relax by at least this, a fold counts as improvable [m]."""


def measure(tell: Tell, *, peers: bool, quick: bool, garments: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Measure every step. Return the figures of every step, and the worst of them. garments: names (default: all,
    or the towels if quick)."""
    del peers  # every full measurement includes the paper's method
    names = garments or [n for n in list_garments() if not quick or n.endswith("_towel")]
    methods, budget = (METHODS[:2], QUICK_BUDGET) if quick else (METHODS, BUDGET)
    kept = Kept(None if quick else logs_directory() / "bench-optimise.json")
    with ThreadPoolExecutor(2) as pool:
        steps = []
        for name in names:
            key = fingerprint(MEASURED, garment_path(name), budget=budget, methods=methods)
            for index in range(1 if quick else len(load_garment(name, "bare_table").plan)):
                steps.append(_Step(name, index, key, kept, pool, tell))
        rows = [row for step in steps for row in step.rows(methods, budget)]
        # Look-ups take most of the time. They come last, so an interruption most likely leaves the rest reported.
        looked_up = [] if quick else [row for step in steps for row in step.lookups()]
    figures = _worst(rows) | summary_of_lookups(looked_up)
    figures |= measure_lookup_times(names)
    return {**figures, "steps": rows, "lookups_told": looked_up}


class _Step:
    """Provides the figures of one step: saved ones, or newly measured ones. The case is prepared only if something
    has to be measured."""

    def __init__(self, name: str, index: int, key: str, kept: Kept, pool: ThreadPoolExecutor, tell: Tell) -> None:
        self._garment = load_garment(name, "bare_table")
        self._index, self._key, self._kept, self._pool, self._tell = index, key, kept, pool, tell
        self._made: Case | None = None

    @property
    def _case(self) -> Case:
        if self._made is None:
            self._made = prepare(self._garment, self._index)
        return self._made

    def rows(self, methods: Sequence[str], budget: int) -> list[dict[str, Any]]:
        """Return one row of figures per method."""
        rows = []
        for method in methods:
            part = f"{self._index}/{method}"
            row = self._kept.get(self._key, part)
            if row is None:
                row = self._measured(method, budget, rows[0] if rows else None)
                self._kept.put(self._key, part, row)
            self._tell(_line(row))
            rows.append(row)
        return rows

    def _measured(self, method: str, budget: int, default: Mapping[str, Any] | None) -> dict[str, Any]:
        case = self._case
        mesh, before = case.coarse
        began, cpu = time.monotonic(), time.process_time()
        outcome = optimise_fold(
            case.step, mesh, before, case.garment.material, method, budget,
            max_tool_speed=case.garment.max_tool_speed,
        )  # fmt: skip
        seconds, cpu_seconds = time.monotonic() - began, time.process_time() - cpu
        found = outcome.value
        initial_mm = default["D_initial_mm"] if default else self._initial_mm(found)
        return {
            "garment": case.garment.name, "step": case.step.name, "method": method, "layers": case.garment.layers,
            "D_relax_mm": 1e3 * case.d_relax, "D_initial_mm": initial_mm,
            "D_mm": None if found is None
            else 1e3 * judge(case, found.control_points, found.duration, self._pool),
            "simulations": int(outcome.notes.get("simulations", 0)), "seconds": seconds,
            "cpu_seconds": cpu_seconds,
            "arcs_m": None if found is None else {s.value: c.tolist() for s, c in found.control_points.items()},
            "duration_s": None if found is None else found.duration,
            "D_promised_mm": None if found is None else 1e3 * found.dissimilarity,
            "D_promised_initial_mm": 1e3 * float(outcome.notes.get("dissimilarity_initial_m", np.nan)),
        }  # fmt: skip

    def _initial_mm(self, ours: GraspTrajectory | None) -> float | None:
        """D [mm] of the initial arc, executed with the same duration as the default method's arc."""
        if ours is None:
            return None
        return 1e3 * judge(self._case, initial(self._case), ours.duration, self._pool)

    def lookups(self) -> list[dict[str, Any]]:
        """Return the figures of the default method's arcs in other sizes and fabrics, one row per case."""
        row = self._kept.get(self._key, f"{self._index}/default")
        if row["D_mm"] is None:
            return []
        part = f"{self._index}/lookups"
        told = self._kept.get(self._key, part)
        if told is None:
            told = measure_lookups(self._case, row, self._pool)
            self._kept.put(self._key, part, told)
        for it in told:
            verdict = "" if it["accepted"] else ", refused: would be optimised"
            self._tell(f"  {it['garment']} {it['step']} {it['case']}: initial {it['D_initial_mm']:.1f} mm, looked"
                       f" up {it['D_mm']:.1f} mm (relaxed ideal {it['D_relax_mm']:.1f}){verdict}")  # fmt: skip
        return list(told)


def _worst(rows: list[dict[str, Any]]) -> dict[str, Any]:
    default = [r for r in rows if r["method"] == "default" and r["D_mm"] is not None]

    def of(method: str) -> dict[tuple[str, str], float]:
        return {
            (r["garment"], r["step"]): r["D_mm"] for r in rows if r["method"] == method and r["D_mm"] is not None
        }

    def over(other: Mapping[tuple[str, str], float]) -> float | None:
        return max((r["D_mm"] - d for r in default if (d := other.get((r["garment"], r["step"]))) is not None),
                   default=None)  # fmt: skip

    wide = [r for r in default if r["D_initial_mm"] - r["D_relax_mm"] >= 1e3 * GAP]
    narrow = [r for r in default if r not in wide]
    closed = [_closed(r) for r in wide]
    return {
        "steps_optimised": len(default),
        "steps_failed": sum(r["method"] == "default" for r in rows) - len(default),
        "steps_with_gap": len(wide),
        "gap_closed_min": min(closed, default=None),
        "gap_closed_median": float(np.median(closed)) if closed else None,
        "worse_than_initial_mm_max": max((r["D_mm"] - r["D_initial_mm"] for r in default), default=None),
        "worse_than_initial_without_gap_mm_max": max(
            (r["D_mm"] - r["D_initial_mm"] for r in narrow), default=None
        ),
        "worse_than_two_parameter_mm_max": over(of("two_parameter")),
        "worse_than_paper_mm_max": over(of("paper")),
        "towel_step_s_max": max((r["seconds"] for r in default if r["layers"] == 1), default=None),
        "two_layer_step_s_max": max((r["seconds"] for r in default if r["layers"] == 2), default=None),
        "towel_step_cpu_s_max": max((r["cpu_seconds"] for r in default if r["layers"] == 1), default=None),
        "two_layer_step_cpu_s_max": max((r["cpu_seconds"] for r in default if r["layers"] == 2), default=None),
    }


def _closed(row: Mapping[str, Any]) -> float:
    """Share of the gap, between D of the initial arc and D_relax, that the optimised arc closes."""
    return float((row["D_initial_mm"] - row["D_mm"]) / (row["D_initial_mm"] - row["D_relax_mm"]))


def _line(row: Mapping[str, Any]) -> str:
    head = f"{row['garment']} {row['step']} {row['method']}: "
    if row["D_mm"] is None:
        return head + f"no trajectory after {row['simulations']} simulations"
    return head + (
        f"D {row['D_initial_mm']:.1f} -> {row['D_mm']:.1f} mm (relaxed ideal {row['D_relax_mm']:.1f}), "
        f"{row['simulations']} simulations, {row['seconds']:.1f} s"
    )
