"""Colours and labels of the recording. All colours are RGB or RGBA, 0-255."""

from __future__ import annotations

from foldcell.cell.states.transition_table import State

ARC_PLANNED = (48, 209, 88)
"""Green, as in published figures of folding arcs."""
ARC_DONE = (10, 110, 60)
CANDIDATE = (160, 160, 170)
FOLD_LINE = (255, 90, 180)
GRASP = (48, 209, 88)
KEYPOINT = (255, 69, 58)
PERCEIVED = (255, 214, 10)
MASK = (60, 215, 255)
PREDICTED = (64, 156, 255)
OBSERVED = (255, 149, 0)
TARGET = (235, 235, 245)
TABLE = (176, 150, 118)
GARMENT = (196, 84, 92)
SIDE_COLOURS = {"left": (64, 156, 255), "right": (255, 149, 0)}

_SEEING, _THINKING, _MOVING, _HOLDING = (90, 200, 250), (175, 130, 235), (255, 179, 64), (48, 176, 199)
_WAITING, _TROUBLE, _GOOD, _BAD = (142, 142, 147), (255, 105, 97), (48, 209, 88), (215, 0, 21)

STATE_COLOURS: dict[State, tuple[int, int, int]] = {
    State.IDLE: _WAITING,
    State.PREPARING: _MOVING,
    State.RESUMING: _MOVING,
    State.PHOTOGRAPHING: _SEEING,
    State.AWAITING_GARMENT: _WAITING,
    State.LOOKING: _SEEING,
    State.ESTIMATING: _SEEING,
    State.RECOGNISING: _SEEING,
    State.PLANNING: _THINKING,
    State.OPTIMISING: _THINKING,
    State.PLANNING_MOTION: _THINKING,
    State.PLANNING_REPAIR: _THINKING,
    State.PLANNING_SPREAD: _THINKING,
    State.AWAITING_APPROVAL: _WAITING,
    State.CHECKING: _SEEING,
    State.APPROACHING: _MOVING,
    State.GRASPING: _HOLDING,
    State.LIFTING: _HOLDING,
    State.FOLDING: _HOLDING,
    State.RELEASING: _HOLDING,
    State.RETREATING: _MOVING,
    State.LOOKING_AFTER: _SEEING,
    State.INSPECTING: _SEEING,
    State.AWAITING_PRESSING: _WAITING,
    State.PRESSING: _HOLDING,
    State.LAYING_BACK: _TROUBLE,
    State.CLEARING: _TROUBLE,
    State.CLEARING_AGAIN: _TROUBLE,
    State.RECOVERING: _TROUBLE,
    State.ASKING: _WAITING,
    State.PAUSED: _WAITING,
    State.GIVING_UP: _TROUBLE,
    State.MAKING_SAFE: _TROUBLE,
    State.FOLDED: _GOOD,
    State.NOT_FOLDED: _BAD,
    State.STOPPED: _BAD,
    State.FAULT: _BAD,
}


def darker(colour: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return a darker colour of the same hue."""
    red, green, blue = (round(0.55 * part) for part in colour)
    return red, green, blue


def label(name: str) -> str:
    """Convert a name to a label: 'awaiting_garment' -> 'Awaiting garment'."""
    return name.replace("_", " ").capitalize()
