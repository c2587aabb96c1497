"""What is known of the fold at hand. Each fold begins with a new one: nothing of the fold before is left in it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cell.states.recovery_table import Adjustment
from cell.states.stages import Attempt
from cell.states.step_note import StepNote
from robots.ports import Side
from skills.grasping.confirm import Held
from skills.grasping.tare import TactileBias
from skills.motion.kinematics.posture import Posture
from skills.vocabulary import GraspTrajectory

__all__ = ["FoldContext"]


@dataclass(frozen=True, eq=False)
class FoldContext:
    """index: of the step under way. trajectory: the arcs that were chosen; attempt: the try planned last."""

    index: int = 0
    trajectory: GraspTrajectory | None = None
    attempt: Attempt | None = None
    grasps: int = 0
    """How often the hands went to take hold."""
    adjustments: tuple[Adjustment, ...] = ()
    """What recoveries changed, in order."""
    avoided: tuple[Mapping[Side, Posture], ...] = ()
    """Hand postures that were tried: another search leaves them out."""
    biases: Mapping[Side, TactileBias] = field(default_factory=dict)
    """The tactile cells' zero of each hand in use, taken above the garment."""
    held: Mapping[Side, Held] = field(default_factory=dict)
    """What each hand was confirmed to hold."""

    @property
    def carried(self) -> bool:
        """Whether the garment was carried through the fold, and nobody has judged yet what came of it."""
        return self.attempt is not None and self.attempt.carried

    def count(self, adjustment: Adjustment) -> int:
        return self.adjustments.count(adjustment)

    def note(self) -> StepNote | None:
        """The fold as far as it came; None before it was predicted. What nobody looked at is NaN or empty."""
        made = self.attempt
        if made is None:
            return None
        seen = made.inspection
        return StepNote(
            name=made.step.name,
            accepted=seen is not None and seen.diagnosis is None,
            source=made.trajectory.source,
            dissimilarity_m=made.dissimilarity_m,
            aligned_iou=seen.iou_aligned if seen else math.nan,
            observed_iou=seen.iou if seen else math.nan,
            drift_m=seen.drift_m if seen else math.nan,
            height_m=seen.height_m if seen else math.nan,
            grasps=self.grasps,
            pressed=made.pressed,
            inspected=seen,
            predicted=made.predicted,
            observed=seen.contour if seen else np.zeros((0, 2)),
            trajectory=made.trajectory,
            plan_frames=made.plan_frames,
            pictures=made.pictures,
            carrying_s=made.motion.fold.duration,
        )
