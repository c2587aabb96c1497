"""Failures of the planners: invalid inputs (values that are not finite, times that do not increase, joints outside
their ranges), and motions that are out of reach or in collision."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.skills.motion.timing.timing import LONGEST_MOTION
from foldcell.skills.vocabulary import GraspId, Table, ToolPath

HIGHEST = 3.0
"""Maximum height of a lift or an approach [m]. No arm reaches as high."""


def validate_state(model: RobotModel, q: Array) -> Failure | None:
    """Return STALE_STATE (the arms' state is not known) when q (joints,) has another shape or is not finite, else
    None."""
    if np.shape(q) == model.q_park.shape and np.all(np.isfinite(q)):
        return None
    return Failure(
        FailureKind.STALE_STATE,
        f"the arms' state is not a vector of {len(model.joint_names)} finite numbers{_offending_value(model, q)}",
        "check the joint encoders and the connection to the robot",
        {"shape": list(np.shape(q))},
    )


def validate_goal(model: RobotModel, q: Array, q_now: Array) -> Failure | None:
    """Return LIMIT_EXCEEDED when q (joints,) has another shape, is not finite or is outside the planning range,
    else None.

    If a joint in q_now (joints,) is already outside the range, it may stay as far outside.
    """
    if np.shape(q) != model.q_park.shape or not np.all(np.isfinite(q)):
        return Failure(
            FailureKind.LIMIT_EXCEEDED,
            f"the goal is not a vector of {len(model.joint_names)} finite numbers{_offending_value(model, q)}",
            "report this: a bug",
        )
    lower, upper = np.minimum(model.planning.lower, q_now), np.maximum(model.planning.upper, q_now)
    over = np.maximum(lower - q, q - upper)
    joint = int(over.argmax())
    if over[joint] <= 1e-6:
        return None
    return Failure(
        FailureKind.LIMIT_EXCEEDED,
        f"the goal has {model.joint_names[joint]} {over[joint]:.3f} rad outside its range",
        "choose a goal within the joints' ranges",
        {"joint": model.joint_names[joint], "over_rad": float(over[joint])},
    )


def validate_paths(paths: Mapping[GraspId, ToolPath]) -> Failure | None:
    """Return UNREACHABLE when a tool path has values that are not finite or times that do not increase, or when it
    takes longer than LONGEST_MOTION; else None."""
    for grasp_id, path in paths.items():
        fields = (path.t, path.position, path.heading, path.pitch, path.roll)
        if not all(np.all(np.isfinite(a)) for a in fields):
            what = "has values that are not finite"
        elif len(path.t) < 2 or np.diff(path.t).min() <= 0.0:
            what = "has times that do not increase"
        elif path.t[-1] - path.t[0] > LONGEST_MOTION:
            what = f"takes {path.t[-1] - path.t[0]:.4g} s; the longest motion takes {LONGEST_MOTION:.0f} s"
        else:
            continue
        return Failure(
            FailureKind.UNREACHABLE,
            f"the tool path of the {grasp_id} grasp {what}",
            "look again at the garment; report this if it repeats",
            {"side": str(grasp_id)},
        )
    return None


def validate_height(height: float) -> Failure | None:
    """Return LIMIT_EXCEEDED when the height of a lift or an approach is negative, above HIGHEST, or not finite,
    else None."""
    if 0.0 <= height <= HIGHEST:
        return None
    return Failure(
        FailureKind.LIMIT_EXCEEDED,
        f"a hand cannot be raised or lowered by {height} m",
        f"give a height from 0 to {HIGHEST:g} m",
        {"height_m": float(height) if np.isfinite(height) else None},
    )


def validate_tool_speed(speed: float | None) -> Failure | None:
    """Return LIMIT_EXCEEDED when the maximum speed of the tools [m/s] is not above zero, or not a number, else
    None. A speed of None is valid: the speed is then not limited."""
    if speed is None or speed > 0.0:
        return None
    return Failure(
        FailureKind.LIMIT_EXCEEDED,
        f"the tools cannot move at {speed} m/s",
        "give a tool speed above zero",
        {"speed_m_s": float(speed) if np.isfinite(speed) else None},
    )


def _offending_value(model: RobotModel, q: Array) -> str:
    if np.shape(q) != model.q_park.shape:
        return f" (its shape is {np.shape(q)})"
    return f" ({model.joint_names[int(np.flatnonzero(~np.isfinite(q))[0])]} is {q[~np.isfinite(q)][0]})"


def out_of_reach(table: Table, side: Side, what: str, point: Array) -> Failure:
    """Create the failure UNREACHABLE: an arm cannot reach `point` (3,) [m], base frame. what: the part of the
    motion, in words."""
    where = [round(float(x), 3) for x in point - np.array([0.0, 0.0, table.height])]
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} arm does not reach {what} at {where} (table frame, m)",
        "lay the garment nearer to the middle of the table",
        {"side": str(side), "where_m": where},
    )


def too_near(what: str, pair: str) -> Failure:
    """Create the failure IN_COLLISION: two bodies are nearer than allowed. what: the part of the motion, in words.
    pair: the bodies' names."""
    return Failure(
        FailureKind.IN_COLLISION,
        f"{what} is in collision: {pair}",
        "grasp further apart, or with another lean",
        {"pair": pair},
    )
