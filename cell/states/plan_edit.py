"""A change of the present fold's plan, made by the operator before the fold is approved."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from foldcell.skills.vocabulary import GraspId

Point = tuple[float, float]


@dataclass(frozen=True)
class PlanEdit:
    """One change. Points are in the table frame [m].

    by: who made it. keypoints: name -> position of the key point (only before the first fold). grasps: where the
    hands take the garment; the targets follow. variant: name of the fold variant. other_arc: whether another arc
    is wanted.
    """

    by: str
    keypoints: Mapping[str, Point] = field(default_factory=dict)
    grasps: Mapping[GraspId, Point] = field(default_factory=dict)
    variant: str = ""
    other_arc: bool = False

    def record(self) -> dict[str, Any]:
        """Return the change as JSON values, for the journal: only what was changed."""
        points = {
            "keypoints_m": {name: list(point) for name, point in self.keypoints.items()},
            "grasps_m": {grasp_id.value: list(point) for grasp_id, point in self.grasps.items()},
        }
        choices = {"variant": self.variant, "other_arc": self.other_arc}
        return {"by": self.by, **{name: value for name, value in (points | choices).items() if value}}

    def text(self) -> str:
        """Return the change as text, for the transcript."""
        return json.dumps(self.record())

    @classmethod
    def read(cls, text: str) -> Self:
        """Read what `text` has written."""
        record = json.loads(text)
        return cls(
            by=record["by"],
            keypoints={name: (x, y) for name, (x, y) in record.get("keypoints_m", {}).items()},
            grasps={GraspId(name): (x, y) for name, (x, y) in record.get("grasps_m", {}).items()},
            variant=record.get("variant", ""),
            other_arc=record.get("other_arc", False),
        )

    def in_words(self) -> str:
        """Return the change in words, for the log."""
        moved = [f"key point {name.replace('_', ' ')}" for name in self.keypoints]
        moved += [f"{grasp_id.value} grasp" for grasp_id in self.grasps]
        changes = [f"{', '.join(moved)} moved"] if moved else []
        changes += [f"variant: {self.variant.replace('_', ' ')}"] if self.variant else []
        changes += ["another arc"] if self.other_arc else []
        return "; ".join(changes)


def with_edit(edits: tuple[PlanEdit, ...], edit: PlanEdit) -> tuple[PlanEdit, ...]:
    """Return the edits with one more. Earlier edits of grasps are forgotten if the new edit changes the variant,
    to which the grasps belong, or moves a key point, from which the grasps are planned."""
    if not (edit.variant or edit.keypoints):
        return (*edits, edit)
    return (*(e for e in edits if not e.grasps), edit)
