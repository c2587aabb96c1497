"""The kinds of faults of a simulated cell: what each one does, where it is injected, its size and its duration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["TRAITS", "FaultKind", "FaultTraits", "Place"]


class FaultKind(StrEnum):
    # joint states
    JOINT_STATE_STALE = "joint_state_stale"
    """No new joint state arrives: the last one stays, with its stamp."""
    JOINT_STATE_FROZEN = "joint_state_frozen"
    """The joint state keeps its values, but its stamps go on."""
    JOINT_STATE_DUPLICATED = "joint_state_duplicated"
    """Each joint state is repeated, with its stamp, for `size` [s]."""
    JOINT_STATE_OUT_OF_ORDER = "joint_state_out_of_order"
    """Every second joint state is an old one: it was measured `size` [s] before."""
    JOINT_STATE_NAN = "joint_state_nan"
    """Positions, velocities and efforts of the joint state are not numbers."""
    # arms and their commands
    ARM_HANGS = "arm_hangs"
    """An arm stands still and ignores its set-points. Afterwards it returns to its set-point at its own full
    speed."""
    SETPOINTS_STARVED = "setpoints_starved"
    """The robot receives no set-points. The sender does not notice it."""
    PROGRAM_STALLED = "program_stalled"
    """The program sleeps `size` [s] longer than it wanted to, once, while the cell goes on."""
    SUDDEN_DROP = "sudden_drop"
    """An arm drops by `size` [m] at the tool and returns within the duration."""
    SUDDEN_DROP_BOTH = "sudden_drop_both"
    """Both arms drop by `size` [m] at the tools and return within the duration."""
    CLOCK_STEP = "clock_step"
    """The cell's clock steps by `size` [s], backwards if `size` is negative. All later stamps do so too."""
    STOP_FLAPPING = "stop_flapping"
    """The stop circuit opens and closes by itself, each for `size` [s]. The motors stay off after the first
    opening."""
    # camera
    CAMERA_FREEZE = "camera_freeze"
    """The camera repeats its last picture."""
    CAMERA_BLACK = "camera_black"
    """The camera's pictures are black and without depth."""
    CAMERA_SILENT = "camera_silent"
    """The camera does not answer (DriverError)."""
    CAMERA_LATE = "camera_late"
    """A picture arrives `size` [s] after it was taken."""
    CAMERA_WRONG_SIZE = "camera_wrong_size"
    """Pictures have half the width and height. Their intrinsics say nothing of it."""
    CAMERA_DEPTH_NAN = "camera_depth_nan"
    """The depth of the whole picture is not a number; its colours are right."""
    CAMERA_DEPTH_HOLES = "camera_depth_holes"
    """The share `size` of the depth is missing, in patches."""
    CAMERA_OLD_PICTURE = "camera_old_picture"
    """The camera repeats its last picture under a fresh stamp and number."""
    HAND_IN_VIEW = "hand_in_view"
    """A person's hand and forearm are held over the garment, `size` [m] above the table."""
    SECOND_GARMENT = "second_garment"
    """A second piece of the same cloth, a square of `size` [m], lies on the table."""
    # tactile pads of one hand
    TACTILE_DEAD = "tactile_dead"
    """All cells and tips of a hand read zero, under fresh stamps."""
    TACTILE_CONSTANT = "tactile_constant"
    """All cells and tips of a hand repeat their last values under fresh stamps."""
    TACTILE_SATURATED = "tactile_saturated"
    """All cells and tips of a hand read `size` [N]."""
    TACTILE_STALE = "tactile_stale"
    """No new reading of a hand arrives: the last one stays, with its stamp."""
    TACTILE_NAN = "tactile_nan"
    """All cells and tips of a hand are not numbers."""
    TACTILE_SWAPPED = "tactile_swapped"
    """The pads of both hands are connected the wrong way round: each reports the other hand's forces."""
    # grippers
    GRIPPER_OFFSET = "gripper_offset"
    """A gripper reports an opening that is `size` [m] too large, until it is calibrated."""
    GRIPPER_SCALE = "gripper_scale"
    """A gripper reports `size` times its opening, until it is calibrated."""
    GRIPPER_WEAK = "gripper_weak"
    """A gripper presses with the share `size` of the commanded force."""
    GRIPPER_ERROR = "gripper_error"
    """A gripper reports an error and refuses commands. A calibration after the duration clears the error."""
    GRIPPER_UNCALIBRATED = "gripper_uncalibrated"
    """A gripper loses its calibration and refuses commands until it is calibrated."""
    GRIPPER_STUCK = "gripper_stuck"
    """A gripper does not move."""
    # cloth
    MISSED_GRASP = "missed_grasp"
    """The garment slips out of the pads while they close."""
    SLIP = "slip"
    """The pads of a hand hold with only the share `size` of their force, so that held cloth slides out."""
    DROPPED_CORNER = "dropped_corner"
    """A held corner slips out when the hand is `size` [m] above the table."""
    GARMENT_SHOVED = "garment_shoved"
    """The garment is moved by `size` [m] and turned by `turn`, as one piece, as soon as no hand holds it."""
    GARMENT_TAKEN = "garment_taken"
    """The garment is taken away as soon as no hand holds it. It is laid back after the duration, moved by `size`
    [m] and turned by `turn`."""
    CAUGHT_ON_FINGER = "caught_on_finger"
    """The cloth stays on a finger when the hand opens. It comes off after the duration, or when the hand closes
    again."""
    NO_GARMENT = "no_garment"
    """The attendant lays no garment."""


class Place(StrEnum):
    """Where a fault is injected."""

    PORTS = "ports"
    """Into the answers of the ports. The cell itself is sound."""
    WORLD = "world"
    """Into the robot, its grippers, the garment, or the objects before the camera."""


@dataclass(frozen=True)
class FaultTraits:
    """Traits of a kind. place: where it is injected. size: default, in `unit`; None: the kind has no size.
    duration: default [s]; None: it happens at once. sided: it affects one hand or arm. counts_grasps: it may wait
    for the n-th grasp. turns: it has an angle. signed: its size may be negative."""

    place: Place
    size: float | None = None
    unit: str = ""
    duration: float | None = None
    sided: bool = False
    counts_grasps: bool = False
    turns: bool = False
    signed: bool = False


FOREVER = math.inf
P, W, K = Place.PORTS, Place.WORLD, FaultKind

TRAITS: Mapping[FaultKind, FaultTraits] = {
    K.JOINT_STATE_STALE: FaultTraits(P, duration=FOREVER),
    K.JOINT_STATE_FROZEN: FaultTraits(P, duration=FOREVER),
    K.JOINT_STATE_DUPLICATED: FaultTraits(P, 0.05, "s", FOREVER),
    K.JOINT_STATE_OUT_OF_ORDER: FaultTraits(P, 0.2, "s", FOREVER),
    K.JOINT_STATE_NAN: FaultTraits(P, duration=FOREVER),
    K.ARM_HANGS: FaultTraits(W, duration=FOREVER, sided=True),
    K.SETPOINTS_STARVED: FaultTraits(P, duration=FOREVER),
    K.PROGRAM_STALLED: FaultTraits(P, 0.3, "s"),
    K.SUDDEN_DROP: FaultTraits(W, 0.03, "m", 0.4, sided=True),
    K.SUDDEN_DROP_BOTH: FaultTraits(W, 0.03, "m", 0.4),
    K.CLOCK_STEP: FaultTraits(P, 0.5, "s", signed=True),
    K.STOP_FLAPPING: FaultTraits(W, 0.05, "s", FOREVER),
    K.CAMERA_FREEZE: FaultTraits(P, duration=FOREVER),
    K.CAMERA_BLACK: FaultTraits(P, duration=FOREVER),
    K.CAMERA_SILENT: FaultTraits(P, duration=FOREVER),
    K.CAMERA_LATE: FaultTraits(P, 2.0, "s", FOREVER),
    K.CAMERA_WRONG_SIZE: FaultTraits(P, duration=FOREVER),
    K.CAMERA_DEPTH_NAN: FaultTraits(P, duration=FOREVER),
    K.CAMERA_DEPTH_HOLES: FaultTraits(P, 0.3, "share", FOREVER),
    K.CAMERA_OLD_PICTURE: FaultTraits(P, duration=FOREVER),
    K.HAND_IN_VIEW: FaultTraits(W, 0.08, "m", FOREVER),
    K.SECOND_GARMENT: FaultTraits(W, 0.2, "m", FOREVER),
    K.TACTILE_DEAD: FaultTraits(P, duration=FOREVER, sided=True),
    K.TACTILE_CONSTANT: FaultTraits(P, duration=FOREVER, sided=True),
    K.TACTILE_SATURATED: FaultTraits(P, 10.0, "N", FOREVER, sided=True),
    K.TACTILE_STALE: FaultTraits(P, duration=FOREVER, sided=True),
    K.TACTILE_NAN: FaultTraits(P, duration=FOREVER, sided=True),
    K.TACTILE_SWAPPED: FaultTraits(P, duration=FOREVER),
    K.GRIPPER_OFFSET: FaultTraits(P, 0.003, "m", FOREVER, sided=True),
    K.GRIPPER_SCALE: FaultTraits(P, 1.2, "ratio", FOREVER, sided=True),
    K.GRIPPER_WEAK: FaultTraits(W, 0.3, "share", FOREVER, sided=True),
    K.GRIPPER_ERROR: FaultTraits(W, duration=FOREVER, sided=True),
    K.GRIPPER_UNCALIBRATED: FaultTraits(W, sided=True),
    K.GRIPPER_STUCK: FaultTraits(W, duration=FOREVER, sided=True),
    K.MISSED_GRASP: FaultTraits(W, sided=True, counts_grasps=True),
    K.SLIP: FaultTraits(W, 0.02, "share", 1.0, sided=True),
    K.DROPPED_CORNER: FaultTraits(W, 0.06, "m", sided=True, counts_grasps=True),
    K.GARMENT_SHOVED: FaultTraits(W, 0.08, "m", turns=True),
    K.GARMENT_TAKEN: FaultTraits(W, 0.05, "m", FOREVER, turns=True),
    K.CAUGHT_ON_FINGER: FaultTraits(W, duration=FOREVER, sided=True),
    K.NO_GARMENT: FaultTraits(W),
}
