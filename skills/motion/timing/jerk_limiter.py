"""A jerk-limited set-point that follows a moving or jumping goal, one control tick at a time (Ruckig)."""

from __future__ import annotations

from dataclasses import dataclass

import ruckig

from robots.errors import InternalError

__all__ = ["JerkLimiter", "step_towards"]


@dataclass(frozen=True)
class JerkLimiter:
    """State of the set-point: [m], [m/s], [m/s2], or the same in radians."""

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
    """The state dt [s] later, on the time-optimal motion to a goal at `goal` [m] that moves at `goal_speed` [m/s].

    speed, acceleration, jerk: limits [m/s], [m/s2], [m/s3]. Raises InternalError when Ruckig finds no motion.
    """
    request = ruckig.InputParameter(1)
    request.current_position, request.current_velocity = [state.position], [state.velocity]
    request.current_acceleration = [state.acceleration]
    request.target_position, request.target_velocity = [goal], [max(-speed, min(speed, goal_speed))]
    request.max_velocity, request.max_acceleration, request.max_jerk = [speed], [acceleration], [jerk]
    result = ruckig.Trajectory(1)
    code = ruckig.Ruckig(1).calculate(request, result)
    if code not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise InternalError(f"Ruckig found no motion to the goal: {code}", position=state.position, goal=goal)
    position, velocity, new_acceleration = (x[0] for x in result.at_time(dt)[:3])
    return JerkLimiter(position, velocity, new_acceleration)
