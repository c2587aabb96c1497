"""How high a hand stands on the table: its fingertips and its arm are springs, and only one tip of a leaning hand
touches the table.

The height from the joints does not show how far the arm yields. All heights are those of the middle between the
tips [m].
"""

from __future__ import annotations

import numpy as np

from foldcell.skills.grasping.descend import ARM_STIFFNESS, TIP_STIFFNESS


def lower_tip(tip_distance: float, lean: float) -> float:
    """Return how far the lower fingertip of a leaning hand is below the middle between its tips [m]. tip_distance:
    between the middles of the tips [m]; lean: about the line between the pads [rad]."""
    return float(0.5 * tip_distance * abs(np.sin(lean)))


def standing_height(commanded: float, below: float) -> float:
    """Return the height at which a hand stands that is commanded to a height. Both are above the table. below: of
    the lower tip [m], see `lower_tip`."""
    one, two = max(below - commanded, 0.0), max(-below - commanded, 0.0)
    lift = TIP_STIFFNESS * (one + two) / (ARM_STIFFNESS + 2.0 * TIP_STIFFNESS)
    if lift > two:  # the upper tip does not touch
        lift = TIP_STIFFNESS * one / (ARM_STIFFNESS + TIP_STIFFNESS)
    return commanded + lift


def to_stand_at(height: float, below: float) -> float:
    """Return the height to which a leaning hand is commanded so that it stands at `height`. Both are above the
    table, on which only the lower tip stands."""
    return height - max(below - height, 0.0) * TIP_STIFFNESS / ARM_STIFFNESS
