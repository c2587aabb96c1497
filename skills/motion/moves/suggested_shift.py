"""Finds a shift of the garment that makes an infeasible fold feasible."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from foldcell.robots.errors import Failure
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, frozen
from foldcell.skills.motion.moves.posture_search import rank_postures
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import GraspId, Table, ToolPath

__all__ = ["with_shift_suggestion"]

SHIFTS = (0.06, 0.15)
"""Lengths of the shifts that are tried in turn, each along x and along y, towards the table's middle [m]."""


def with_shift_suggestion(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    failure: Failure,
    *,
    above: float,
    below: float,
) -> Failure:
    """Return the same failure, with a shift of the garment that makes the fold feasible, if one of SHIFTS does.

    The hint describes the shift. values["shift_m"]: (2,) in the table frame, None when no shift helps. The search
    takes up to four posture searches. If the arms block each other, no shift is tried, because they would block
    each other wherever the garment lies.
    """
    if failure.values.get("binding", {}).get("constraint") == "arms":
        return failure
    for shift in _candidate_shifts(table, paths, failure):
        moved = {i: replace(p, position=frozen(p.position + np.append(shift, 0.0))) for i, p in paths.items()}
        if rank_postures(model, checker, table, moved, q_now, above=above, below=below).ok:
            values = {**failure.values, "shift_m": shift.tolist()}
            return replace(failure, hint=f"lay the garment {_describe(shift)}", values=values)
    none_helps = f"no shift of up to {max(SHIFTS) * 1e3:.0f} mm towards the table's middle would help"
    return replace(failure, hint=f"{failure.hint}; {none_helps}", values={**failure.values, "shift_m": None})


def _candidate_shifts(table: Table, paths: Mapping[GraspId, ToolPath], failure: Failure) -> Iterator[Array]:
    """Yield shifts (2,) [m] that move the place which no arm reached towards the table's middle. If the failure
    states no such place, the shifts move the middle of the tool paths."""
    place = failure.values.get("binding", {}).get("where_m", [])[:2]
    if not place:
        place = np.mean([p.position[:, :2].mean(axis=0) for p in paths.values()], axis=0)
    gap = np.array([sum(table.x) / 2, sum(table.y) / 2]) - place
    for size in SHIFTS:
        for axis in np.argsort(-np.abs(gap)):
            yield size * (1.0 if gap[axis] >= 0.0 else -1.0) * np.eye(2)[axis]


def _describe(shift: Array) -> str:
    length = f"{np.abs(shift).max() * 1e3:.0f} mm"
    if shift[0]:
        return f"{length} {'further from' if shift[0] > 0 else 'nearer to'} the robot"
    return f"{length} to the robot's {'left' if shift[1] > 0 else 'right'}"
