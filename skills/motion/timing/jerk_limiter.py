"""Following a goal that moves or jumps, with bounded speed, acceleration and jerk: one tick at a time (Ruckig)."""

from __future__ import annotations

from dataclasses import dataclass

import ruckig

from robots.errors import InternalError

__all__ = ["JerkLimiter", "follow"]


@dataclass(frozen=True)
class JerkLimiter:
    """Where a followed coordinate is, and how it moves: [m], [m/s], [m/s2], or in radians."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


def follow(
    state: JerkLimiter,
    goal: float,
    goal_speed: float,
    dt: float,
    *,
    speed: float,
    acceleration: float,
    jerk: float,
) -> JerkLimiter:
    """`state` dt [s] later, on the fastest way to a goal that now stands at `goal` and moves at `goal_speed`."""
    order = ruckig.InputParameter(1)
    order.current_position, order.current_velocity = [state.position], [state.velocity]
    order.current_acceleration = [state.acceleration]
    order.target_position, order.target_velocity = [goal], [max(-speed, min(speed, goal_speed))]
    order.max_velocity, order.max_acceleration, order.max_jerk = [speed], [acceleration], [jerk]
    result = ruckig.Trajectory(1)
    code = ruckig.Ruckig(1).calculate(order, result)
    if code not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise InternalError(f"Ruckig refused to follow a goal: {code}", position=state.position, goal=goal)
    position, velocity, change = (x[0] for x in result.at_time(dt)[:3])
    return JerkLimiter(position, velocity, change)
