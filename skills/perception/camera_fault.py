"""Recognises pictures that no working camera makes: black, white, frozen, without depth, of the wrong size or of
another place.

Noise makes any two pictures of one scene differ, so equal pixels mean an old picture: a frozen sensor, or a driver
that sends its buffer again with a fresh stamp.
"""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.rectification.table_view import BELOW, RectifiedView, TableView
from foldcell.skills.perception.segmentation.mask import SMALLEST_AREA
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.vocabulary import CameraCalibration, CameraFrame, Failure, FailureKind

DARK_LEVEL = 6.0
"""A picture whose mean intensity (0..255) is below this is black."""
WHITE_LEVEL = 254.0
"""A picture whose mean intensity is above this is white."""

LENS_TOLERANCE = 0.1
"""Largest difference between the calibrated intrinsics and those that the camera itself states: relative to the
focal lengths, and to the picture's size for the principal point. A calibration corrects a few per cent."""

DEPTH_UNITS = {
    4.0: "16-bit steps of 0.25 mm",
    5.0: "16-bit steps of 0.2 mm",
    8.0: "16-bit steps of 0.125 mm",
    10.0: "16-bit steps of 0.1 mm",
    1000.0: "floats in millimetres",
}
"""Factor by which the depth is too large if a file in the unit named is read in the unit that is expected."""
SAME_UNIT = 0.15
"""Largest relative deviation of a depth from the table's, by which its unit is still recognised."""


def camera_fault(
    frame: CameraFrame,
    calibration: CameraCalibration,
    previous: CameraFrame | None,
    settings: PerceptionSettings,
) -> Failure | None:
    """Return CAMERA_FAULT for a picture that has the wrong size or lens, is black, is white, has no depth or
    equals `previous`; else None."""
    expected_shape = (calibration.intrinsics.height, calibration.intrinsics.width)
    hint = "check the camera's cable, exposure and driver, then look again"
    if frame.rgb.shape != (*expected_shape, 3) or frame.depth.shape != expected_shape:
        return Failure(
            FailureKind.CAMERA_FAULT,
            f"the camera is calibrated for {expected_shape[1]} x {expected_shape[0]} pixels, the picture has "
            f"{frame.rgb.shape[1]} x {frame.rgb.shape[0]}, its depth {frame.depth.shape[1]} x "
            f"{frame.depth.shape[0]}",
            "set the camera's resolution back, or calibrate it anew",
        )
    if (other := _other_lens(frame, calibration)) is not None:
        return other
    level = float(frame.rgb[::4, ::4].mean())
    if level < DARK_LEVEL:
        return Failure(FailureKind.CAMERA_FAULT, "the picture is black", hint, {"mean_level": level})
    if level > WHITE_LEVEL:
        return Failure(FailureKind.CAMERA_FAULT, "the picture is white", hint, {"mean_level": level})
    holes = float(np.mean(~np.isfinite(frame.depth)))
    if holes > settings.depth_holes:
        return Failure(
            FailureKind.CAMERA_FAULT, f"{holes:.0%} of the depth is missing", hint, {"depth_holes": holes}
        )
    if previous is not None and _frozen_camera(frame, previous):
        return Failure(
            FailureKind.CAMERA_FAULT,
            "the camera repeats its last picture",
            hint,
            {"sequence": frame.sequence, "stamp_s": frame.stamp},
        )
    return None


def _other_lens(frame: CameraFrame, calibration: CameraCalibration) -> Failure | None:
    """Return CAMERA_FAULT if the camera states intrinsics far from the calibrated ones, else None."""
    own, used = frame.intrinsics, calibration.intrinsics
    differences = {
        "fx": (own.fx - used.fx) / used.fx,
        "fy": (own.fy - used.fy) / used.fy,
        "cx": (own.cx - used.cx) / used.width,
        "cy": (own.cy - used.cy) / used.height,
    }
    name = max(differences, key=lambda key: abs(differences[key]))
    if abs(differences[name]) <= LENS_TOLERANCE:
        return None
    stated, calibrated = getattr(own, name), getattr(used, name)
    return Failure(
        FailureKind.CAMERA_FAULT,
        f"the camera states {name} = {stated:.1f} pixels, its calibration {calibrated:.1f}",
        "set the camera's resolution and lens back, or calibrate it anew",
        {"stated_px": stated, "calibrated_px": calibrated},
    )


def table_unseen(view: TableView) -> Failure | None:
    """Return CAMERA_FAULT when the visible area of the table is smaller than a garment, else None."""
    if np.count_nonzero(view.valid) >= SMALLEST_AREA:
        return None
    return Failure(
        FailureKind.CAMERA_FAULT,
        "by its calibration the camera does not look at the table",
        "calibrate its pose (calibrate hand-eye), or correct the table's place in cell.yaml",
        {"seen_m2": float(np.count_nonzero(view.valid)) * view.pixel**2},
    )


def depth_fault(view: TableView, frame: CameraFrame, seen: RectifiedView, holes: float) -> Failure | None:
    """Return CAMERA_FAULT if more than the share `holes` of the table has no possible height, else None.

    A height far below the table is impossible. Such depth contradicts the calibration: it has another unit, or the
    camera stands elsewhere.
    """
    missing = float(np.mean(~np.isfinite(seen.height[view.valid])))
    ratio = view.depth_ratio(frame)
    if missing <= holes or np.isnan(ratio):
        return None
    what = (
        f"by its depth, {missing:.0%} of the table is missing or more than {BELOW * 100:.0f} cm below its top: "
        f"the depth is {ratio:.3g} times that of the table"
    )
    factor = min(DEPTH_UNITS, key=lambda factor: abs(ratio / factor - 1.0))
    hint = (
        f"the depth looks like {DEPTH_UNITS[factor]}: divide it by {factor:.0f}"
        if abs(ratio / factor - 1.0) < SAME_UNIT
        else "check the unit of the depth and the calibrated place of the camera"
    )
    return Failure(FailureKind.CAMERA_FAULT, what, hint, {"missing": missing, "depth_ratio": ratio})


def same_picture(frame: CameraFrame, reference: CameraFrame) -> Failure | None:
    """Return CAMERA_FAULT if the picture equals that of the empty table, else None."""
    if not np.array_equal(frame.rgb, reference.rgb):
        return None
    return Failure(
        FailureKind.CAMERA_FAULT, "the picture is identical to that of the empty table",
        "the camera is frozen, or one file was given twice: take a new picture",
    )  # fmt: skip


def _frozen_camera(frame: CameraFrame, previous: CameraFrame) -> bool:
    """Whether the camera repeats a picture."""
    if frame is previous or frame.stamp == previous.stamp:
        return False
    return frame.sequence == previous.sequence or (
        np.array_equal(frame.rgb, previous.rgb) and np.array_equal(frame.depth, previous.depth, equal_nan=True)
    )


def picture_digests(frame: CameraFrame) -> tuple[str, ...]:
    """Return a digest of the colours and one of the depth. Colours that are all equal, and depth without values,
    have no digest, because such pictures are alike. Other checks refuse them."""
    digests = []
    if frame.rgb.min() != frame.rgb.max():
        digests.append(_digest(frame.rgb))
    if np.isfinite(frame.depth).any():
        digests.append(_digest(frame.depth))
    return tuple(digests)


def repeated(frame: CameraFrame, earlier: Iterable[str]) -> Failure | None:
    """Return CAMERA_FAULT if colours or depth are those of an earlier picture, else None. earlier: the digests of
    all earlier pictures."""
    if not set(picture_digests(frame)) & set(earlier):
        return None
    return Failure(
        FailureKind.CAMERA_FAULT,
        "the camera sends an old picture again, with a new stamp",
        "check the camera's cable and driver, then look again",
        {"sequence": frame.sequence, "stamp_s": frame.stamp},
    )


def _digest(pixels: NDArray) -> str:
    return blake2b(np.ascontiguousarray(pixels).tobytes(), digest_size=12).hexdigest()
