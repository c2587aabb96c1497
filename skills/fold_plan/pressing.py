"""Plans the pressing of a crease, which makes the fold flatter: the hands dab along the crease.

A fabric's internal friction holds bends (its hysteresis, 2HB of KES-F), so a crease that was pressed flat opens
less. Hands dab and do not stroke, because a sliding hand drags the upper layers along. One finger presses beside
the line and the other further in, at the same time: a bulge that is pressed only in its middle moves inwards. The
creases of earlier folds, and edges, are not pressed, because fingers there would turn corners up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.skills.vocabulary import Array, FoldLine, GraspId, ToolPath, frozen

OPENING = 0.030
"""Opening of the pads while they press [m]."""
FINGERS = 0.019
"""Distance from the middle of the open hand to the middle of a finger [m]."""
MOST = 12
"""Maximum number of dabs on one crease."""
BAND = 0.060
"""Distance from the line within which raised cloth belongs to the crease [m]."""
INSET = 0.010
"""Distance of the nearer finger from the fold line [m]."""
ROOM = 0.100
"""Minimum extent of the cloth from the line inwards [m]. A hand that presses the crease of a smaller stack would
push the whole stack away."""
PITCH = 0.045
"""Distance between dabs along the crease [m]."""
GRID = 0.005
"""Resolution of positions along the crease [m]."""
CLEARANCE = 0.020
"""Height of the hand above the highest cloth on its way from one dab to the next [m]."""
START = 0.080
"""Height of the hand above the highest cloth at the start of its path [m]. It is so large that the hand touches no
cloth on its way to the start."""
ONE_HAND = 0.36
"""If the dabs extend further than this along y, both hands share them; otherwise one hand makes them all [m]."""
SPEED, JERK = 0.3, 24.0
"""Maximum speed [m/s] and jerk [m/s3] of the hands. Larger values would exceed the arms' limits, and the planner
would then slow down the whole path."""
DWELL_S, TICK_S = 0.25, 0.02
LONGEST_S = 5.4
"""Longest duration of the path over the dabs [s]. The arms' limits slow it down by a sixth. With the way to its
start the pressing takes at most 8 s."""


@dataclass(frozen=True, eq=False)
class Dab:
    """One contact of a hand with the cloth. point: (2,) under the middle of the hand, table frame [m]. bottom:
    lowest height of the tips, at which the layers are flat [m]. high: height of the cloth above the flat
    stack [m]."""

    point: Array
    bottom: float
    high: float


def crease_dabs(
    places: Array,
    above: Array,
    line: FoldLine,
    flat: Callable[[Array], float],
    inside: Callable[[Array], bool],
) -> tuple[Dab, ...]:
    """Plan dabs where the crease of the last fold, at `line`, stands high. The two fingers lie across the crease.

    places: (k, 2) places where the cloth is higher than the flat stack [m]. above: (k,) how much higher it is [m].
    flat: function that returns the height of the flat stack at a place (2,) [m]. inside: function that returns
    whether a place (2,) lies on the garment, away from its edges.
    """
    beside = -line.signed_distance(places)
    crease = (beside >= 0.0) & (beside < BAND)
    along = np.unique(np.round((places[crease] - line.point) @ line.direction / GRID)) * GRID
    clear = np.array(
        [all(inside(_finger(line, s, inset)) for inset in (INSET + 2.0 * FINGERS, ROOM)) for s in along], bool
    )
    dabs = []
    for s in _spread(along[clear]):
        fingers = [_finger(line, s, inset) for inset in (INSET, INSET + 2.0 * FINGERS)]
        near = crease & (np.abs((places - line.point) @ line.direction - s) < 0.5 * PITCH)
        high = float(above[near].max()) if near.any() else 0.0
        dabs.append(Dab(frozen(0.5 * (fingers[0] + fingers[1])), max(map(flat, fingers)), high))
    return tuple(dabs)


def within_reach(dabs: Sequence[Dab]) -> tuple[Dab, ...]:
    """Return the dab at the highest cloth, and the dabs near it that the same hand can make."""
    highest = max(dabs, key=lambda dab: dab.high)
    return tuple(dab for dab in dabs if abs(float(dab.point[1] - highest.point[1])) < 0.5 * ONE_HAND)


def within_time(line: FoldLine, dabs: Sequence[Dab], highest: float) -> tuple[Dab, ...]:
    """Return the dabs, or as many of them at the highest cloth as the hands make in LONGEST_S, but at least one,
    in the given order. highest: height of the garment [m]."""
    ranked = sorted(dabs, key=lambda dab: dab.high, reverse=True)
    for count in range(len(ranked), 1, -1):
        kept = tuple(dab for dab in dabs if dab in ranked[:count])
        if all(path.t[-1] <= LONGEST_S for path in press_paths(line, kept, highest).values()):
            return kept
    return tuple(ranked[:1])


def press_paths(line: FoldLine, dabs: Sequence[Dab], highest: float) -> Mapping[GraspId, ToolPath]:
    """Compute the tool paths over the dabs, for one hand or for two hands that move simultaneously. Each path
    begins START above the garment, over its first dab.

    highest: height of the garment [m]. Two hands move in the same direction, each over its half of the dabs.
    Without dabs the result is empty.
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


def _spread(along: Array) -> Array:
    """Choose evenly spaced positions along a crease: PITCH apart, or farther apart if PITCH would give more than
    MOST positions. Only positions near one of the raised places along (k,) [m] are returned."""
    if len(along) == 0:
        return along
    low, high = float(along.min()), float(along.max())
    if high - low < 0.5 * PITCH:
        return np.array([0.5 * (low + high)])
    spots = np.linspace(low, high, min(int(np.ceil((high - low) / PITCH)) + 1, MOST))
    apart = (high - low) / (len(spots) - 1)
    return spots[np.abs(spots[:, None] - along).min(axis=1) <= 0.5 * apart + 1e-9]


def _finger(line: FoldLine, along: float, inset: float) -> Array:
    """Return the place (2,) of a finger: `along` [m] from the line's point, and `inset` [m] from the line into the
    folded garment."""
    return line.point + along * line.direction - inset * line.normal


def _stops(dabs: Sequence[Dab], highest: float) -> Array:
    """Return the stops (1 + 4 k, 3) of a hand [m]: high above the first dab, then four for each of the k dabs:
    above, down, down again (the hand stays for DWELL_S) and above."""
    points = [[*dabs[0].point, highest + START]]
    for dab in dabs:
        over, on = [*dab.point, highest + CLEARANCE], [*dab.point, dab.bottom]
        points += [over, on, on, over]
    return np.array(points)


def _times(stops: Array) -> list[float]:
    """Compute the durations of the segments between stops [s]. On a segment of length l and duration t, a
    minimum-jerk motion has a peak speed of 15/8 of the mean speed and a peak jerk of 60 l / t^3."""
    length = np.linalg.norm(np.diff(stops, axis=0), axis=1)
    return [max(DWELL_S, 1.875 * float(way) / SPEED, (60.0 * float(way) / JERK) ** (1 / 3)) for way in length]


def _path(stops: Array, clock: Sequence[float], heading: float) -> ToolPath:
    """Compute the path through the stops, with minimum jerk (Flash & Hogan 1985). clock: durations of the
    segments [s]."""
    t, position = [0.0], [stops[0]]
    for here, there, duration in zip(stops[:-1], stops[1:], clock, strict=True):
        q = np.linspace(0.0, 1.0, max(2, round(duration / TICK_S)) + 1)[1:]
        way = q**3 * (10.0 - 15.0 * q + 6.0 * q * q)
        position += list(here + way[:, None] * (there - here))
        t += list(t[-1] + q * duration)
    zero = np.zeros(len(t))
    return ToolPath(frozen(np.array(t)), frozen(np.array(position)), zero + heading, zero, zero)
