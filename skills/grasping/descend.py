"""Controller of the guarded descent: it lowers the hand until the fingertips touch, but not below a given height.

The tactile cells at the tips are the first contact sensor; they feel 0.1 N. Contacts beside the cells, such as a
wrist on a hanger, show in the joints: by their efforts, or by an arm that lags behind its command. The height
alone ends a descent only if the caller asks for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.vocabulary import Array, Failure, FailureKind, Outcome

ARM_STIFFNESS = 1500.0
"""Stiffness of an arm at the hand, along z [N/m]. The height from the joints does not show this deflection."""
TIP_STIFFNESS = 2500.0
"""Stiffness of a tip's rubber [N/m]."""
CONTACT_READINGS = 3
"""Number of successive readings that a contact at the tips needs."""

DESCENT_ACCELERATION = 0.15
"""Acceleration of the commanded height [m/s2]."""
PUSH_STIFFNESS = 400.0
"""Increase of the contact force per height of cloth that the tips push flat [N/m]. Terry is assumed
to need 250."""
EFFORT_READINGS = 4
"""Number of successive readings that a contact in the joints needs."""
EFFORT_TIME = 1.0
"""Time constant of the effort's running mean [s]. The mean follows slow changes of gravity, but not a
contact."""
STALL_LAG = 0.006
"""If the hand is further than this above its commanded height, the arm may be blocked [m]. With a stiffness
of 1500 N/m this distance corresponds to a force of 9 N."""
STALL_WINDOW = 0.10
"""Time over which the speed of a lagging arm is measured [s]."""
STALL_SPEED = 0.006
"""A lagging arm that moves down more slowly than this is blocked [m/s]. An arm that is only late continues to
move down and catches up."""
LARGEST_LEAD = 0.010
"""Maximum distance of the commanded height below the measured one [m]."""
BOTTOM_WAIT = 1.0
"""Maximum time for the arm to reach a commanded height that is no longer lowered [s]."""

Track = tuple[tuple[float, float], ...]
MAX_TIME_STEP = 0.05
"""Maximum time step of the controller; a longer time between two readings counts as this [s]."""
BOTTOM_TOLERANCE = 0.0005
"""Nearer than this to the lower bound, the arm counts as having reached it [m]."""


@dataclass(frozen=True)
class DescentGoal:
    """Heights of the tool centre point over the table [m].

    contact: where the tips are expected to touch cloth or table. bottom: lower bound; a descent that reaches it
    without a touch fails with NO_CONTACT. stop: where the descent succeeds without a touch (to grasp only the
    upper layers), or None. through: height of cloth that the tips push flat before a touch counts as a contact,
    so that the pads reach under all layers; 0 stops at the first touch. Raises ValueError when through is
    negative, or when bottom is above contact or stop.
    """

    contact: float
    bottom: float
    stop: float | None = None
    through: float = 0.0

    def __post_init__(self) -> None:
        if self.through < 0.0:
            raise ValueError(f"through must not be negative, but is {self.through} m")
        lowest_end = self.contact if self.stop is None else min(self.contact, self.stop)
        if not self.bottom <= lowest_end:
            raise ValueError(
                f"a descent's bottom {self.bottom} m must not be above its contact or stop {lowest_end} m"
            )


@dataclass(frozen=True)
class DescentCommand:
    """height: of the tool centre point in the next tick [m]. hold: whether the hand holds its height, because
    there is no new data or the descent has ended."""

    height: float
    hold: bool = False


@dataclass(frozen=True)
class Contact:
    """How a descent ended. height: of the tool centre point [m]. by: the signal that ended it: 'tip', 'effort',
    'stall' or 'height'. force: on the more loaded tip [N]."""

    height: float
    by: str
    force: float


@dataclass(frozen=True, eq=False)
class DescentState:
    settings: GraspSettings
    goal: DescentGoal
    bias: TactileBias
    target: float
    stamp: float
    tactile_stamp: float = -np.inf
    effort: Array | None = None
    tip_count: int = 0
    effort_count: int = 0
    stall_count: int = 0
    lowered: float = np.inf
    """Stamp at which the command was last lowered [s]."""
    speed: float = 0.0
    """Commanded downward speed [m/s]. It is ramped, because an abrupt start would look like a contact."""
    track: Track = ()
    """Recent (stamp [s], height [m]) of the hand."""


def start_descent(
    settings: GraspSettings, goal: DescentGoal, bias: TactileBias, reading: HandReading
) -> DescentState:
    """Start a descent from the hand's present height. The bias must just have been measured above the garment."""
    return DescentState(settings, goal, bias, reading.height, reading.stamp, effort=reading.effort)


def descend(reading: HandReading, state: DescentState) -> tuple[DescentCommand, DescentState | Outcome[Contact]]:
    """Process the reading of one tick. At the end of the descent the command holds the hand's present height.

    Failures: NO_CONTACT at the lower bound, IN_COLLISION on a touch far above the garment, TRACKING_ERROR when the
    arm does not follow, those of `validate_reading`.
    """
    invalid = validate_reading(reading)
    if invalid:
        return _hold(reading), Outcome(failure=invalid)
    dt = float(np.clip(reading.stamp - state.stamp, 0.0, MAX_TIME_STEP))
    state = replace(state, stamp=max(reading.stamp, state.stamp))
    if reading.tactile.stamp <= state.tactile_stamp:
        return DescentCommand(state.target, hold=True), state
    state = _update_contacts(reading, state, dt)
    outcome = _check_contact(reading, state) or _check_end(reading, state)
    if outcome:
        return _hold(reading), outcome
    state = _lower_target(reading, state, dt)
    return DescentCommand(state.target), state


def _hold(reading: HandReading) -> DescentCommand:
    return DescentCommand(reading.height, hold=True)


def _tip_force(reading: HandReading, state: DescentState) -> float:
    return float((reading.tactile.tip - state.bias.tip).max())


def _update_contacts(reading: HandReading, state: DescentState, dt: float) -> DescentState:
    """Count the successive readings with a contact, and update the running mean of the efforts while they show no
    contact."""
    s = state.settings
    tip_contact = _tip_force(reading, state) >= s.contact_force + PUSH_STIFFNESS * state.goal.through
    mean_effort = reading.effort if state.effort is None else state.effort
    effort_contact = bool(np.abs(reading.effort - mean_effort).max() >= s.contact_effort)
    guarded = state.speed <= 1.01 * s.guarded_speed
    track = _extend_track(state.track, reading, STALL_WINDOW)
    stalled = guarded and _is_still(track) and reading.height - state.target >= STALL_LAG
    gain = 0.0 if effort_contact else 1.0 - np.exp(-dt / EFFORT_TIME)
    return replace(
        state,
        tactile_stamp=reading.tactile.stamp,
        tip_count=state.tip_count + 1 if tip_contact else 0,
        effort_count=state.effort_count + 1 if effort_contact else 0,
        stall_count=state.stall_count + 1 if stalled else 0,
        effort=mean_effort + gain * (reading.effort - mean_effort),
        track=track,
    )


def _extend_track(track: Track, reading: HandReading, window: float) -> Track:
    """Add the new reading to the track, and remove entries that are older than `window` [s]."""
    track = (*track, (reading.stamp, reading.height))
    first = next(k for k in range(len(track)) if k + 1 == len(track) or reading.stamp - track[k + 1][0] < window)
    return track[first:]


def _is_still(track: Track) -> bool:
    """Whether the hand has hardly moved down over the whole window."""
    (begun, top), (now, height) = track[0], track[-1]
    if now - begun < STALL_WINDOW:
        return False
    return top - height < STALL_SPEED * (now - begun)


def _check_contact(reading: HandReading, state: DescentState) -> Outcome[Contact] | None:
    s = state.settings
    counts = {
        "tip": state.tip_count >= CONTACT_READINGS,
        "effort": state.effort_count >= EFFORT_READINGS,
        "stall": state.stall_count >= EFFORT_READINGS,
    }
    by = next((name for name, reached in counts.items() if reached), None)
    if by is None:
        return None
    contact = Contact(reading.height, by, _tip_force(reading, state))
    above = reading.height - state.goal.contact
    if above > s.early_margin:
        return Outcome(
            failure=Failure(
                FailureKind.IN_COLLISION,
                f"the {reading.tactile.side} hand touched something {above * 1e3:.0f} mm above the garment",
                "check what is there",
                {"height_m": contact.height, "expected_m": state.goal.contact, "by": contact.by},
            )
        )
    return Outcome(contact)


def _check_end(reading: HandReading, state: DescentState) -> Outcome[Contact] | None:
    goal = state.goal
    if goal.stop is not None and reading.height <= goal.stop:
        return Outcome(Contact(reading.height, "height", _tip_force(reading, state)))
    waited = reading.stamp - state.lowered
    if reading.height > goal.bottom + BOTTOM_TOLERANCE and waited < BOTTOM_WAIT:
        return None
    if reading.height > goal.bottom + LARGEST_LEAD:
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


def _lower_target(reading: HandReading, state: DescentState, dt: float) -> DescentState:
    """Lower the commanded height: fast far above the contact, slowly near it, at most `lead` below the measured
    height, and not below `bottom`."""
    s, goal = state.settings, state.goal
    end_height = goal.contact if goal.stop is None else max(goal.contact, goal.stop)
    far_above = min(state.target, reading.height) > end_height + s.slow_above
    goal_speed = s.approach_speed if far_above else s.guarded_speed
    speed = state.speed + float(
        np.clip(goal_speed - state.speed, -DESCENT_ACCELERATION * dt, DESCENT_ACCELERATION * dt)
    )
    target = max(min(state.target, max(state.target - speed * dt, reading.height - LARGEST_LEAD)), goal.bottom)
    lowered = reading.stamp if target < state.target or state.lowered == np.inf else state.lowered
    return replace(state, target=target, lowered=lowered, speed=speed)


def yielding(force: float, tips: int) -> float:
    """Return the deflection of arm and tips while the table pushes on one or both tips [m]: the height from the
    joints is too low by this. force: on a tip [N]."""
    return force * (tips / ARM_STIFFNESS + 1.0 / TIP_STIFFNESS)
