"""The setting that decides whether something counts as a failure, for messages to the operator."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from pathlib import Path

from cell.config.cell_settings import CellSettings
from robots.errors import FailureKind

__all__ = ["DECIDING", "deciding_setting", "overriding_file", "setting_in_words"]

DECIDING: Mapping[FailureKind, str] = {
    FailureKind.UNKNOWN_GARMENT: "perception.min_template_iou",
    FailureKind.LOW_CONFIDENCE: "perception.min_fit",
    FailureKind.NOT_FLAT: "perception.flat_height",
    FailureKind.PREDICTION_POOR: "optimiser.simulations",
    FailureKind.OPTIMISER_FAILED: "optimiser.simulations",
    FailureKind.START_MISMATCH: "motion.start_tolerance_deg",
    FailureKind.TRACKING_ERROR: "motion.tracking_tolerance",
    FailureKind.STALE_STATE: "motion.max_state_age_s",
    FailureKind.NO_CONTACT: "grasp.contact_force",
    FailureKind.MISSED_GRASP: "grasp.held_force",
    FailureKind.SLIPPED: "grasp.grip_force",
    FailureKind.DRIFT: "inspection.drift",
    FailureKind.PILING: "inspection.extra_height",
    FailureKind.TOO_HIGH: "pressing.max_attempts",
    FailureKind.SAG: "inspection.deviation",
    FailureKind.OFF_TARGET: "inspection.iou",
}
"""Failure kind -> key in cell.yaml, GROUP.NAME. The other kinds have no limit that can be set."""

_TACTILE = ("grasp.contact_force", "grasp.held_force")
"""Keys that a tactile calibration overrides."""


def deciding_setting(kind: FailureKind, settings: CellSettings) -> str:
    """Return file, key and present value of the setting that decides, for example "`inspection.iou: 0.9` in
    cell.yaml"; empty if there is none."""
    key = DECIDING.get(kind)
    return "" if key is None else setting_in_words(key, settings)


def setting_in_words(key: str, settings: CellSettings) -> str:
    """Return a setting with its value in force, in words: from cell.yaml, or from the calibration file that
    overrides it. key: GROUP.NAME."""
    if (file := overriding_file(key, settings)) is not None and key in _TACTILE:
        name = key.split(".")[1]
        return f"`{name}: {getattr(settings.grasp.calibrated(), name)}` in {file}"
    value = reduce(getattr, key.split("."), settings)
    return f"`{key}: {value}` in cell.yaml"


def overriding_file(key: str, settings: CellSettings) -> Path | None:
    """Return the calibration file whose value is in force in place of a key's; None if the key is in force.

    The camera's place is not among these keys, because the robot's parked arms are checked against the camera as
    drawn.
    """
    camera, grasp = settings.camera.calibration, settings.grasp.calibration
    files = {
        "table.height": settings.table_.calibration,
        **dict.fromkeys(("camera.target", "camera.view_deg", "camera.width"), camera),
        **dict.fromkeys(_TACTILE, grasp),
    }
    return files.get(key)
