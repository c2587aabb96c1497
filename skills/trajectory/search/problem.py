"""One fold as a function of its arcs: simulates them, compares the result with the target, and computes the
cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from foldcell.robots.errors import CellError
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.trajectory.arcs.bezier import arc_lengths
from foldcell.skills.trajectory.arcs.frame import FoldFrame, frames_of
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT, fold_duration, fold_paths, lifted
from foldcell.skills.trajectory.search.objective import cost, dissimilarity
from foldcell.skills.vocabulary import Array, FoldStep, GraspId, Material, ToolPath

Controls = dict[GraspId, Array]
"""Control points (n + 1, 3) of each grasp's arc, table frame."""

MAX_HEIGHT = 0.40
"""Largest height of an arc above the table [m]."""

FAILED = 1.0
"""D of a candidate whose simulation failed [m]: finite, and worse than any fold."""


class Predictor(Protocol):
    """Simulates one fold and returns the vertices (n, 3) after release and settling. Pure and safe to call from
    threads."""

    def __call__(
        self, mesh: ClothMesh, positions: Array, material: Material, paths: Mapping[GraspId, ToolPath], /
    ) -> Array: ...


@dataclass(frozen=True)
class Mishap:
    """Deviation of an executed fold from the planned one.

    pitch: lean of each hand about its held line (the line of cloth between the pads) [rad]; roll: lean of both
    hands along their held lines [rad]; along: offset of both tools perpendicular to the fold line, towards the
    side that is folded over [m]; across: offset of both tools parallel to the fold line [m]; friction, bending:
    factors by which table friction and bending length differ from the assumed values.
    """

    pitch: Mapping[GraspId, float]
    roll: float = 0.0
    along: float = 0.0
    across: float = 0.0
    friction: float = 1.0
    bending: float = 1.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """One simulated set of arcs. dissimilarity: the paper's D [m]; cost: the paper's C; duration: of the fold
    along the arcs [s]; failed: True if the simulation failed."""

    controls: Controls
    dissimilarity: float
    cost: float
    duration: float
    failed: bool


@dataclass(frozen=True, eq=False)
class FoldProblem:
    """The inputs that stay the same while one fold is optimised. positions: (n, 3) vertices of the mesh before the
    fold [m].

    max_tool_speed [m/s]; lift_height: height of the straight lift before the arc [m]; bending_factors: range of
    the bending length, relative to the material's, for which the arcs have to be good.
    """

    step: FoldStep
    mesh: ClothMesh
    positions: Array
    material: Material
    predict: Predictor
    max_tool_speed: float
    lift_height: float = LIFT_HEIGHT
    bending_factors: tuple[float, float] = (0.85, 1.15)

    @cached_property
    def target(self) -> Array:
        """(n, 3) vertices of the mesh in the ideal shape after the fold [m]."""
        return target_vertices(self.mesh, self.step.lines, self.material)

    @cached_property
    def frames(self) -> dict[GraspId, FoldFrame]:
        return frames_of(self.step, self.material.thickness)

    def prepare(self) -> None:
        """Compute the cached values now, so that a problem sent to another process includes them."""
        _ = self.target, self.frames

    def evaluate(self, controls: Controls, mishap: Mishap | None = None) -> Candidate:
        """Simulate one candidate as the arms execute it, that is lift and arc, optionally with a mishap.

        If the simulation fails, the candidate is marked as failed; no exception is raised.
        """
        duration = fold_duration(controls, self.max_tool_speed)
        lengths = np.array([arc_lengths(c)[1][-1] for c in controls.values()])
        headings = {grasp_id: grasp.heading for grasp_id, grasp in self.step.grasps.items()}
        material, paths = self.material, fold_paths(controls, headings, duration)
        if mishap is not None:
            material = _altered(material, mishap)
            paths = {grasp_id: self._astray(grasp_id, path, mishap) for grasp_id, path in paths.items()}
        paths = {grasp_id: lifted(path, self.lift_height) for grasp_id, path in paths.items()}
        try:
            end = self.predict(self.mesh, self.positions, material, paths)
            d = dissimilarity(self.target, end, self.mesh.triangles, self.mesh.area)
        except CellError:
            d = float("nan")
        failed = not np.isfinite(d)
        d = FAILED if failed else d
        return Candidate(controls, d, cost(lengths, d), duration, failed)

    def _astray(self, grasp_id: GraspId, path: ToolPath, mishap: Mishap) -> ToolPath:
        line = self.step.line
        off = mishap.along * line.normal + mishap.across * line.direction
        return replace(
            path,
            position=path.position + np.append(off, 0.0),
            pitch=path.pitch + mishap.pitch[grasp_id],
            roll=path.roll + mishap.roll,
        )


def _altered(material: Material, mishap: Mishap) -> Material:
    material = material.with_friction(mishap.friction * material.friction_static)
    return replace(material, bending_length=mishap.bending * material.bending_length)


class Evaluator:
    """Evaluates candidates in parallel, counts them and stores the best one in `best`. The attribute `first` is
    the candidate of the initial arc; unless it is set, the first evaluated candidate becomes `first`.

    Results depend on the candidates only, not on which simulation ends first: batches are passed and returned in
    order, and of two candidates with the same cost, the earlier one counts as better.
    """

    def __init__(
        self,
        problem: FoldProblem,
        budget: int,
        executor: Executor,
        progress: Callable[[int, int, float], None] | None,
        watch: Callable[[int, Candidate, Candidate], None] | None = None,
    ) -> None:
        self.problem = problem
        self.budget = budget
        self.first: Candidate | None = None
        self.best: Candidate | None = None
        self.plain: Candidate | None = None
        """The plain arc, which is chosen if the best arc gains hardly anything over it."""
        self.seen: list[Candidate] = []
        self.count = 0
        self.failed = 0
        self._executor = executor
        self._progress = progress
        self._watch = watch

    @property
    def left(self) -> int:
        return self.budget - self.count

    def many(self, batch: Sequence[Controls]) -> list[Candidate]:
        """Simulate a batch. Progress is reported for each candidate as soon as it and all earlier candidates are
        done."""
        candidates = []
        for candidate in self._executor.map(self.problem.evaluate, batch):
            self._take(candidate)
            candidates.append(candidate)
        return candidates

    def confirm(self, trials: Sequence[tuple[FoldProblem, Candidate, Mishap | None]]) -> list[float]:
        """Simulate candidates again. A trial is (problem, candidate, mishap): the fold is simulated as planned if
        the mishap is None, else with the mishap. The problem is `self.problem` or the same fold on another mesh.
        Returns D of each trial [m]."""
        found = []
        for outcome in self._executor.map(_again, trials):
            found.append(outcome.dissimilarity)
            self.failed += outcome.failed
            self._tick()
        return found

    def one(self, controls: Controls) -> Candidate:
        return self.many([controls])[0]

    def _take(self, candidate: Candidate) -> None:
        self.failed += candidate.failed
        self.seen.append(candidate)
        self.first = self.first or candidate
        if self.best is None or candidate.cost < self.best.cost:
            self.best = candidate
        self._tick()
        if self._watch is not None:
            self._watch(self.count, candidate, self.best)

    def _tick(self) -> None:
        self.count += 1
        if self._progress is not None and self.best is not None:
            self._progress(self.count, self.budget, self.best.dissimilarity)


def _again(trial: tuple[FoldProblem, Candidate, Mishap | None]) -> Candidate:
    problem, candidate, mishap = trial
    return problem.evaluate(candidate.controls, mishap)
