"""Controller that checks, after a small lift, whether the hand still holds the cloth that it held on the table."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.confirm import CONFIRM_READINGS, Held
from skills.grasping.hand_reading import HandReading, validate_reading
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["LiftCheck", "check_lift", "start_lift_check"]

KEPT_OPENING = 0.6
"""Fraction of the confirmed opening that a lifted grasp must keep."""


@dataclass(frozen=True, eq=False)
class LiftCheck:
    settings: GraspSettings
    bias: TactileBias
    held: Held
    stamp: float = -np.inf
    pads: tuple[Array, ...] = ()
    openings: tuple[float, ...] = ()


def start_lift_check(settings: GraspSettings, bias: TactileBias, held: Held) -> LiftCheck:
    """Start the check. held: the result of `confirm` before the lift."""
    return LiftCheck(settings, bias, held)


def check_lift(reading: HandReading, state: LiftCheck) -> LiftCheck | Outcome[Held]:
    """Process the reading of one tick, with the hand at rest above the table.

    Failures: MISSED_GRASP when force or opening has dropped, those of `validate_reading`.
    """
    s = state.settings
    invalid = validate_reading(reading)
    if invalid:
        return Outcome(failure=invalid)
    if reading.tactile.stamp <= state.stamp:
        return state
    state = replace(
        state,
        stamp=reading.tactile.stamp,
        pads=(*state.pads, state.bias.pads(reading)),
        openings=(*state.openings, reading.gripper.opening),
    )
    if len(state.pads) < CONFIRM_READINGS:
        return state
    force, opening = float(np.mean(state.pads, axis=0).min()), float(np.mean(state.openings))
    force_ratio = force / state.held.grip
    opening_ratio = (opening - s.empty_opening) / (state.held.opening - s.empty_opening)
    if force_ratio >= s.kept_force and opening_ratio >= KEPT_OPENING:
        return Outcome(replace(state.held, stamp=reading.stamp, grip=force, opening=opening))
    return Outcome(
        failure=Failure(
            FailureKind.MISSED_GRASP,
            f"the {reading.tactile.side} hand lost the cloth while lifting it",
            "grasp lower or further in",
            {"force_n": force, "opening_m": opening, "kept_force": force_ratio, "kept_opening": opening_ratio},
        )
    )
