"""The kinds of faults of a simulated cell: what each one does, where it is injected, its size and its duration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class FaultKind(StrEnum):
    # joint states
    JOINT_STATE_STALE = "joint_state_stale"
    JOINT_STATE_FROZEN = "joint_state_frozen"
    JOINT_STATE_DUPLICATED = "joint_state_duplicated"
    JOINT_STATE_OUT_OF_ORDER = "joint_state_out_of_order"
    JOINT_STATE_NAN = "joint_state_nan"
    # arms and their commands
    ARM_HANGS = "arm_hangs"
    SETPOINTS_STARVED = "setpoints_starved"
    PROGRAM_STALLED = "program_stalled"
    SUDDEN_DROP = "sudden_drop"
    SUDDEN_DROP_BOTH = "sudden_drop_both"
    CLOCK_STEP = "clock_step"
    STOP_FLAPPING = "stop_flapping"
    # camera
    CAMERA_FREEZE = "camera_freeze"
    CAMERA_BLACK = "camera_black"
    CAMERA_SILENT = "camera_silent"
    CAMERA_LATE = "camera_late"
    CAMERA_WRONG_SIZE = "camera_wrong_size"
    CAMERA_DEPTH_NAN = "camera_depth_nan"
    CAMERA_DEPTH_HOLES = "camera_depth_holes"
    CAMERA_OLD_PICTURE = "camera_old_picture"
    HAND_IN_VIEW = "hand_in_view"
    SECOND_GARMENT = "second_garment"
    # tactile pads of one hand
    TACTILE_DEAD = "tactile_dead"
    TACTILE_CONSTANT = "tactile_constant"
    TACTILE_SATURATED = "tactile_saturated"
    TACTILE_STALE = "tactile_stale"
    TACTILE_NAN = "tactile_nan"
    TACTILE_SWAPPED = "tactile_swapped"
    # grippers
    GRIPPER_OFFSET = "gripper_offset"
    GRIPPER_SCALE = "gripper_scale"
    GRIPPER_WEAK = "gripper_weak"
    GRIPPER_ERROR = "gripper_error"
    GRIPPER_UNCALIBRATED = "gripper_uncalibrated"
    GRIPPER_STUCK = "gripper_stuck"
    # cloth
    MISSED_GRASP = "missed_grasp"
    SLIP = "slip"
    DROPPED_CORNER = "dropped_corner"
    GARMENT_SHOVED = "garment_shoved"
    GARMENT_TAKEN = "garment_taken"
    CAUGHT_ON_FINGER = "caught_on_finger"
    NO_GARMENT = "no_garment"


class Place(StrEnum):
    """Where a fault is injected."""

    PORTS = "ports"
    """Into the answers of the ports. The cell itself is sound."""
    WORLD = "world"
    """Into the robot, its grippers, the garment, or the objects before the camera."""


@dataclass(frozen=True)
class FaultTraits:
    """Traits of a kind. what: what happens; `size` stands for its size, `turn` for its angle. place: where it is
    injected. size: default, in `unit`; None: the kind has no size. duration: default [s]; None: it happens at
    once. sided: it affects one hand or arm. counts_grasps: it may wait for the n-th grasp. turns: it has an angle.
    signed: its size may be negative."""

    what: str
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
    K.JOINT_STATE_STALE: FaultTraits(
        "No new joint state arrives: the last one stays, with its stamp.", P, duration=FOREVER),
    K.JOINT_STATE_FROZEN: FaultTraits(
        "The joint state keeps its values, but its stamps go on.", P, duration=FOREVER),
    K.JOINT_STATE_DUPLICATED: FaultTraits(
        "Each joint state is repeated, with its stamp, for `size` [s].", P, 0.05, "s", FOREVER),
    K.JOINT_STATE_OUT_OF_ORDER: FaultTraits(
        "Every second joint state is an old one: it was measured `size` [s] before.", P, 0.2, "s", FOREVER),
    K.JOINT_STATE_NAN: FaultTraits(
        "Positions, velocities and efforts of the joint state are not numbers.", P, duration=FOREVER),
    K.ARM_HANGS: FaultTraits(
        "An arm stands still and ignores its set-points. Afterwards it returns to its set-point at its own full "
        "speed.", W, duration=FOREVER, sided=True),
    K.SETPOINTS_STARVED: FaultTraits(
        "The robot receives no set-points. The sender does not notice it.", P, duration=FOREVER),
    K.PROGRAM_STALLED: FaultTraits(
        "The program sleeps `size` [s] longer than it wanted to, once, while the cell goes on.", P, 0.3, "s"),
    K.SUDDEN_DROP: FaultTraits(
        "An arm drops by `size` [m] at the tool and returns within the duration.", W, 0.03, "m", 0.4, sided=True),
    K.SUDDEN_DROP_BOTH: FaultTraits(
        "Both arms drop by `size` [m] at the tools and return within the duration.", W, 0.03, "m", 0.4),
    K.CLOCK_STEP: FaultTraits(
        "The cell's clock steps by `size` [s], backwards if `size` is negative. All later stamps do so too.",
        P, 0.5, "s", signed=True),
    K.STOP_FLAPPING: FaultTraits(
        "The stop circuit opens and closes by itself, each for `size` [s]. The motors stay off after the first "
        "opening.", W, 0.05, "s", FOREVER),
    K.CAMERA_FREEZE: FaultTraits(
        "The camera repeats its last picture.", P, duration=FOREVER),
    K.CAMERA_BLACK: FaultTraits(
        "The camera's pictures are black and without depth.", P, duration=FOREVER),
    K.CAMERA_SILENT: FaultTraits(
        "The camera does not answer (DriverError).", P, duration=FOREVER),
    K.CAMERA_LATE: FaultTraits(
        "A picture arrives `size` [s] after it was taken.", P, 2.0, "s", FOREVER),
    K.CAMERA_WRONG_SIZE: FaultTraits(
        "Pictures have half the width and height. Their intrinsics say nothing of it.", P, duration=FOREVER),
    K.CAMERA_DEPTH_NAN: FaultTraits(
        "The depth of the whole picture is not a number; its colours are right.", P, duration=FOREVER),
    K.CAMERA_DEPTH_HOLES: FaultTraits(
        "The share `size` of the depth is missing, in patches.", P, 0.3, "share", FOREVER),
    K.CAMERA_OLD_PICTURE: FaultTraits(
        "The camera repeats its last picture under a fresh stamp and number.", P, duration=FOREVER),
    K.HAND_IN_VIEW: FaultTraits(
        "A person's hand and forearm are held over the garment, `size` [m] above the table.",
        W, 0.08, "m", FOREVER),
    K.SECOND_GARMENT: FaultTraits(
        "A second piece of the same cloth, a square of `size` [m], lies on the table.", W, 0.2, "m", FOREVER),
    K.TACTILE_DEAD: FaultTraits(
        "All cells and tips of a hand read zero, under fresh stamps.", P, duration=FOREVER, sided=True),
    K.TACTILE_CONSTANT: FaultTraits(
        "All cells and tips of a hand repeat their last values under fresh stamps.",
        P, duration=FOREVER, sided=True),
    K.TACTILE_SATURATED: FaultTraits(
        "All cells and tips of a hand read `size` [N].", P, 10.0, "N", FOREVER, sided=True),
    K.TACTILE_STALE: FaultTraits(
        "No new reading of a hand arrives: the last one stays, with its stamp.", P, duration=FOREVER, sided=True),
    K.TACTILE_NAN: FaultTraits(
        "All cells and tips of a hand are not numbers.", P, duration=FOREVER, sided=True),
    K.TACTILE_SWAPPED: FaultTraits(
        "The pads of both hands are connected the wrong way round: each reports the other hand's forces.",
        P, duration=FOREVER),
    K.GRIPPER_OFFSET: FaultTraits(
        "A gripper reports an opening that is `size` [m] too large, until it is calibrated.",
        P, 0.003, "m", FOREVER, sided=True),
    K.GRIPPER_SCALE: FaultTraits(
        "A gripper reports `size` times its opening, until it is calibrated.",
        P, 1.2, "ratio", FOREVER, sided=True),
    K.GRIPPER_WEAK: FaultTraits(
        "A gripper presses with the share `size` of the commanded force.", W, 0.3, "share", FOREVER, sided=True),
    K.GRIPPER_ERROR: FaultTraits(
        "A gripper reports an error and refuses commands. A calibration after the duration clears the error.",
        W, duration=FOREVER, sided=True),
    K.GRIPPER_UNCALIBRATED: FaultTraits(
        "A gripper loses its calibration and refuses commands until it is calibrated.", W, sided=True),
    K.GRIPPER_STUCK: FaultTraits(
        "A gripper does not move.", W, duration=FOREVER, sided=True),
    K.MISSED_GRASP: FaultTraits(
        "The garment slips out of the pads while they close.", W, sided=True, counts_grasps=True),
    K.SLIP: FaultTraits(
        "The pads of a hand hold with only the share `size` of their force, so that held cloth slides out.",
        W, 0.02, "share", 1.0, sided=True),
    K.DROPPED_CORNER: FaultTraits(
        "A held corner slips out when the hand is `size` [m] above the table.",
        W, 0.06, "m", sided=True, counts_grasps=True),
    K.GARMENT_SHOVED: FaultTraits(
        "The garment is moved by `size` [m] and turned by `turn`, as one piece, as soon as no hand holds it.",
        W, 0.08, "m", turns=True),
    K.GARMENT_TAKEN: FaultTraits(
        "The garment is taken away as soon as no hand holds it. It is laid back after the duration, moved by "
        "`size` [m] and turned by `turn`.", W, 0.05, "m", FOREVER, turns=True),
    K.CAUGHT_ON_FINGER: FaultTraits(
        "The cloth stays on a finger when the hand opens. It comes off after the duration, or when the hand "
        "closes again.", W, duration=FOREVER, sided=True),
    K.NO_GARMENT: FaultTraits(
        "The attendant lays no garment.", W),
}  # fmt: skip
