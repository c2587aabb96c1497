"""Makes the ideal folds of a garment of the simulated world, and keeps them in a folder."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.score_matrix import IdealGarment, in_own_frame
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.scoring.ideal import ideal_of
from foldcell.cell.support.files.packing import packed
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.scoring.score import named_edge_pairs
from foldcell.skills.scoring.verdict import IdealHeights
from foldcell.skills.vocabulary import Array


@dataclass(frozen=True, eq=False)
class IdealFolds:
    """The ideal folds of a garment. final: the last one, as the score needs it; folds: the vertices (n, 3) after
    each fold, in the garment's own frame [m]."""

    final: IdealGarment
    folds: tuple[Array, ...]


def ideal_folds_of(world: WorldGarment, seed: int, cache: Path | None = None) -> IdealFolds:
    """Make the ideal folds of a garment, or read them from the folder `cache` if they are there. seed: of the
    world; it names the file."""
    garment, plan = in_own_frame(world), load_garment(world.name)
    lines = ways_to_fold(plan, garment.keypoints)[0]
    pairs = named_edge_pairs(plan.edge_pairs, garment.keypoints)
    path = None if cache is None else cache / f"{world.name}_{seed}.npz"
    if path is not None and path.is_file():
        with np.load(path) as kept:
            vertices = kept["folds"]
            if vertices.shape[1] == len(garment.mesh.rest) and np.array_equal(kept["rest"], garment.mesh.rest):
                heights = IdealHeights(**json.loads(str(kept["heights"])))
                return IdealFolds(IdealGarment(garment, vertices[-1], lines, pairs, heights), tuple(vertices))
    folds, heights = ideal_of(garment, plan, lines)
    vertices = np.array([fold.vertices for fold in folds])
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(
            path, packed(folds=vertices, rest=garment.mesh.rest, heights=np.array(json.dumps(asdict(heights))))
        )
    return IdealFolds(IdealGarment(garment, vertices[-1], lines, pairs, heights), tuple(vertices))
