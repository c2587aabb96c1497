"""Creates the planning tasks of the motion benchmarks: all folds of all shipped garments, at poses drawn from the
pose ranges of the garment files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.search.optimise import plain_paths
from foldcell.skills.vocabulary import FoldStep, GraspId, ToolPath


@dataclass(frozen=True, eq=False)
class Task:
    """One fold of one garment at one pose (x, y [m], angle [rad]), with the tool paths of its plain arc."""

    garment: Garment
    pose: tuple[float, float, float]
    step: FoldStep
    paths: Mapping[GraspId, ToolPath]

    @property
    def name(self) -> str:
        return f"{self.garment.name}/{self.step.name}"


def tasks(poses: int, surface: str = "bare_table", seed: int = 6) -> Iterator[Task]:
    """Yield all folds of all shipped garments, each at `poses` poses. The same seed gives the same tasks."""
    for number, name in enumerate(list_garments()):
        garment = load_garment(name, surface)
        rng = np.random.default_rng([seed, number])
        for _ in range(poses):
            pose = garment.poses.sample(rng)
            for step in plan_folds(garment.flat_state(*pose), garment).unwrap():
                yield Task(garment, pose, step, plain_paths(step, garment))
