"""Judges recorded folds by the claim."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.claims.record import IDEAL, FoldRecord
from benchmarks.claims.stage import StageError, judge_shown, open_executive
from benchmarks.shipped_settings import INSPECTION
from foldcell.cell.executive.effects.inspecting import figures, next_step
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.ports import Ports, StopState
from foldcell.skills.perception.inspection.claim import Claim


@dataclass(frozen=True)
class Verdict:
    """What the executive says of a shape. bad: the figures of the score that it fails; claim: None if the picture
    could not be judged, with the reason in `says`. diagnosis: of the inspection; figures: of the inspection, by
    name."""

    garment: str
    seed: int
    kind: str
    variant: int
    bad: tuple[str, ...]
    claim: Claim | None
    diagnosis: str | None
    says: str
    figures: dict[str, float]

    @property
    def claimed(self) -> bool:
        return self.claim is not None and self.claim.holds

    @property
    def good(self) -> bool:
        return not self.bad


def verdicts(record: FoldRecord) -> Iterator[Verdict]:
    """Judge all shapes of a record, as the executive judges the last fold of a run."""
    with _executive(record.garment) as cell:
        done = record.planned[0].done
        for looked in record.looked:
            judged, _ = judge_shown(cell, replace(looked, done=done))
            done = next_step(cell, judged).context.done
        for shape, looked in record.last.items():
            yield _verdict(cell, record, shape, replace(looked, done=done))


def _verdict(cell: Workcell, record: FoldRecord, shape: tuple[str, int], looked: RunContext) -> Verdict:
    bad = record.failed[shape] or ((record.flaw,) if record.flaw and shape == IDEAL else ())
    try:
        judged, seen = judge_shown(cell, looked)
    except StageError as e:
        return Verdict(record.garment, record.seed, *shape, bad, None, None, e.what, {})
    claim = judged.fold.attempt.claim if judged.fold.attempt else None
    says = claim.says if claim else "no claim was made"
    diagnosis = None if seen.diagnosis is None else str(seen.diagnosis)
    return Verdict(record.garment, record.seed, *shape, bad, claim, diagnosis, says, figures(seen))


def caught_by(verdict: Verdict) -> tuple[str, ...]:
    """Return what the claim found wrong, in words; empty if it holds."""
    claim = verdict.claim
    if claim is None:
        return ("not visible",)
    limits = INSPECTION.claim
    found = {
        "overlap": claim.target_iou < limits.iou,
        "drift": claim.drift_m > limits.drift or claim.drift_rad > limits.drift_angle,
        "height": claim.height_m > claim.height_limit_m,
        "crease height": claim.crease_height_m > claim.crease_height_limit_m,
        "earlier fold": "not found good" in claim.says,
    }
    kept = None if claim.shape and claim.flat else verdict.diagnosis
    named = [name for name, wrong in found.items() if wrong]
    return tuple(named if kept in (None, "drift") else [kept, *named])


@contextmanager
def _executive(name: str) -> Iterator[Workcell]:
    with (
        tempfile.TemporaryDirectory(prefix="foldcell-claims-") as logs,
        open_executive(name, _still_ports(), Path(logs)) as cell,
    ):
        yield cell


class _Clock:
    def now(self) -> float:
        return 0.0

    def sleep_until(self, t: float) -> None: ...


class _NoStop:
    def trigger(self, reason: str) -> None: ...

    def state(self) -> StopState:
        return StopState(0.0, False)

    def reset(self) -> None: ...


def _still_ports() -> Ports:
    """Return the ports of a cell in which nothing happens any more: judging a picture needs a clock and a stop."""
    none: Any = None
    return Ports("sim", False, _Clock(), none, none, {}, {}, none, _NoStop(), none)
