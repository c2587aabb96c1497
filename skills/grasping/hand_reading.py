"""What a grasping controller sees in one tick: one hand's sensors, with the moment of looking."""

from __future__ import annotations

import math
from dataclasses import dataclass

from robots.ports import GripperState, TactileReading
from skills.grasping.settings import GraspSettings
from skills.vocabulary import Array, Failure, FailureKind

__all__ = ["GripCommand", "HandReading", "fault"]


@dataclass(frozen=True, eq=False)
class HandReading:
    """One hand at one moment.

    stamp: cell time of the look [s]; the sensors' own stamps are at most that. height: of the tool centre point
    over the table, from the measured joints [m]. effort: (7,) of that arm's joints [Nm].
    """

    stamp: float
    tactile: TactileReading
    gripper: GripperState
    height: float
    effort: Array


@dataclass(frozen=True)
class GripCommand:
    """What the gripper shall do: pads `opening` apart [m], squeezing with at most `force` [N]."""

    opening: float
    force: float


def fault(reading: HandReading, settings: GraspSettings) -> Failure | None:
    """Why this reading cannot be acted on, or None."""
    for name, stamp, limit in (
        ("tactile cells", reading.tactile.stamp, settings.tactile_stale),
        ("gripper", reading.gripper.stamp, settings.gripper_stale),
    ):
        age = reading.stamp - stamp
        if not age <= limit:
            return Failure(
                FailureKind.STALE_STATE,
                f"the {reading.tactile.side} hand's {name} were read {age * 1e3:.0f} ms ago",
                "check the hand's connection",
                {"age_s": age, "limit_s": limit},
            )
    if not _finite(reading):
        return Failure(
            FailureKind.HARDWARE_FAULT,
            f"the {reading.tactile.side} hand's sensors give no numbers",
            "check the tactile cells and the gripper",
        )
    return None


def _finite(reading: HandReading) -> bool:
    # A sum is finite only if all of its terms are; it costs a fifth of testing each.
    numbers = reading.stamp + reading.height + reading.gripper.opening + reading.gripper.force
    return math.isfinite(numbers + reading.tactile.cells.sum() + reading.tactile.tip.sum() + reading.effort.sum())
