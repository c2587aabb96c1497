"""Errors and failures of the whole cell. Each one states what happened and what the operator can do.

Skills do not raise exceptions for failures that a cell must expect (a missed grasp, an unreachable target). They
return an `Outcome` that contains a `Failure`. Exceptions that leave a skill are for unexpected errors: a broken
driver, a wrong configuration, a bug. Failures, exceptions, recoveries, reports and injected faults use the same
`FailureKind`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class FailureKind(StrEnum):
    """All kinds of failure of a fold."""

    # seeing
    NO_GARMENT = "no_garment"
    UNKNOWN_GARMENT = "unknown_garment"
    CATEGORY_MISMATCH = "category_mismatch"
    OUT_OF_VIEW = "out_of_view"
    VIEW_OBSTRUCTED = "view_obstructed"  # a hand or another object reaches into the picture
    NOT_FLAT = "not_flat"
    LOW_CONFIDENCE = "low_confidence"
    CAMERA_FAULT = "camera_fault"
    GARMENT_MOVED = "garment_moved"  # moved after the plan was made, and not by the cell
    # planning
    OPTIMISER_FAILED = "optimiser_failed"
    PREDICTION_POOR = "prediction_poor"
    UNREACHABLE = "unreachable"
    IN_COLLISION = "in_collision"
    LIMIT_EXCEEDED = "limit_exceeded"
    # moving
    START_MISMATCH = "start_mismatch"
    TRACKING_ERROR = "tracking_error"
    STALE_STATE = "stale_state"
    # gripping
    NO_CONTACT = "no_contact"
    MISSED_GRASP = "missed_grasp"
    SLIPPED = "slipped"
    STUCK_ON_FINGER = "stuck_on_finger"
    TACTILE_FAULT = "tactile_fault"  # a pad is dead, constant, or gives no numbers
    GRIPPER_FAULT = "gripper_fault"
    # judging a fold (the paper's failure kinds, and the height)
    DRIFT = "drift"
    PILING = "piling"
    TOO_HIGH = "too_high"
    SAG = "sag"
    MISSED_LAYER = "missed_layer"
    DROPPED_CORNER = "dropped_corner"
    OFF_TARGET = "off_target"
    HALF_FOLDED = "half_folded"
    HEAPED = "heaped"
    # the cell itself
    STOPPED = "stopped"
    ABORTED = "aborted"
    HARDWARE_FAULT = "hardware_fault"
    SKILL_CRASHED = "skill_crashed"
    UNRECORDED = "unrecorded"


@dataclass(frozen=True)
class Failure:
    """An expected failure as a value. what: what happened; hint: what the operator can do."""

    kind: FailureKind
    what: str
    hint: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Figures for the journal and the report: JSON values, SI units in the keys."""

    def __str__(self) -> str:
        return f"{self.kind}: {self.what}" + (f" ({self.hint})" if self.hint else "")


class CellError(Exception):
    """Base class of the exceptions. what: what happened; hint: what the operator can do; values: figures."""

    def __init__(self, what: str, hint: str = "", **values: Any) -> None:
        super().__init__(what)
        self.what = what
        self.hint = hint
        self.values = values

    def __str__(self) -> str:
        return f"{self.what}\n  {self.hint}" if self.hint else self.what


class ConfigurationError(CellError):
    """A file or an argument of the user is wrong. Nothing moved and nothing was written."""


class DriverError(CellError):
    """The hardware (or its simulation) refused a command or does not answer. kind: the failure."""

    def __init__(self, kind: FailureKind, what: str, hint: str = "", **values: Any) -> None:
        super().__init__(what, hint, **values)
        self.args = kind, what  # a copy in another process is made from them
        self.kind = kind

    def failure(self) -> Failure:
        """The error as a value, for the recovery table."""
        return Failure(self.kind, self.what, self.hint, self.values)


class StorageError(CellError):
    """A file of this program (logs, journal, recording, cache) cannot be read or written."""


class RecordError(CellError):
    """The journal could not be written during a run. The arms hold, and the last events are not in the journal."""


class InternalError(CellError):
    """A broken invariant of this program. It is always a bug, not a failure of the garment or the robot."""
