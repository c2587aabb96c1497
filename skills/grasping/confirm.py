"""Is there cloth between the closed pads, and how many layers of it?

Both pads must feel force and the opening must be above that of empty pads: pads that closed on one another
feel force too. Layers are counted from the opening by Bayes' rule with equal priors: n layers stand
n x thickness high, uncertain by the thickness and by the reading.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.hand_reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["Confirmation", "Expectation", "Held", "LayerCount", "confirm", "count_layers", "start_confirm"]

MOST_LAYERS = 12


@dataclass(frozen=True)
class Expectation:
    """What the pinch shall hold. layers: as planned; None: any number will do. thickness: of one layer [m].

    or_more: a hand set down on the table takes all that lies there: more layers than believed are then no fault.
    """

    thickness: float
    layers: int | None = None
    or_more: bool = False


@dataclass(frozen=True)
class LayerCount:
    """probabilities: of 0 (nothing), 1, 2... layers; estimate, sigma: opening over thickness and its standard
    deviation for the likeliest number."""

    probabilities: tuple[float, ...]
    estimate: float
    sigma: float

    @property
    def layers(self) -> int:
        """The likeliest number."""
        return max(range(len(self.probabilities)), key=self.probabilities.__getitem__)

    @property
    def probability(self) -> float:
        """Of the likeliest number."""
        return max(self.probabilities)

    def of(self, layers: int) -> float:
        """Probability of a number of layers; beyond the last that is reckoned with, that of the last."""
        return self.probabilities[min(layers, len(self.probabilities) - 1)]


@dataclass(frozen=True)
class Held:
    """A confirmed grasp: mean force of the weaker pad [N], mean opening [m], and the layers counted."""

    stamp: float
    grip: float
    opening: float
    count: LayerCount


@dataclass(frozen=True, eq=False)
class Confirmation:
    """State of a confirmation: what has been gathered so far."""

    settings: GraspSettings
    tare: TactileBias
    expected: Expectation
    stamp: float = -np.inf
    pads: tuple[Array, ...] = ()
    openings: tuple[float, ...] = ()


def start_confirm(settings: GraspSettings, tare: TactileBias, expected: Expectation) -> Confirmation:
    return Confirmation(settings, tare, expected)


def confirm(reading: HandReading, state: Confirmation) -> Confirmation | Outcome[Held]:
    """One tick. Failures: MISSED_GRASP (nothing held, or surely fewer layers than planned), MISSED_LAYER (surely
    more than planned), and as `fault` says."""
    bad = fault(reading, state.settings)
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
    if len(state.pads) < state.settings.confirm_readings:
        return state
    return _judge(reading, state)


def count_layers(opening: float, sigma: float, thickness: float, settings: GraspSettings) -> LayerCount:
    """From a mean opening [m] with standard deviation sigma [m]."""
    n = np.arange(MOST_LAYERS + 1)
    spread = np.hypot(sigma, settings.thickness_error * thickness * n)
    off = (opening - settings.empty_opening - thickness * n) / spread
    log_p = -0.5 * off**2 - np.log(spread)
    p = np.exp(log_p - log_p.max())
    best = int(p.argmax())
    estimate = (opening - settings.empty_opening) / thickness
    return LayerCount(tuple((p / p.sum()).tolist()), estimate, float(spread[best] / thickness))


def _judge(reading: HandReading, state: Confirmation) -> Outcome[Held]:
    s = state.settings
    force = float(np.mean(state.pads, axis=0).min())
    opening = float(np.mean(state.openings))
    noise = max(s.opening_noise, float(np.std(state.openings, ddof=1)))
    count = count_layers(opening, noise / np.sqrt(len(state.openings)), state.expected.thickness, s)
    values = {
        "force_n": force,
        "opening_m": opening,
        "layers": count.layers,
        "layers_probability": count.probability,
        "layers_expected": state.expected.layers,
    }
    side = reading.tactile.side
    if force < s.held_force or count.layers == 0:
        what = f"the {side} pads closed on nothing" if force >= s.held_force else f"the {side} pads feel no cloth"
        return Outcome(failure=Failure(FailureKind.MISSED_GRASP, what, "grasp lower or further in", values))
    wanted = state.expected.layers
    fewer = wanted is not None and count.layers < wanted
    if wanted is not None and count.of(wanted) < s.layer_doubt and (fewer or not state.expected.or_more):
        return Outcome(
            failure=Failure(
                FailureKind.MISSED_GRASP if fewer else FailureKind.MISSED_LAYER,
                f"the {side} hand holds {count.layers} layers, not {wanted}",
                "grasp lower" if fewer else "let go and grasp less deep",
                values,
            )
        )
    notes = {"force_n": force, "opening_m": opening, "layers": count.layers}
    return Outcome(Held(reading.stamp, force, opening, count), notes=notes)
