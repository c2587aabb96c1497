"""Tells a live tactile pad from a dead one: the readings of a live pad have noise, those of a dead one have none.

A pad that is unplugged, stuck or saturated gives the same numbers again and again, with fresh stamps. It would
feel neither the table nor the cloth, so it has to be found before a hand relies on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from foldcell.robots.ports import Side
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.vocabulary import Array, Failed, Failure, FailureKind

LIVE_READINGS = 10
"""Number of readings by which a pad that became constant during a fold is found."""

_NAMES = ("first", "second")


def dead_pad(side: Side, readings: Array, settings: GraspSettings, part: str = "pad") -> Failure | None:
    """Return TACTILE_FAULT if one pad of a hand gives constant readings, else None.

    readings: (n, 2) or (n, 2, rows, columns) successive readings of both pads [N], n >= 2. A pad is alive if any
    of its values varies by `settings.live_noise`. part: name of the sensor's part, for the message.
    """
    stack = np.asarray(readings)
    noise = stack.std(axis=0).reshape(2, -1).max(axis=1)
    dead = int(np.argmin(noise))
    if not noise[dead] < settings.live_noise:
        return None
    return _failure(side, dead, part, float(np.abs(stack[-1, dead]).max()), len(stack), settings)


@dataclass(frozen=True)
class ConstantPads:
    """How long each pad's force has been constant. forces: of the last reading on both pads [N]; counts: number of
    readings since each changed."""

    forces: tuple[float, ...] = ()
    counts: tuple[int, ...] = (0, 0)


def watch_pads(side: Side, forces: Array, state: ConstantPads, settings: GraspSettings) -> ConstantPads:
    """Process the forces (2,) of one reading on both pads [N]. Raises Failed (TACTILE_FAULT) once a pad has given
    the same force in `LIVE_READINGS` readings."""
    now = tuple(forces.tolist())
    if not state.forces:
        return replace(state, forces=now)
    pairs = zip(now, state.forces, state.counts, strict=True)
    counts = tuple(count + 1 if abs(a - b) < settings.live_noise else 0 for a, b, count in pairs)
    worst = max(counts)
    if worst >= LIVE_READINGS:
        dead = counts.index(worst)
        raise Failed(_failure(side, dead, "pad", now[dead], worst, settings))
    return ConstantPads(now, counts)


def _failure(side: Side, pad: int, part: str, force: float, times: int, settings: GraspSettings) -> Failure:
    return Failure(
        FailureKind.TACTILE_FAULT,
        f"the {side} hand's {_NAMES[pad]} {part} gives {force:.2f} N {times} times in a row: it feels nothing",
        "check the cable and the board of this hand's tactile cells",
        {"force_n": force, "readings": times, "live_noise_n": settings.live_noise},
    )
