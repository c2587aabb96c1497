"""After a small lift: does the grip still hold what it held on the table?"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.confirm import Held
from skills.grasping.hand_reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["LiftCheck", "check_lift", "start_lift_check"]


@dataclass(frozen=True, eq=False)
class LiftCheck:
    settings: GraspSettings
    tare: TactileBias
    held: Held
    stamp: float = -np.inf
    pads: tuple[Array, ...] = ()
    openings: tuple[float, ...] = ()


def start_lift_check(settings: GraspSettings, tare: TactileBias, held: Held) -> LiftCheck:
    """`held`: what `confirm` found before the lift."""
    return LiftCheck(settings, tare, held)


def check_lift(reading: HandReading, state: LiftCheck) -> LiftCheck | Outcome[Held]:
    """One tick, with the hand at rest above the table. MISSED_GRASP when force or opening was not kept."""
    s = state.settings
    bad = fault(reading, s)
    if bad:
        return Outcome(failure=bad)
    if reading.tactile.stamp <= state.stamp:
        return state
    state = replace(
        state,
        stamp=reading.tactile.stamp,
        pads=(*state.pads, state.tare.pads(reading)),
        openings=(*state.openings, reading.gripper.opening),
    )
    if len(state.pads) < s.confirm_readings:
        return state
    force, opening = float(np.mean(state.pads, axis=0).min()), float(np.mean(state.openings))
    kept_force = force / state.held.grip
    kept_opening = (opening - s.empty_opening) / (state.held.opening - s.empty_opening)
    if min(kept_force, kept_opening) >= s.kept_fraction:
        return Outcome(replace(state.held, stamp=reading.stamp, grip=force, opening=opening))
    return Outcome(
        failure=Failure(
            FailureKind.MISSED_GRASP,
            f"the {reading.tactile.side} hand lost the cloth while lifting it",
            "grasp lower or further in",
            {"force_n": force, "opening_m": opening, "kept_force": kept_force, "kept_opening": kept_opening},
        )
    )
