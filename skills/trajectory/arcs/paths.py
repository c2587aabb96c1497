"""Timed tool paths, computed from Bezier control points for the simulation and for the arms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from foldcell.skills.trajectory.arcs.bezier import arc_lengths, evaluate
from foldcell.skills.vocabulary import Array, FoldStep, GraspId, GraspTrajectory, ToolPath, frozen

TOOL_ACCELERATION = 0.8
"""Peak acceleration of the tool along a fold [m/s2]. It is small because a jerky motion pulls at the cloth; the
paper names this as the cause of drift."""

RATE = 100.0
"""Samples of a tool path per second [Hz]."""

LIFT_HEIGHT, LIFT_SPEED = 0.03, 0.04
"""Height [m] and speed [m/s] of the straight lift that confirms a grasp before the arc begins."""


@dataclass(frozen=True)
class SpeedLaw:
    """Distance travelled along a path as a function of time: from rest to rest, with smooth ramps and constant
    speed between them.

    length [m]; top: highest speed [m/s]; ramp: duration of each ramp [s]. The speed in a ramp is top (3 r^2 - 2
    r^3), r in 0..1, so acceleration is continuous and peaks at 1.5 top / ramp.
    """

    length: float
    top: float
    ramp: float

    @classmethod
    def fastest(cls, length: float, max_speed: float) -> SpeedLaw:
        """Return the fastest law up to max_speed and TOOL_ACCELERATION; on a short path, it does not reach
        `max_speed`."""
        top = min(max_speed, float(np.sqrt(TOOL_ACCELERATION * length / 1.5)))
        return cls(length, top, 1.5 * top / TOOL_ACCELERATION)

    @classmethod
    def lasting(cls, length: float, duration: float) -> SpeedLaw:
        """Return the law of a given duration with ramps at TOOL_ACCELERATION (steeper if the duration requires
        it)."""
        # duration = ramp + length / top, with ramp = k top; the smaller root is the gentler speed
        k = 1.5 / TOOL_ACCELERATION
        root = duration**2 - 4 * k * length
        top = (duration - np.sqrt(root)) / (2 * k) if root > 0 else 2 * length / duration
        return cls(length, float(top), duration - length / float(top))

    @property
    def duration(self) -> float:
        return self.ramp + self.length / self.top

    def distance(self, t: Array) -> Array:
        """(n,) distance travelled [m] at times (n,) [s], clamped to the ends."""
        t = np.clip(np.asarray(t, dtype=float), 0.0, self.duration)

        def ramped(dt: Array) -> Array:
            r = np.clip(dt / self.ramp, 0.0, 1.0)
            return self.top * self.ramp * (r**3 - r**4 / 2)

        level = self.top * np.clip(t - self.ramp, 0.0, self.duration - 2 * self.ramp)
        slowing = self.top * self.ramp / 2 - ramped(self.duration - t)
        return ramped(t) + level + np.where(t > self.duration - self.ramp, slowing, 0.0)


def fold_duration(controls: Mapping[GraspId, Array], max_speed: float) -> float:
    """Return the least duration [s] of a fold along these arcs; the longest arc determines it."""
    longest = max(arc_lengths(c)[1][-1] for c in controls.values())
    return SpeedLaw.fastest(float(longest), max_speed).duration


def tool_paths(
    trajectory: GraspTrajectory,
    step: FoldStep,
    max_speed: float | None = None,
) -> dict[GraspId, ToolPath]:
    """Return the timed tool paths of a trajectory, parametrised by arc length, with common times.

    The motion takes trajectory.duration [s], or longer if `max_speed` [m/s] requires it. The tool keeps the
    heading of its grasp, and points straight down. The path begins at the grasp and ends at the release.
    """
    duration = trajectory.duration
    if max_speed is not None:
        duration = max(duration, fold_duration(trajectory.control_points, max_speed))
    headings = {grasp_id: grasp.heading for grasp_id, grasp in step.grasps.items()}
    return fold_paths(trajectory.control_points, headings, duration)


def fold_paths(
    controls: Mapping[GraspId, Array], headings: Mapping[GraspId, float], duration: float
) -> dict[GraspId, ToolPath]:
    """Return the same as `tool_paths`, from control points (n + 1, 3) and headings [rad]."""
    t = np.linspace(0.0, duration, max(2, int(np.ceil(duration * RATE)) + 1))
    share = _share_travelled(controls, duration, t)
    paths = {}
    for grasp_id, control in controls.items():
        u, s = arc_lengths(control)
        position = evaluate(control, np.interp(share * s[-1], s, u))
        position[0], position[-1] = control[0], control[-1]
        heading, level = frozen(np.full(len(t), headings[grasp_id])), frozen(np.zeros(len(t)))
        paths[grasp_id] = ToolPath(frozen(t), frozen(position), heading, level, level)
    return paths


def _share_travelled(controls: Mapping[GraspId, Array], duration: float, t: Array) -> Array:
    """Return (n,): the share of its arc that each tool has covered at times t. All tools use the speed law of the
    longest arc, stretched to the duration."""
    longest = max(float(arc_lengths(c)[1][-1]) for c in controls.values())
    return SpeedLaw.lasting(longest, duration).distance(t) / longest


def lifted(path: ToolPath, height: float) -> ToolPath:
    """Return the path of a straight lift by `height` [m], followed by the arc of `path`. The lift raises the start
    of the arc; this offset fades along the arc.

    Both the arms and the simulation use this path, because the lift changes the result: it pulls the cloth taut
    where the cloth lies, and without it a fold may end centimetres elsewhere.
    """
    if height <= 0.0:
        return path
    fade = np.linspace(1.0, 0.0, len(path.t))
    fade = fade**2 * (3 - 2 * fade)
    return after_lift(replace(path, position=frozen(path.position + np.outer(fade, (0.0, 0.0, height)))), height)


def after_lift(path: ToolPath, height: float) -> ToolPath:
    """Return `path`, preceded by a straight lift by `height` [m] that ends at its start."""
    if height <= 0.0:
        return path
    law = SpeedLaw.fastest(height, LIFT_SPEED)
    n = max(2, int(np.ceil(law.duration * RATE)))
    up = np.linspace(0.0, law.duration, n, endpoint=False)
    start = path.position[0] + np.outer(law.distance(up) - height, (0.0, 0.0, 1.0))

    def held(x: Array) -> Array:
        return np.concatenate([np.full(n, x[0]), x])

    return ToolPath(
        t=frozen(np.concatenate([up, law.duration + path.t])),
        position=frozen(np.vstack([start, path.position])),
        heading=frozen(held(path.heading)),
        pitch=frozen(held(path.pitch)),
        roll=frozen(held(path.roll)),
    )
