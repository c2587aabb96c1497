"""Guarded descent: down until the fingertips touch, and no further than the table allows.

The tips' tactile cells decide first (they feel 0.1 N), the joints second (they feel what the cells cannot: a
hand beside its cells, a wrist on a hanger): by their efforts, or by an arm that stays behind its command. The
expected height alone ends a descent only where the caller says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.hand_reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["Contact", "DescentCommand", "DescentGoal", "DescentState", "descend", "start_descent"]

Way = tuple[tuple[float, float], ...]
LONGEST_TICK = 0.05
"""A gap between readings never makes a step longer than this one [s]."""
AT_BOTTOM = 0.0005
"""The arm has followed to the lower bound when it is this near [m]."""


@dataclass(frozen=True)
class DescentGoal:
    """Heights of the tool centre point over the table [m].

    contact: where the tips should meet cloth or table. bottom: lower bound; touching nothing down to there is
    NO_CONTACT. stop: where the descent ends well without a touch (to pinch the upper layers only), or None.
    through: height of the cloth that the tips shall press flat before it counts as a contact, so that the pads
    reach under all of its layers; 0 stops at the first touch.
    """

    contact: float
    bottom: float
    stop: float | None = None
    through: float = 0.0

    def __post_init__(self) -> None:
        if self.through < 0.0:
            raise ValueError(f"cloth cannot be {self.through} m high")
        low = self.contact if self.stop is None else min(self.contact, self.stop)
        if not self.bottom <= low:
            raise ValueError(f"a descent's bottom {self.bottom} m must not be above its contact or stop {low} m")


@dataclass(frozen=True)
class DescentCommand:
    """The height to be at in the next tick [m]; `hold`: stay there, nothing new was learnt or it is over."""

    height: float
    hold: bool = False


@dataclass(frozen=True)
class Contact:
    """height where it ended [m]; by: 'tip', 'effort', 'stall' or 'height'; force on the tips [N]."""

    height: float
    by: str
    force: float


@dataclass(frozen=True, eq=False)
class DescentState:
    settings: GraspSettings
    goal: DescentGoal
    tare: TactileBias
    target: float
    stamp: float
    tactile_stamp: float = -np.inf
    effort: Array | None = None
    tip_count: int = 0
    effort_count: int = 0
    stall_count: int = 0
    lowered: float = np.inf
    """When the command last went down [s]."""
    speed: float = 0.0
    """Downwards, as commanded now [m/s]: an arm that starts with a jerk feels a contact that is none."""
    way: Way = ()
    """When and where the hand was of late [s], [m]."""


def start_descent(
    settings: GraspSettings, goal: DescentGoal, bias: TactileBias, reading: HandReading
) -> DescentState:
    """From where the hand is. The zero was taken above the garment, just before."""
    return DescentState(settings, goal, bias, reading.height, reading.stamp, effort=reading.effort)


def descend(reading: HandReading, state: DescentState) -> tuple[DescentCommand, DescentState | Outcome[Contact]]:
    """One tick. On any end the command holds the height at which the hand is.

    Failures: NO_CONTACT at the lower bound, IN_COLLISION on a touch far above the garment, TRACKING_ERROR when
    the arm does not follow, and what `fault` says.
    """
    bad = fault(reading, state.settings)
    if bad:
        return _stay(reading), Outcome(failure=bad)
    dt = float(np.clip(reading.stamp - state.stamp, 0.0, LONGEST_TICK))
    state = replace(state, stamp=max(reading.stamp, state.stamp))
    if reading.tactile.stamp <= state.tactile_stamp:
        return DescentCommand(state.target, hold=True), state
    state = _feel(reading, state, dt)
    end = _touched(reading, state) or _arrived(reading, state)
    if end:
        return _stay(reading), end
    state = _lower(reading, state, dt)
    return DescentCommand(state.target), state


def _stay(reading: HandReading) -> DescentCommand:
    return DescentCommand(reading.height, hold=True)


def _tip_force(reading: HandReading, state: DescentState) -> float:
    return float((reading.tactile.tip - state.tare.tip).max())


def _feel(reading: HandReading, state: DescentState, dt: float) -> DescentState:
    """Count touching readings; let the efforts' running mean follow while nothing touches."""
    s = state.settings
    touching = _tip_force(reading, state) >= s.contact_force + s.press_stiffness * state.goal.through
    mean = reading.effort if state.effort is None else state.effort
    pushed = bool(np.abs(reading.effort - mean).max() >= s.contact_effort)
    slow = state.speed <= 1.01 * s.guarded_speed
    way = _of_late(state.way, reading, s.stall_window)
    stalled = slow and _stands(way, s) and reading.height - state.target >= s.stall_lag
    follow = 0.0 if pushed else 1.0 - np.exp(-dt / s.effort_time)
    return replace(
        state,
        tactile_stamp=reading.tactile.stamp,
        tip_count=state.tip_count + 1 if touching else 0,
        effort_count=state.effort_count + 1 if pushed else 0,
        stall_count=state.stall_count + 1 if stalled else 0,
        effort=mean + follow * (reading.effort - mean),
        way=way,
    )


def _of_late(way: Way, reading: HandReading, window: float) -> Way:
    """The places up to now, the first of them `window` [s] ago, or as long as there are any."""
    way = (*way, (reading.stamp, reading.height))
    first = next(k for k in range(len(way)) if k + 1 == len(way) or reading.stamp - way[k + 1][0] < window)
    return way[first:]


def _stands(way: Way, settings: GraspSettings) -> bool:
    """Whether the hand has hardly come down over the whole window."""
    (begun, top), (now, height) = way[0], way[-1]
    if now - begun < settings.stall_window:
        return False
    return top - height < settings.stall_speed * (now - begun)


def _touched(reading: HandReading, state: DescentState) -> Outcome[Contact] | None:
    s = state.settings
    counts = {
        "tip": state.tip_count >= s.contact_readings,
        "effort": state.effort_count >= s.effort_readings,
        "stall": state.stall_count >= s.effort_readings,
    }
    by = next((name for name, enough in counts.items() if enough), None)
    if by is None:
        return None
    contact = Contact(reading.height, by, _tip_force(reading, state))
    above = reading.height - state.goal.contact
    if above > s.early_margin:
        return Outcome(
            failure=Failure(
                FailureKind.IN_COLLISION,
                f"the {reading.tactile.side} hand touched something {above * 1e3:.0f} mm above the garment",
                "look what stands or lies there",
                {"height_m": contact.height, "expected_m": state.goal.contact, "by": contact.by},
            )
        )
    return Outcome(contact)


def _arrived(reading: HandReading, state: DescentState) -> Outcome[Contact] | None:
    goal = state.goal
    if goal.stop is not None and reading.height <= goal.stop:
        return Outcome(Contact(reading.height, "height", _tip_force(reading, state)))
    waited = reading.stamp - state.lowered
    if reading.height > goal.bottom + AT_BOTTOM and waited < state.settings.bottom_wait:
        return None
    if reading.height > goal.bottom + state.settings.lead:
        return Outcome(
            failure=Failure(
                FailureKind.TRACKING_ERROR,
                f"the {reading.tactile.side} arm has not followed its descent for {waited:.1f} s",
                "look for an obstacle; check that the arm is enabled",
                {"height_m": reading.height, "commanded_m": state.target, "seconds": waited},
            )
        )
    return Outcome(
        failure=Failure(
            FailureKind.NO_CONTACT,
            f"the {reading.tactile.side} hand felt nothing down to {reading.height * 1e3:.1f} mm over the table",
            "check the table's height (calibrate table) and where the garment lies",
            {"height_m": reading.height, "bottom_m": goal.bottom, "expected_m": goal.contact},
        )
    )


def _lower(reading: HandReading, state: DescentState, dt: float) -> DescentState:
    """The next height: fast while far, slow near; never far ahead of the arm, never below the bound."""
    s, goal = state.settings, state.goal
    ends = goal.contact if goal.stop is None else max(goal.contact, goal.stop)
    fast = min(state.target, reading.height) > ends + s.slow_above
    wanted = s.approach_speed if fast else s.guarded_speed
    speed = state.speed + float(np.clip(wanted - state.speed, -s.acceleration * dt, s.acceleration * dt))
    target = max(min(state.target, max(state.target - speed * dt, reading.height - s.lead)), goal.bottom)
    lowered = reading.stamp if target < state.target or state.lowered == np.inf else state.lowered
    return replace(state, target=target, lowered=lowered, speed=speed)
