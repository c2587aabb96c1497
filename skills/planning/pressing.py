"""Pressing a crease so that the fold lies flatter: dabs along the crease.

A fabric's internal friction holds bends (its hysteresis, 2HB of KES-F), so a crease that was pressed flat opens
less. Hands dab and do not stroke, because a sliding hand drags the upper layers along. One finger presses beside
the line and the other further in, at the same time: a bulge that is pressed only in its middle moves inwards.
Creases of earlier folds and edges are not pressed, because fingers there would turn corners up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skills.vocabulary import Array, FoldLine, GraspId, ToolPath, frozen

__all__ = ["OPENING", "Dab", "crease_dabs", "press_paths", "within_reach"]

OPENING = 0.030
"""Opening of the pads while they press [m]."""
FINGERS = 0.019
"""Distance from the middle of the open hand to the middle of a finger [m]."""
MOST = 12
"""Maximum number of dabs in one press."""
BAND = 0.060
"""Distance from the line within which raised cloth belongs to the crease [m]."""
INSET = 0.010
"""Distance from the line to the outer finger [m]."""
ROOM = 0.135
"""Minimum extent of the cloth from the line to the opposite edge [m]. A press on the crease of a smaller stack
would push the whole stack."""
PITCH = 0.045
"""Distance between dabs along the crease [m]."""
GRID = 0.005
"""Resolution along the crease [m]."""
CLEARANCE = 0.020
"""Height above the highest cloth between two dabs [m]."""
START = 0.080
"""Height above the highest cloth before the first dab [m]: the hand touches no cloth on its way there."""
ONE_HAND = 0.36
"""Extent of the dabs along y above which both hands share them [m]."""
SPEED, JERK = 0.3, 24.0
"""Maximum speed [m/s] and jerk [m/s3] of the hands. With larger values the arms would slow down the whole path."""
DWELL_S, TICK_S = 0.25, 0.02


@dataclass(frozen=True, eq=False)
class Dab:
    """One dab. point: (2,) under the middle of the hand, table frame. bottom: final height of the tips, with the
    layers flat [m]. high: height of the cloth above the flat stack [m]."""

    point: Array
    bottom: float
    high: float


def crease_dabs(
    places: Array,
    above: Array,
    line: FoldLine,
    flat: Callable[[Array], float],
    inside: Callable[[Array], bool],
    most: int = MOST,
) -> tuple[Dab, ...]:
    """Dabs where the last fold's crease, at `line`, stands high. The fingers lie across the crease.

    places: (k, 2) raised above the flat stack by above (k,) [m]. flat: height of the flat stack at a place (2,)
    [m]. inside: whether a place (2,) lies on the garment, clear of the edges at the ends of the crease.
    """
    beside = -line.signed_distance(places)
    crease = (beside >= 0.0) & (beside < BAND)
    along = np.unique(np.round((places[crease] - line.point) @ line.direction / GRID)) * GRID
    clear = np.array(
        [all(inside(_finger(line, s, inset)) for inset in (INSET + 2.0 * FINGERS, ROOM)) for s in along], bool
    )
    dabs = []
    for s in _spread(along[clear], most):
        fingers = [_finger(line, s, inset) for inset in (INSET, INSET + 2.0 * FINGERS)]
        near = crease & (np.abs((places - line.point) @ line.direction - s) < 0.5 * PITCH)
        high = float(above[near].max()) if near.any() else 0.0
        dabs.append(Dab(frozen(0.5 * (fingers[0] + fingers[1])), max(map(flat, fingers)), high))
    return tuple(dabs)


def within_reach(dabs: Sequence[Dab]) -> tuple[Dab, ...]:
    """The highest dab, and the other dabs that the same hand can make with it."""
    highest = max(dabs, key=lambda dab: dab.high)
    return tuple(dab for dab in dabs if abs(float(dab.point[1] - highest.point[1])) < 0.5 * ONE_HAND)


def press_paths(line: FoldLine, dabs: Sequence[Dab], highest: float) -> Mapping[GraspId, ToolPath]:
    """Tool paths over the dabs for one hand, or for two hands with common times. Each path begins high above its
    first dab.

    highest: height of the garment [m]. Two hands move in the same direction, each over its half. Without dabs the
    result is empty.
    """
    if not dabs:
        return {}
    across = sorted(dabs, key=lambda dab: float(dab.point[1]))
    span = float(across[-1].point[1] - across[0].point[1])
    if span > ONE_HAND:
        half = (len(across) + 1) // 2
        shares = {GraspId.RIGHT: across[:half], GraspId.LEFT: across[-half:]}
    else:
        along = line.direction if line.direction[1] >= 0.0 else -line.direction
        middle = float(np.mean([dab.point[1] for dab in dabs]))
        shares = {
            GraspId.LEFT if middle > 0.0 else GraspId.RIGHT: sorted(dabs, key=lambda dab: float(dab.point @ along))
        }
    heading = float(np.arctan2(line.direction[1], line.direction[0]))
    stops = {grasp_id: _stops(share, highest) for grasp_id, share in shares.items()}
    clock = [max(times) for times in zip(*(_times(points) for points in stops.values()), strict=True)]
    return {grasp_id: _path(points, clock, heading) for grasp_id, points in stops.items()}


def _spread(along: Array, most: int) -> Array:
    """Evenly spaced positions along a crease, PITCH apart or wider if `most` requires it, near any of along (k,)
    [m]."""
    if len(along) == 0:
        return along
    low, high = float(along.min()), float(along.max())
    if high - low < 0.5 * PITCH:
        return np.array([0.5 * (low + high)])
    spots = np.linspace(low, high, min(int(np.ceil((high - low) / PITCH)) + 1, most))
    apart = (high - low) / (len(spots) - 1)
    return spots[np.abs(spots[:, None] - along).min(axis=1) <= 0.5 * apart + 1e-9]


def _finger(line: FoldLine, along: float, inset: float) -> Array:
    """(2,) the point `along` the line from its point and `inset` inside it [m]."""
    return line.point + along * line.direction - inset * line.normal


def _stops(dabs: Sequence[Dab], highest: float) -> Array:
    """(1 + 4 k, 3) stops of a hand: high above the first dab, then for each of k dabs above, down, down (dwell)
    and above."""
    points = [[*dabs[0].point, highest + START]]
    for dab in dabs:
        over, on = [*dab.point, highest + CLEARANCE], [*dab.point, dab.bottom]
        points += [over, on, on, over]
    return np.array(points)


def _times(stops: Array) -> list[float]:
    """Durations of the legs between stops [s]. On a leg of length l and duration t, minimum jerk has a peak speed
    of 15/8 of the mean speed and a peak jerk of 60 l / t^3."""
    length = np.linalg.norm(np.diff(stops, axis=0), axis=1)
    return [max(DWELL_S, 1.875 * float(way) / SPEED, (60.0 * float(way) / JERK) ** (1 / 3)) for way in length]


def _path(stops: Array, clock: Sequence[float], heading: float) -> ToolPath:
    """Path through the stops, one leg for each duration of `clock` [s], with minimum jerk (Flash & Hogan 1985)."""
    t, position = [0.0], [stops[0]]
    for here, there, duration in zip(stops[:-1], stops[1:], clock, strict=True):
        q = np.linspace(0.0, 1.0, max(2, round(duration / TICK_S)) + 1)[1:]
        way = q**3 * (10.0 - 15.0 * q + 6.0 * q * q)
        position += list(here + way[:, None] * (there - here))
        t += list(t[-1] + q * duration)
    zero = np.zeros(len(t))
    return ToolPath(frozen(np.array(t)), frozen(np.array(position)), zero + heading, zero, zero)
