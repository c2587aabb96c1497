"""Moves a set-point with limited jerk towards a goal that may move or jump, one control tick at a time
(Ruckig)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import ruckig

from foldcell.robots.errors import InternalError


@dataclass(frozen=True)
class JerkLimiter:
    """State of the set-point: position [m], velocity [m/s], acceleration [m/s2], or the same in radians."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


def step_towards(
    state: JerkLimiter,
    goal: float,
    goal_speed: float,
    dt: float,
    *,
    speed: float,
    acceleration: float,
    jerk: float,
) -> JerkLimiter:
    """Return the state dt [s] later, on the time-optimal motion to a goal at `goal` [m] that moves at
    `goal_speed` [m/s].

    speed, acceleration, jerk: limits [m/s], [m/s2], [m/s3]. Raises InternalError when Ruckig finds no motion, for
    values that are not finite, and for limits or a dt that are not above zero.
    """
    _validate(state, goal, goal_speed, dt, speed, acceleration, jerk)
    request = ruckig.InputParameter(1)
    request.current_position, request.current_velocity = [state.position], [state.velocity]
    request.current_acceleration = [state.acceleration]
    request.target_position, request.target_velocity = [goal], [max(-speed, min(speed, goal_speed))]
    request.max_velocity, request.max_acceleration, request.max_jerk = [speed], [acceleration], [jerk]
    result = ruckig.Trajectory(1)
    try:
        code = ruckig.Ruckig(1).calculate(request, result)
    except ruckig.RuckigError as e:
        raise _no_motion(state, goal, "its numbers are too large or too small") from e
    if code not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise _no_motion(state, goal, str(code))
    position, velocity, new_acceleration = (x[0] for x in result.at_time(dt)[:3])
    return JerkLimiter(position, velocity, new_acceleration)


def _validate(
    state: JerkLimiter, goal: float, goal_speed: float, dt: float, speed: float, acceleration: float, jerk: float
) -> None:
    positive = {"dt": dt, "speed": speed, "acceleration": acceleration, "jerk": jerk}
    values = {**asdict(state), "goal": goal, "goal_speed": goal_speed, **positive}
    for name, value in values.items():
        if not math.isfinite(value) or (name in positive and value <= 0.0):
            raise InternalError(
                f"a set-point cannot follow its goal with {name} = {value}", "report this: a bug", **values
            )


def _no_motion(state: JerkLimiter, goal: float, why: str) -> InternalError:
    return InternalError(
        f"Ruckig found no motion from {state.position:g} to {goal:g}: {why}",
        "report this: a bug",
        position=state.position,
        goal=goal,
    )
