"""The tare of a simulated hand, as the tests of all controllers need it."""

from __future__ import annotations

from foldcell.skills.grasping.tare import TactileBias, TareState, tare
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP
from tests.hands import SensedHand


def bias_of(hand: SensedHand) -> TactileBias:
    state = TareState(GRASP)
    while not isinstance(state, Outcome):
        state = tare(hand.read(), state)
    return state.unwrap()
