"""The executive on one page: states, events, effects, and the transition table. No code.

A row means: in `state`, on `event`, go to `target` and perform `effect`. Every effect ends in exactly one event:
DONE if it succeeded, FAILED if not (the context contains the failure), or the event that the effect chose.

`cell/executive/machine.py` adds five rows to every working state: STOP -> STOPPED (HOLD), CRASH -> MAKING_SAFE
(MAKE_SAFE), ABORT -> GIVING_UP (MAKE_SAFE), PAUSE -> PAUSED (WAIT) and UNRECORDED -> FAULT (HOLD). The last row
exists because nothing may move without a journal. GIVING_UP and MAKING_SAFE are exceptions: they have no ABORT and
no PAUSE, and their CRASH leads to FAULT (HOLD). A state with a row of its own for ABORT or CRASH keeps this row.
An abort in a pause takes the ABORT row of the interrupted state. An abort before LAY_BACK begins, also in a pause,
does not replace it: the cloth is laid down, and then the run ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """The states of a run. The operator sees these names."""

    IDLE = "idle"
    PREPARING = "preparing"  # enable, calibrate grippers, park
    RESUMING = "resuming"  # an interrupted run: enable, open the hands, park
    PHOTOGRAPHING = "photographing"  # the empty table, as reference
    AWAITING_GARMENT = "awaiting_garment"
    LOOKING = "looking"
    ESTIMATING = "estimating"  # after a failure: in which state of the fold the garment lies
    RECOGNISING = "recognising"
    PLANNING = "planning"
    OPTIMISING = "optimising"  # look the trajectory up, or optimise it
    PLANNING_MOTION = "planning_motion"
    PLANNING_REPAIR = "planning_repair"  # how a half-made fold is completed or undone
    PLANNING_SPREAD = "planning_spread"  # how a heap is pulled apart
    AWAITING_APPROVAL = "awaiting_approval"
    CHECKING = "checking"  # whether the garment still lies where the plan expects it
    APPROACHING = "approaching"
    GRASPING = "grasping"
    LIFTING = "lifting"
    FOLDING = "folding"
    RELEASING = "releasing"
    RETREATING = "retreating"
    LOOKING_AFTER = "looking_after"
    INSPECTING = "inspecting"
    AWAITING_PRESSING = "awaiting_pressing"  # the operator approves the pressing
    PRESSING = "pressing"  # flatten high places of a fold by dabs, then look again
    LAYING_BACK = "laying_back"  # after a failure: lay down the cloth that the hands still hold
    CLEARING = "clearing"  # after a failure: open the hands, park
    CLEARING_AGAIN = "clearing_again"  # the second and last attempt, after a dwell
    RECOVERING = "recovering"  # choose what to try next
    ASKING = "asking"  # the operator decides
    PAUSED = "paused"
    GIVING_UP = "giving_up"
    MAKING_SAFE = "making_safe"
    # terminal states
    FOLDED = "folded"
    NOT_FOLDED = "not_folded"
    STOPPED = "stopped"
    FAULT = "fault"


class Event(StrEnum):
    START = "start"
    REENTER = "reenter"  # instead of START: resume an interrupted run
    DONE = "done"
    FAILED = "failed"
    # choices
    TOUCHED = "touched"  # the hands may have moved the garment since it was found
    SPREAD_ENDED = "spread_ended"  # the garment was pulled: it is looked at like one that was newly laid
    FOLD_MADE = "fold_made"  # the garment lies as after the fold
    APPROVAL_NEEDED = "approval_needed"
    PRESS = "press"
    NEXT_FOLD = "next_fold"
    ALL_FOLDED = "all_folded"
    # where a resumed run continues (REENTRIES); all except LAY are also recoveries
    START_OVER = "start_over"
    LAY = "lay"
    LOOK_AFTER = "look_after"
    # recoveries (recovery_table.py)
    LOOK_AGAIN = "look_again"
    PLAN_AGAIN = "plan_again"
    OPTIMISE_AGAIN = "optimise_again"
    GRASP_AGAIN = "grasp_again"
    REPAIR = "repair"
    SPREAD = "spread"
    CARRY_ON = "carry_on"
    ASK = "ask"
    GIVE_UP = "give_up"
    # from outside
    APPROVE = "approve"
    RETRY = "retry"
    SKIP = "skip"
    EDIT = "edit"  # the operator changes the plan of the present fold
    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"
    STOP = "stop"
    CRASH = "crash"
    UNRECORDED = "unrecorded"  # the journal cannot be written


class Effect(StrEnum):
    """The actions of the runner on entering a state (cell/executive/effects)."""

    NOTHING = "nothing"
    PREPARE = "prepare"
    REENTER = "reenter"
    PHOTOGRAPH_TABLE = "photograph_table"
    AWAIT_GARMENT = "await_garment"
    LOOK = "look"
    ESTIMATE = "estimate"
    RECOGNISE = "recognise"
    PLAN_FOLDS = "plan_folds"
    CHOOSE_TRAJECTORY = "choose_trajectory"
    PLAN_MOTION = "plan_motion"
    PLAN_REPAIR = "plan_repair"
    PLAN_SPREAD = "plan_spread"
    ASK_APPROVAL = "ask_approval"
    CHECK_PLACE = "check_place"
    APPROACH = "approach"
    GRASP = "grasp"
    LIFT = "lift"
    FOLD = "fold"
    RELEASE = "release"
    RETREAT = "retreat"
    INSPECT = "inspect"
    PRESS = "press"
    NEXT_STEP = "next_step"
    LAY_BACK = "lay_back"
    CLEAR = "clear"
    CLEAR_AGAIN = "clear_again"
    CHOOSE_RECOVERY = "choose_recovery"
    ASK_OPERATOR = "ask_operator"
    WAIT = "wait"
    HOLD = "hold"
    MAKE_SAFE = "make_safe"


class Row(NamedTuple):
    state: State
    event: Event
    target: State
    effect: Effect


S, E, Do = State, Event, Effect

TERMINAL = frozenset({S.FOLDED, S.NOT_FOLDED, S.STOPPED, S.FAULT})

HANDS_CARRY_CLOTH = frozenset({S.LIFTING, S.FOLDING})
"""States in which the hands carry the garment. After a failure, an abort or a crash of the program, LAYING_BACK
first lays it down."""

TRANSITIONS: tuple[Row, ...] = (
    # see and plan
    Row(S.IDLE, E.START, S.PREPARING, Do.PREPARE),
    Row(S.PREPARING, E.DONE, S.PHOTOGRAPHING, Do.PHOTOGRAPH_TABLE),
    Row(S.PHOTOGRAPHING, E.DONE, S.AWAITING_GARMENT, Do.AWAIT_GARMENT),
    Row(S.AWAITING_GARMENT, E.DONE, S.LOOKING, Do.LOOK),
    Row(S.LOOKING, E.DONE, S.RECOGNISING, Do.RECOGNISE),
    Row(S.RECOGNISING, E.DONE, S.PLANNING, Do.PLAN_FOLDS),
    Row(S.PLANNING, E.DONE, S.OPTIMISING, Do.CHOOSE_TRAJECTORY),
    Row(S.OPTIMISING, E.DONE, S.PLANNING_MOTION, Do.PLAN_MOTION),
    Row(S.PLANNING_MOTION, E.DONE, S.CHECKING, Do.CHECK_PLACE),
    Row(S.PLANNING_MOTION, E.APPROVAL_NEEDED, S.AWAITING_APPROVAL, Do.ASK_APPROVAL),
    Row(S.AWAITING_APPROVAL, E.APPROVE, S.CHECKING, Do.CHECK_PLACE),
    Row(S.AWAITING_APPROVAL, E.RETRY, S.LOOKING, Do.LOOK),
    Row(S.AWAITING_APPROVAL, E.EDIT, S.PLANNING, Do.PLAN_FOLDS),
    Row(S.AWAITING_APPROVAL, E.SKIP, S.INSPECTING, Do.NEXT_STEP),
    # after a failure: estimate the state of the garment
    Row(S.LOOKING, E.TOUCHED, S.ESTIMATING, Do.ESTIMATE),
    Row(S.ESTIMATING, E.DONE, S.RECOGNISING, Do.RECOGNISE),
    Row(S.ESTIMATING, E.FOLD_MADE, S.INSPECTING, Do.INSPECT),
    # repair a half-made fold, by a motion that is performed like a fold; an undone fold is then estimated again
    Row(S.RECOVERING, E.REPAIR, S.PLANNING_REPAIR, Do.PLAN_REPAIR),
    Row(S.PLANNING_REPAIR, E.DONE, S.PLANNING_MOTION, Do.PLAN_MOTION),
    Row(S.LOOKING_AFTER, E.TOUCHED, S.ESTIMATING, Do.ESTIMATE),
    # spread a heap by a pull that is performed like a fold; what lies there then is recognised anew
    Row(S.RECOVERING, E.SPREAD, S.PLANNING_SPREAD, Do.PLAN_SPREAD),
    Row(S.RECOGNISING, E.SPREAD, S.PLANNING_SPREAD, Do.PLAN_SPREAD),  # it lies spread, but not where it was laid
    Row(S.PLANNING_SPREAD, E.DONE, S.PLANNING_MOTION, Do.PLAN_MOTION),
    Row(S.LOOKING, E.SPREAD_ENDED, S.RECOGNISING, Do.RECOGNISE),
    Row(S.LOOKING_AFTER, E.SPREAD_ENDED, S.RECOGNISING, Do.RECOGNISE),
    # resume an interrupted run
    Row(S.IDLE, E.REENTER, S.RESUMING, Do.REENTER),
    Row(S.RESUMING, E.START_OVER, S.PHOTOGRAPHING, Do.PHOTOGRAPH_TABLE),
    Row(S.RESUMING, E.LAY, S.AWAITING_GARMENT, Do.AWAIT_GARMENT),
    Row(S.RESUMING, E.LOOK_AGAIN, S.LOOKING, Do.LOOK),
    Row(S.RESUMING, E.LOOK_AFTER, S.LOOKING_AFTER, Do.LOOK),
    # fold
    Row(S.CHECKING, E.DONE, S.APPROACHING, Do.APPROACH),
    Row(S.APPROACHING, E.DONE, S.GRASPING, Do.GRASP),
    Row(S.GRASPING, E.DONE, S.LIFTING, Do.LIFT),
    Row(S.LIFTING, E.DONE, S.FOLDING, Do.FOLD),
    Row(S.FOLDING, E.DONE, S.RELEASING, Do.RELEASE),
    Row(S.RELEASING, E.DONE, S.RETREATING, Do.RETREAT),
    Row(S.RETREATING, E.DONE, S.LOOKING_AFTER, Do.LOOK),
    Row(S.LOOKING_AFTER, E.DONE, S.INSPECTING, Do.INSPECT),
    Row(S.INSPECTING, E.PRESS, S.PRESSING, Do.PRESS),
    Row(S.INSPECTING, E.APPROVAL_NEEDED, S.AWAITING_PRESSING, Do.ASK_APPROVAL),
    Row(S.AWAITING_PRESSING, E.APPROVE, S.PRESSING, Do.PRESS),
    Row(S.AWAITING_PRESSING, E.RETRY, S.LOOKING_AFTER, Do.LOOK),
    Row(S.AWAITING_PRESSING, E.SKIP, S.INSPECTING, Do.INSPECT),
    Row(S.PRESSING, E.DONE, S.RETREATING, Do.RETREAT),
    Row(S.INSPECTING, E.NEXT_FOLD, S.OPTIMISING, Do.CHOOSE_TRAJECTORY),
    Row(S.INSPECTING, E.ALL_FOLDED, S.FOLDED, Do.NOTHING),
    Row(S.INSPECTING, E.GIVE_UP, S.GIVING_UP, Do.MAKE_SAFE),  # a fold was skipped
    # failures while the hands are off the cloth
    Row(S.PREPARING, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    Row(S.RESUMING, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    Row(S.PHOTOGRAPHING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.AWAITING_GARMENT, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.LOOKING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.ESTIMATING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.RECOGNISING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.PLANNING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.OPTIMISING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.PLANNING_MOTION, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.PLANNING_REPAIR, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.PLANNING_SPREAD, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.CHECKING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.LOOKING_AFTER, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.INSPECTING, E.FAILED, S.RECOVERING, Do.CHOOSE_RECOVERY),
    # failures while the hands are on the cloth
    Row(S.APPROACHING, E.FAILED, S.CLEARING, Do.CLEAR),
    Row(S.GRASPING, E.FAILED, S.CLEARING, Do.CLEAR),
    Row(S.LIFTING, E.FAILED, S.LAYING_BACK, Do.LAY_BACK),
    Row(S.LIFTING, E.ABORT, S.LAYING_BACK, Do.LAY_BACK),
    Row(S.LIFTING, E.CRASH, S.LAYING_BACK, Do.LAY_BACK),
    Row(S.FOLDING, E.FAILED, S.LAYING_BACK, Do.LAY_BACK),
    Row(S.FOLDING, E.ABORT, S.LAYING_BACK, Do.LAY_BACK),
    Row(S.FOLDING, E.CRASH, S.LAYING_BACK, Do.LAY_BACK),
    Row(S.LAYING_BACK, E.DONE, S.CLEARING, Do.CLEAR),
    Row(S.LAYING_BACK, E.GIVE_UP, S.GIVING_UP, Do.MAKE_SAFE),  # the operator ended the run
    Row(S.LAYING_BACK, E.FAILED, S.CLEARING, Do.CLEAR),
    Row(S.RELEASING, E.FAILED, S.CLEARING, Do.CLEAR),
    Row(S.RETREATING, E.FAILED, S.CLEARING, Do.CLEAR),
    Row(S.PRESSING, E.FAILED, S.CLEARING, Do.CLEAR),
    Row(S.CLEARING, E.DONE, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.CLEARING, E.FAILED, S.CLEARING_AGAIN, Do.CLEAR_AGAIN),
    Row(S.CLEARING_AGAIN, E.DONE, S.RECOVERING, Do.CHOOSE_RECOVERY),
    Row(S.CLEARING_AGAIN, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    # failures while the cell waits: an arm was pushed, or its position is unknown
    Row(S.RECOVERING, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    Row(S.ASKING, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    Row(S.AWAITING_APPROVAL, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    Row(S.AWAITING_PRESSING, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    Row(S.PAUSED, E.FAILED, S.MAKING_SAFE, Do.MAKE_SAFE),
    # recoveries
    Row(S.RECOVERING, E.START_OVER, S.PHOTOGRAPHING, Do.PHOTOGRAPH_TABLE),
    Row(S.RECOVERING, E.LOOK_AGAIN, S.LOOKING, Do.LOOK),
    Row(S.RECOVERING, E.LOOK_AFTER, S.LOOKING_AFTER, Do.LOOK),
    Row(S.RECOVERING, E.PLAN_AGAIN, S.PLANNING, Do.PLAN_FOLDS),
    Row(S.RECOVERING, E.OPTIMISE_AGAIN, S.OPTIMISING, Do.CHOOSE_TRAJECTORY),
    Row(S.RECOVERING, E.GRASP_AGAIN, S.PLANNING_MOTION, Do.PLAN_MOTION),
    Row(S.RECOVERING, E.CARRY_ON, S.INSPECTING, Do.NEXT_STEP),
    Row(S.RECOVERING, E.ASK, S.ASKING, Do.ASK_OPERATOR),
    Row(S.RECOVERING, E.GIVE_UP, S.GIVING_UP, Do.MAKE_SAFE),
    Row(S.ASKING, E.START_OVER, S.PHOTOGRAPHING, Do.PHOTOGRAPH_TABLE),
    Row(S.ASKING, E.RETRY, S.LOOKING, Do.LOOK),
    Row(S.ASKING, E.SKIP, S.INSPECTING, Do.NEXT_STEP),
    # ends of a run
    Row(S.GIVING_UP, E.DONE, S.NOT_FOLDED, Do.NOTHING),
    Row(S.GIVING_UP, E.FAILED, S.FAULT, Do.HOLD),
    Row(S.MAKING_SAFE, E.DONE, S.FAULT, Do.NOTHING),
    Row(S.MAKING_SAFE, E.FAILED, S.FAULT, Do.HOLD),
)

REENTRIES: Mapping[State, Event] = {
    # nothing lies on the table yet
    S.PREPARING: E.START_OVER,
    S.PHOTOGRAPHING: E.START_OVER,
    S.AWAITING_GARMENT: E.LAY,
    # the garment was not touched, or was released during the fold: find it
    **dict.fromkeys(
        (
            S.LOOKING, S.ESTIMATING, S.RECOGNISING, S.PLANNING, S.OPTIMISING, S.PLANNING_MOTION,
            S.PLANNING_REPAIR, S.PLANNING_SPREAD, S.AWAITING_APPROVAL, S.CHECKING, S.APPROACHING, S.GRASPING,
            S.LIFTING, S.FOLDING,
        ),
        E.LOOK_AGAIN,
    ),
    # the hands completed the fold: inspect it
    **dict.fromkeys(
        (S.RELEASING, S.RETREATING, S.LOOKING_AFTER, S.INSPECTING, S.AWAITING_PRESSING, S.PRESSING), E.LOOK_AFTER
    ),
}  # fmt: skip
"""Interrupted state -> event that resumes the run. A run is never resumed in the middle of a motion. In FOLDING, a
fold that the hands completed is inspected instead (`Attempt.carried`). States without an entry (laying back,
clearing, asking, paused, making safe, terminal states) give no information about the garment. If a run was
interrupted in one of them, the latest earlier state with an entry is used."""
