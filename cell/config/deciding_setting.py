"""The setting that decided that something counts as a failure, and those that change it, for messages to the
operator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.robots.errors import Failure, FailureKind


@dataclass(frozen=True)
class Limit:
    """A limit that can be set. key: GROUP.NAME in cell.yaml. figure: name of the measured value among those of the
    failure. least: whether the limit is a minimum. factor: from the unit of the figure to that of the setting.
    known: name of a value that has to be above 0, else another cause decided."""

    key: str
    figure: str
    least: bool = False
    factor: float = 1.0
    known: str = ""


_OUTLINE = (
    Limit("inspection.deviation", "edge_deviation_m"),
    Limit("inspection.iou", "iou_aligned", least=True),
)
_DEGREES = 180.0 / np.pi
LIMITS: Mapping[FailureKind, tuple[Limit, ...]] = {
    FailureKind.UNKNOWN_GARMENT: (Limit("perception.min_template_iou", "best_iou", least=True),),
    FailureKind.LOW_CONFIDENCE: (
        Limit("perception.min_fit", "fit", least=True),
        Limit("perception.least_confidence", "confidence", least=True),
    ),
    FailureKind.NOT_FLAT: (
        Limit("inspection.iou", "iou_aligned", least=True),
        Limit("perception.flat_height", "height_m"),
    ),
    FailureKind.START_MISMATCH: (Limit("motion.start_tolerance_deg", "off_rad", factor=_DEGREES),),
    FailureKind.TRACKING_ERROR: (Limit("motion.tracking_tolerance", "off_rad"),),
    FailureKind.STALE_STATE: (Limit("motion.max_state_age_s", "age_s"),),
    # pads between which there is no layer feel too little under any threshold
    FailureKind.MISSED_GRASP: (Limit("grasp.held_force", "force_n", least=True, known="layers"),),
    FailureKind.DRIFT: (
        Limit("inspection.drift", "drift_m"),
        Limit("inspection.drift_deg", "drift_rad", factor=_DEGREES),
    ),
    FailureKind.PILING: (Limit("inspection.extra_height", "extra_height_m"),),
    FailureKind.SAG: _OUTLINE,
    FailureKind.DROPPED_CORNER: _OUTLINE,
    FailureKind.OFF_TARGET: (*_OUTLINE, Limit("inspection.claim_iou", "target_iou", least=True)),
}
"""Failure kind -> the limits that may have decided. The other kinds have no limit that can be set."""

_TACTILE = ("grasp.contact_force", "grasp.held_force")
"""Keys that a tactile calibration overrides."""


def deciding_setting(failure: Failure, settings: CellSettings) -> str:
    """Return file, key and present value of the limit that the failure's figures have passed, with the measured
    value, for example "`inspection.iou: 0.9` in cell.yaml, measured 0.85"; empty if there is none."""
    for limit in LIMITS.get(failure.kind, ()):
        measured = failure.values.get(limit.figure)
        if not isinstance(measured, float) or (limit.known and not failure.values.get(limit.known)):
            continue
        value = abs(measured) * limit.factor
        allowed = _in_force(limit.key, settings)
        if value < allowed if limit.least else value > allowed:
            return f"{setting_in_words(limit.key, settings)}, measured {value:.3g}"
    return ""


def grasping_hint(failure: Failure, settings: CellSettings, whole_stack: bool) -> str:
    """Return the hint of a grasp that failed, with the settings that make the next one lower, less deep or further
    in, and their values. whole_stack: whether all layers were to be held, so that with tactile sensors the touch
    alone decides the height."""
    touch, table, opening = (
        setting_in_words(key, settings) for key in ("grasp.contact_force", "table.height", "gripper.opening")
    )
    lower, higher = f"a lower {table}", f"a higher {table}"
    if settings.grasp.tactile:
        lower = f"a higher {touch}" + ("" if whole_stack else f" or {lower}")
        higher = f"a lower {touch}" + ("" if whole_stack else f" or {higher}")
    inset = f"`inset` of the grasp in the garment file, or a larger {opening}"
    ways = (("lower", lower), ("less deep", higher), ("further in", inset))
    said = "; ".join(f"{way}: {keys}" for way, keys in ways if way in failure.hint)
    return f"{failure.hint} ({said})" if said else failure.hint


def _in_force(key: str, settings: CellSettings) -> float:
    group, name = key.split(".")
    source = settings.grasp.calibrated() if key in _TACTILE else getattr(settings, group)
    return float(getattr(source, name))


def setting_in_words(key: str, settings: CellSettings) -> str:
    """Return a setting with its value in force, in words: from cell.yaml, or from the calibration file that
    overrides it. key: GROUP.NAME."""
    if (file := overriding_file(key, settings)) is not None and key in (*_TACTILE, "table.height"):
        return f"`{key.split('.')[1]}: {_in_force(key, settings)}` in {file}"
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
