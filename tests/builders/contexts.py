"""Run contexts for tests. A test names only the values that it is about."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import RunContext, Sight
from foldcell.cell.states.stages import Attempt, Plan, Recognition
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.vocabulary import GarmentState

_NOTHING_PLANNED: dict[str, Any] = {
    "garment": SimpleNamespace(plan=[SimpleNamespace(variants=())] * 9, material=SimpleNamespace(thickness=0.002)),
    "flat": GarmentState("towel", np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]), {}, 1.0),
    "steps": (),
    "mesh": mesh_from_contour(np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]), 0.04),
    "vertices": np.zeros((0, 3)),
}


def context_with(before: RunContext | None = None, **changes: Any) -> RunContext:
    """A context with these values. Each value goes into the part that has a field of this name: `carried=True`
    into the attempt.

    before: a context that supplies all other values. Without it, they are stand-ins.
    """
    context = before or RunContext()
    sight, recognition = _taken(Sight, changes), _taken(Recognition, changes)
    attempt = _taken(Attempt, changes, but=("trajectory",))
    plan, fold = _taken(Plan, changes), _taken(FoldContext, changes)
    if recognition:
        nothing = {"perception": None, "overlay": None}
        changes["recognition"] = _with(Recognition, context.recognition, nothing, recognition)
    if plan:
        plan.setdefault("nominal", context.plan.nominal if context.plan else plan.get("garment", None))
        changes["plan"] = _with(Plan, context.plan, _NOTHING_PLANNED, plan)
    if attempt:
        fold["attempt"] = _with(Attempt, context.fold.attempt, _stand_in(context, changes, fold), attempt)
    return replace(context, sight=replace(context.sight, **sight), fold=replace(context.fold, **fold), **changes)


def _taken(kind: Any, changes: dict[str, Any], but: tuple[str, ...] = ()) -> dict[str, Any]:
    names = {f.name for f in fields(kind)} & changes.keys() - set(but)
    return {name: changes.pop(name) for name in names}


def _with(kind: Any, before: Any, stand_in: dict[str, Any], changes: dict[str, Any]) -> Any:
    return replace(before, **changes) if before is not None else kind(**{**stand_in, **changes})


def _stand_in(context: RunContext, changes: dict[str, Any], fold: dict[str, Any]) -> dict[str, Any]:
    """Stand-in values of an attempt at the current step."""
    plan, index = changes.get("plan", context.plan), fold.get("index", context.fold.index)
    return {
        "trajectory": fold.get("trajectory", SimpleNamespace(source="library")),
        "step": plan.steps[index] if plan and plan.steps else SimpleNamespace(name="half"),
        "paths": {},
        "tool_speed": 0.3,
        "motion": SimpleNamespace(fold=SimpleNamespace(duration=2.0), tool_paths={}, postures={}, duration=12.0),
        "predicted": SimpleNamespace(vertices=np.zeros((1, 3)), triangles=np.zeros((0, 3), np.int32)),
        "dissimilarity_m": 0.004,
        "plan_frames": None,
    }
