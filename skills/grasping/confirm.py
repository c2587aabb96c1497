"""Controllers that confirm a grasp: whether cloth is between the closed pads, and how many layers; and whether the
hand still holds it after a small lift.

Both pads must feel force, and the opening must be larger than that of empty pads, because empty pads that press on
each other feel force too. The number of layers follows from the opening by Bayes' rule with equal priors: n layers
are n x thickness high, with the uncertainty of the thickness and of the reading.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from foldcell.skills.grasping.close import MIN_SAMPLES, MovingPads
from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.live_pads import dead_pad
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import LoadedReadings
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome, refuse, skill

CONFIRM_READINGS = 15
"""Number of readings that are averaged to confirm a grasp, or that a lifted grasp still holds."""
SETTLED_SPEED, SETTLED_READINGS = 0.004, 60
"""Layers are counted once the opening changes more slowly than this [m/s], or after this number of readings. Pads
feel cloth before they have come to rest on it, and a gripper may report its opening at a fifth of their rate."""
OPENING_NOISE = 0.0003
"""Minimum assumed standard deviation of one reading of the opening [m]: twice the usual value."""

MAX_LAYERS = 12
KEPT_OPENING = 0.6
"""Fraction of the confirmed opening that a lifted grasp must keep."""


@dataclass(frozen=True)
class Expectation:
    """The expected grasp. thickness: of one layer [m]. layers: planned number; None accepts any number.

    or_more: also accept more layers than planned, because a hand that reaches down to the table takes all layers
    that lie there.
    """

    thickness: float
    layers: int | None = None
    or_more: bool = False


@dataclass(frozen=True)
class LayerCount:
    """Estimated number of layers between the pads.

    probabilities: of 0, 1, 2... layers. estimate: opening beyond that of empty pads, divided by the thickness of a
    layer. sigma: standard deviation of the estimate if the most likely number of layers is true.
    """

    probabilities: tuple[float, ...]
    estimate: float
    sigma: float

    @property
    def layers(self) -> int:
        """The most likely number of layers."""
        return max(range(len(self.probabilities)), key=self.probabilities.__getitem__)

    @property
    def probability(self) -> float:
        """Probability of the most likely number of layers."""
        return max(self.probabilities)

    def of(self, layers: int) -> float:
        """Probability of a number of layers. A number above MAX_LAYERS counts as MAX_LAYERS."""
        return self.probabilities[min(layers, len(self.probabilities) - 1)]


@dataclass(frozen=True)
class Held:
    """A confirmed grasp. stamp: of the last reading [s]. grip: mean force on the less loaded pad [N]. opening:
    mean opening of the pads [m]."""

    stamp: float
    grip: float
    opening: float
    count: LayerCount


@dataclass(frozen=True, eq=False)
class Confirmation(LoadedReadings):
    """State of a confirmation. reports: the latest reports of the gripper."""

    expected: Expectation
    reports: MovingPads = field(default_factory=MovingPads, kw_only=True)


@skill
def confirm(reading: HandReading, state: Confirmation) -> Confirmation | Outcome[Held]:
    """Process the reading of one tick. The result is that of the last `CONFIRM_READINGS` readings, as soon as the
    pads have settled.

    Failures: MISSED_GRASP (nothing held, or clearly fewer layers than planned), MISSED_LAYER (clearly more layers
    than planned), TACTILE_FAULT (a pad's readings are constant), those of `validate_reading`.
    """
    refuse(validate_reading(reading))
    if (after := state.after(reading)) is state:
        return state
    after = replace(after, reports=after.reports.after(reading, after.bias, 0.0, MIN_SAMPLES))
    settled = after.reports.speed < SETTLED_SPEED or len(after.pads) >= SETTLED_READINGS
    if len(after.pads) < CONFIRM_READINGS or not settled:
        return after
    after = replace(after, pads=after.pads[-CONFIRM_READINGS:], openings=after.openings[-CONFIRM_READINGS:])
    refuse(dead_pad(reading.tactile.side, np.array(after.pads), after.settings))
    return _evaluate(reading, after)


def count_layers(opening: float, sigma: float, thickness: float, settings: GraspSettings) -> LayerCount:
    """Estimate the number of layers, each `thickness` [m] thick, from a mean opening [m] with standard deviation
    sigma [m]."""
    n = np.arange(MAX_LAYERS + 1)
    deviation_sigma = np.hypot(sigma, settings.thickness_error * thickness * n)
    deviation = (opening - settings.empty_opening - thickness * n) / deviation_sigma
    log_p = -0.5 * deviation**2 - np.log(deviation_sigma)
    p = np.exp(log_p - log_p.max())
    most_likely = int(p.argmax())
    estimate = (opening - settings.empty_opening) / thickness
    return LayerCount(tuple((p / p.sum()).tolist()), estimate, float(deviation_sigma[most_likely] / thickness))


def _evaluate(reading: HandReading, state: Confirmation) -> Outcome[Held]:
    s = state.settings
    force = float(np.mean(state.pads, axis=0).min())
    opening = float(np.mean(state.openings))
    noise = max(OPENING_NOISE, float(np.std(state.openings, ddof=1)))
    count = count_layers(opening, noise / np.sqrt(len(state.openings)), state.expected.thickness, s)
    values = {
        "side": reading.tactile.side.value,
        "force_n": force,
        "opening_m": opening,
        "layers": count.layers,
        "layers_probability": count.probability,
        "layers_expected": state.expected.layers,
    }
    side = reading.tactile.side
    if force < s.held_force or count.layers == 0:
        message = (
            f"the {side} pads closed on nothing" if force >= s.held_force else f"the {side} pads feel no cloth"
        )
        return Outcome(failure=Failure(FailureKind.MISSED_GRASP, message, "grasp lower or further in", values))
    planned = state.expected.layers
    fewer = planned is not None and count.layers < planned
    if planned is not None and count.of(planned) < s.layer_doubt and (fewer or not state.expected.or_more):
        return Outcome(
            failure=Failure(
                FailureKind.MISSED_GRASP if fewer else FailureKind.MISSED_LAYER,
                f"the {side} hand holds {count.layers} layers, not {planned}",
                "grasp lower" if fewer else "let go and grasp less deep",
                values,
            )
        )
    notes = {"force_n": force, "opening_m": opening, "layers": count.layers}
    return Outcome(Held(reading.stamp, force, opening, count), notes=notes)


@dataclass(frozen=True, eq=False)
class LiftCheck(LoadedReadings):
    """State of a lift check. held: the grasp that was confirmed before the lift."""

    held: Held


@skill
def check_lift(reading: HandReading, state: LiftCheck) -> LiftCheck | Outcome[Held]:
    """Process the reading of one tick, with the hand at rest above the table.

    Failures: MISSED_GRASP when force or opening has dropped, those of `validate_reading`.
    """
    s = state.settings
    refuse(validate_reading(reading))
    after = state.after(reading)
    if after is state or len(after.pads) < CONFIRM_READINGS:
        return after
    force, opening = float(np.mean(after.pads, axis=0).min()), float(np.mean(after.openings))
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
