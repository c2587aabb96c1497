"""Build a trajectory library: optimise every fold of every garment, on any executor. Each finished entry is saved
immediately.

The searches run on threads of this process, and each simulation is sent to the executor. The result depends
neither on the number of threads nor on the executor. Each step starts from the cloth shape that results from the
saved entry of the previous step. A build that was killed and continued from its saved entries therefore ends with
the same library, bit for bit, as an uninterrupted build.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import metadata

from foldcell.cell.config.trajectory_library.library_file import entry_of
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT, lifted, tool_paths
from foldcell.skills.trajectory.search.optimise import METHODS, ClothPredictor, optimise_fold
from foldcell.skills.trajectory.search.problem import Predictor
from foldcell.skills.trajectory.trajectory_library import Library, LibraryEntry, trajectory_from
from foldcell.skills.vocabulary import Array, Failure, FoldStep

NOTHING = Library()


@dataclass(frozen=True)
class BuiltStep:
    """Result of one step of a build: its entry or a failure. kept: whether the entry was reused from an earlier
    build."""

    garment: str
    step: str
    entry: LibraryEntry | None
    failure: Failure | None
    kept: bool = False


@dataclass(frozen=True)
class BuildProgress:
    """Progress of a build. done: number of simulations done. total: largest number that the build may need.
    garment, step: the fold to which the last simulation belongs. dissimilarity: smallest dissimilarity of that
    fold so far [m]."""

    done: int
    total: int
    garment: str
    step: str
    dissimilarity: float


def build_library(
    garments: Iterable[Garment],
    method: str = "default",
    predict: Predictor | None = None,
    report: Callable[[BuiltStep], None] = lambda built: None,
    *,
    executor: Executor,
    budget: int | None = None,
    at_once: int = 1,
    finished: Library = NOTHING,
    progress: Callable[[BuildProgress], None] = lambda now: None,
    lift_height: float = LIFT_HEIGHT,
) -> Library:
    """Optimise every step of every garment in the order of its plan. The garment lies in the middle of its
    possible poses. If a step cannot be optimised, the remaining steps of its garment are left out.

    executor: runs the simulations, any executor of `concurrent.futures`; `predict` has to be available to its
    workers. at_once: number of garments searched in parallel. finished: entries of an interrupted build with the
    same budget and lift; matching ones are reused. lift_height: height of the straight lift before each arc [m].
    report: called after each step. progress: called after each simulation. Calls of these two functions never
    overlap, and an exception in one of them ends the build.
    """
    garments = tuple(garments)
    each = budget or METHODS[method][1]
    with ThreadPoolExecutor(at_once, "garment") as searches:
        build = _Build(
            method, each, predict or ClothPredictor(), executor, finished, lift_height, report, progress
        )
        build.total = sum(build.planned(g) for g in garments)
        jobs = [searches.submit(build.garment, g) for g in garments]
        try:
            entries = [entry for job in jobs for entry in job.result()]
        except BaseException:
            build.cancelled.set()
            for job in jobs:
                job.cancel()
            raise
    return Library(tuple(entries))


class _Cancelled(Exception):
    """Ends the search of a garment, because the search of another garment failed or the caller ended the build."""


@dataclass(eq=False)
class _Build:
    """A build in progress. `total` and `done` count simulations."""

    method: str
    budget: int
    predict: Predictor
    executor: Executor
    finished: Library
    lift_height: float
    report: Callable[[BuiltStep], None]
    progress: Callable[[BuildProgress], None]
    total: int = 0
    done: int = 0
    cancelled: threading.Event = field(default_factory=threading.Event)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def planned(self, garment: Garment) -> int:
        """Return the largest number of simulations that the searches of a garment may need."""
        return self.budget * sum(self._kept(garment, s.name) is None for s in garment.plan)

    def garment(self, garment: Garment) -> list[LibraryEntry]:
        """Return the entries for one garment's plan, up to the first step that cannot be optimised."""
        state = garment.flat_state(*garment.poses.middle)
        mesh = predictor_mesh(state, garment)
        positions: Array = mesh.lay_flat(garment.material.thickness)
        entries: list[LibraryEntry] = []
        steps = plan_folds(state, garment).unwrap()
        for step in steps:
            kept = self._kept(garment, step.name)
            built = (
                BuiltStep(garment.name, step.name, kept, None, kept=True)
                if kept is not None
                else self._step(garment, step, mesh, positions)
            )
            self._tell(built)
            if built.entry is None:
                self._skip(self.budget * sum(self._kept(garment, s.name) is None for s in steps[step.index + 1 :]))
                break
            entries.append(built.entry)
            if step is not steps[-1]:
                positions = self._folded(mesh, positions, garment, step, built.entry)
        return entries

    def _step(self, garment: Garment, step: FoldStep, mesh: ClothMesh, positions: Array) -> BuiltStep:
        counted = 0

        def count(done: int, _budget: int, best: float) -> None:
            nonlocal counted
            counted = done
            self._simulated(garment, step, best)

        outcome = optimise_fold(
            step, mesh, positions, garment.material, self.method, self.budget,
            executor=self.executor, predict=self.predict, max_tool_speed=garment.max_tool_speed, progress=count,
            lift_height=self.lift_height, bending_factors=garment.bending_factors,
        )  # fmt: skip
        self._skip(self.budget - counted)
        if outcome.value is None:
            return BuiltStep(garment.name, step.name, None, outcome.failure)
        initial = float(outcome.notes["dissimilarity_initial_m"])
        entry = entry_of(garment, step, outcome.unwrap(), self.method, initial)
        return BuiltStep(garment.name, step.name, entry, None)

    def _folded(
        self, mesh: ClothMesh, positions: Array, garment: Garment, step: FoldStep, entry: LibraryEntry
    ) -> Array:
        trajectory = trajectory_from(entry, step, garment.material.thickness, garment.max_tool_speed)
        assert trajectory is not None  # the entry was made from this step
        paths = {i: lifted(path, self.lift_height) for i, path in tool_paths(trajectory, step).items()}
        return self.executor.submit(self.predict, mesh, positions, garment.material, paths).result()

    def _kept(self, garment: Garment, step: str) -> LibraryEntry | None:
        return next((e for e in self.finished.entries if e.step == step and _is_of(e, garment, self.method)), None)

    def _simulated(self, garment: Garment, step: FoldStep, best: float) -> None:
        if self.cancelled.is_set():
            raise _Cancelled
        with self.lock:
            self.done += 1
            self.progress(BuildProgress(self.done, self.total, garment.name, step.name, best))

    def _skip(self, simulations: int) -> None:
        with self.lock:
            self.total -= simulations

    def _tell(self, built: BuiltStep) -> None:
        with self.lock:
            self.report(built)


def _is_of(entry: LibraryEntry, garment: Garment, method: str) -> bool:
    """Whether the entry belongs to the present garment file, this method and the present version of the
    program."""
    return (
        (entry.garment, entry.category, entry.method, entry.version)
        == (garment.name, garment.category, method, metadata.version("foldcell"))
        and entry.material == garment.material
        and entry.size_m == garment.size_m
        and (entry.edge_length, entry.max_tool_speed) == (garment.mesh_edge_m, garment.max_tool_speed)
    )
