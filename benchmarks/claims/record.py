"""Records what the executive sees of a garment's ideal and spoiled folds, and keeps it in a folder.

A record has the pictures, and the executive's knowledge before it judges each fold. It does not depend on how
folds are judged, so that another way to judge them costs no new pictures. It has to be made anew if the world, the
camera, the recognition, the planning or the prediction changes.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.claims.ideals import ideal_folds_of
from benchmarks.claims.stage import Stage, open_stage
from benchmarks.score_matrix import KINDS, OTHER_KINDS, judged, spoiled
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.support.files.whole_file import write_whole

IDEAL = ("ideal", 0)
VARIANTS = ((*IDEAL,), *((kind, k) for kind in KINDS for k in (0, 1)), *((kind, 0) for kind in OTHER_KINDS))
"""Shapes that are shown: the ideal fold, and the kinds of spoiled folds with their variants."""


@dataclass(frozen=True, eq=False)
class FoldRecord:
    """The folds of one garment.

    planned: the executive's knowledge after it planned each fold; looked: the same with the picture of its
    outcome, for each fold but the last. last: shape -> the same with a picture of this outcome of the last
    fold. failed: shape -> names of the figures of the score that it fails. flaw: why the ideal fold is not
    valid, or None. bending_length: of the true fabric [m].
    """

    garment: str
    seed: int
    planned: tuple[RunContext, ...]
    looked: tuple[RunContext, ...]
    last: Mapping[tuple[str, int], RunContext]
    failed: Mapping[tuple[str, int], tuple[str, ...]]
    flaw: str | None
    bending_length: float


def recorded(name: str, seed: int, cache: Path) -> FoldRecord:
    """Return the record of a garment, from the folder `cache` if it is there. Raises StageError."""
    path = cache / "records" / f"{name}_{seed}.pickle"
    if path.is_file():
        return pickle.loads(path.read_bytes())
    with (
        tempfile.TemporaryDirectory(prefix="foldcell-claims-") as logs,
        open_stage(name, seed, Path(logs)) as stage,
    ):
        record = _record(name, seed, stage, cache)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, pickle.dumps(record))
    return record


def _record(name: str, seed: int, stage: Stage, cache: Path) -> FoldRecord:
    ideal = ideal_folds_of(stage.world.garment, seed, cache / "ideals")
    stage.recognise()
    planned, looked = [], []
    for vertices in ideal.folds[:-1]:
        stage.predict()
        planned.append(stage.context)
        looked.append(stage.show(vertices))
        stage.accept(looked[-1])
    stage.predict()
    planned.append(stage.context)
    last, failed = {}, {}
    for kind, variant in VARIANTS:
        x = ideal.final.vertices if (kind, variant) == IDEAL else spoiled(ideal.final, kind, variant)
        last[kind, variant] = stage.show(x)
        failed[kind, variant] = judged(ideal.final, x).failed
    heights, fabric = ideal.final.heights, ideal.final.garment.fabric
    return FoldRecord(name, seed, tuple(planned), tuple(looked), last, failed, heights.flaw, fabric.bending_length)
