"""Clauses about the grippers, the camera and the head."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from foldcell.cell.hardware.contract.rig import Rig, require
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, CameraFrame, Gripper

CALIBRATION_S, STROKE_S = 12.0, 5.0
"""Longest time of a calibration, and of a stroke of the pads [s]."""
FORCE, THERE = 10.0, 0.003
"""Force of the pads [N], and the error of an opening [m]."""
PICTURE_AGE_S, GLIMPSE_S = 0.6, 0.05
"""Largest age of a still picture at its return, and the cell time that a glimpse may take [s]."""
DEPTHS = (0.1, 5.0)
"""Range of a depth in metres [m]."""
LEAST_DEPTHS = 0.5
"""Share of a picture that has a depth."""
TABLE_ERROR, LENS_ERROR = 0.03, 0.1
"""Median error of the table's depth [m], relative error of the focal length."""
EDGE, STEP = 0.05, 8
"""Distance from the table's edges [m], and step between the pixels that are compared [px]."""
HEAD_TURN, HEAD_THERE, HEAD_S = 0.1, 0.02, 4.0
"""Turn of the head, error of its angle [rad], and longest time of the turn [s]."""
HEAD_STAYS_S = 0.3


def gripper(rig: Rig) -> None:
    hands = rig.ports.grippers
    for hand in hands.values():
        hand.calibrate()
        require(hand.state().moving, f"the {hand.side} gripper does not count as moving after `calibrate`")
    _calibrated(rig)
    for share in (0.5, 0.0, 1.0):
        for hand in hands.values():
            hand.command(share * hand.max_opening, FORCE)
            require(hand.state().moving, f"the {hand.side} gripper does not count as moving after a command")
        for hand in hands.values():
            _arrives(rig, hand, share * hand.max_opening)


def _calibrated(rig: Rig) -> None:
    for side, hand in rig.ports.grippers.items():
        done = rig.within(CALIBRATION_S, partial(_is_calibrated, hand))
        state = f"is not calibrated in {CALIBRATION_S:g} s: {hand.state()}"
        require(done, f"the {side} gripper {state}")


def _is_calibrated(hand: Gripper) -> bool:
    state = hand.state()
    return state.calibrated and not state.moving and not state.in_error


def _arrives(rig: Rig, hand: Gripper, opening: float) -> None:
    rig.within(STROKE_S, lambda: abs(hand.state().opening - opening) < THERE)
    at = hand.state().opening
    require(abs(at - opening) < THERE, f"the {hand.side} gripper was to open {opening:.3f} m and opens {at:.3f} m")
    rests = rig.within(STROKE_S, lambda: not hand.state().moving)
    require(rests, f"the {hand.side} gripper has arrived and counts as moving for {STROKE_S:g} s")


def gripper_refusals(rig: Rig) -> None:
    for side, hand in rig.ports.grippers.items():
        for wrong in (math.nan, math.inf):
            what = f"an opening of {wrong} m by the {side} gripper"
            rig.refused(partial(hand.command, wrong, FORCE), what, FailureKind.GRIPPER_FAULT)
        hand.calibrate()
        hand.command(0.3 * hand.max_opening, FORCE)
    _calibrated(rig)
    for hand in rig.ports.grippers.values():
        _arrives(rig, hand, 0.3 * hand.max_opening)


def camera(rig: Rig) -> None:
    before, port = rig.now, rig.ports.camera
    first = port.capture()
    require(first.stamp >= before - 1e-6, f"the picture was taken {before - first.stamp:.2f} s before the request")
    age = rig.now - first.stamp
    require(-1e-6 <= age <= PICTURE_AGE_S, f"the picture is {age:.2f} s old when it is returned")
    second = port.capture()
    require(second.sequence != first.sequence, f"two pictures have the number {first.sequence}")
    require(second.stamp > first.stamp, "the second picture is not newer than the first")
    for frame in (first, second):
        _picture(frame)
    before = rig.now
    port.glimpse()
    require(rig.now - before <= GLIMPSE_S, f"a glimpse takes {rig.now - before:.2f} s")


def _picture(frame: CameraFrame) -> None:
    k = frame.intrinsics
    require(frame.rgb.dtype == np.uint8, f"the colours have the type {frame.rgb.dtype}, not uint8")
    size = f"{k.width}x{k.height}"
    require(frame.rgb.shape == (k.height, k.width, 3), f"colours {frame.rgb.shape}, intrinsics {size}")
    require(frame.depth.dtype == np.float32, f"the depth has the type {frame.depth.dtype}, not float32")
    require(not (frame.rgb.flags.writeable or frame.depth.flags.writeable), "a picture can be written to")


def depth(rig: Rig) -> None:
    """Compare the depth of the empty table with the table that the settings describe."""
    frame, k = rig.ports.camera.capture(), rig.calibration.intrinsics
    size, shape = frame.rgb.shape[:2], frame.depth.shape
    require(shape == size, f"the depth has {shape} pixels, the colours have {size}: it is not registered to them")
    valid = np.isfinite(frame.depth)
    require(valid.mean() > LEAST_DEPTHS, f"only {valid.mean():.0%} of the picture has a depth")
    low, high = float(frame.depth[valid].min()), float(frame.depth[valid].max())
    require(low >= DEPTHS[0], f"a depth is {low:g}: pixels without a depth are NaN")
    require(np.median(frame.depth[valid]) < DEPTHS[1], f"depths are up to {high:.0f}: they are in metres")
    off = max(abs(frame.intrinsics.fx / k.fx - 1.0), abs(frame.intrinsics.fy / k.fy - 1.0))
    require(off < LENS_ERROR, f"the focal length differs by {off:.0%} from that of the settings")
    expected = _table_depth(rig, frame)
    error = float(np.nanmedian(np.abs(frame.depth[::STEP, ::STEP] - expected)))
    require(error < TABLE_ERROR, f"the table's depth is {1e3 * error:.0f} mm off: depth is along the optical axis")


def _table_depth(rig: Rig, frame: CameraFrame) -> Array:
    """Return the depth of the empty table in every STEP-th pixel [m]; NaN beside the table."""
    k, T, table = frame.intrinsics, rig.calibration.T_table_camera, rig.table
    v, u = np.mgrid[0 : k.height : STEP, 0 : k.width : STEP].astype(float)
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones_like(u)], axis=-1) @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(rays[..., 2] < 0.0, -T[2, 3] / rays[..., 2], np.nan)
    x, y = (T[i, 3] + along * rays[..., i] for i in range(2))
    inside = (x > table.x[0] + EDGE) & (x < table.x[1] - EDGE) & (np.abs(y) < table.y[1] - EDGE)
    return np.where(inside, along, np.nan)


def head(rig: Rig) -> None:
    """Turn the head away and back to where the camera is calibrated. A fixed head accepts that and stays."""
    rig.ready()
    rig.refused(lambda: rig.ports.head.command_pan(math.nan), "an angle of the head that is not a number")
    calibrated = rig.calibration.head_pan
    for angle in (calibrated + min(HEAD_TURN, rig.head_range), calibrated):
        rig.ports.head.command_pan(angle)
        rig.within(HEAD_S, partial(_looks, rig, angle))
        rig.wait(HEAD_STAYS_S)
        reported = f"and reports {rig.state.head_pan:.2f} rad"
        require(_looks(rig, angle), f"the head was to turn to {angle:.2f} rad {reported}")


def _looks(rig: Rig, angle: float) -> bool:
    return abs(rig.state.head_pan - angle) < HEAD_THERE
