"""Thresholds of the grasping controllers, with units and, where it matters, their relation to sensor noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class GraspSettings:
    """Lengths [m], forces [N], times [s].

    Fields without a default come from the group `grasp` of the cell's settings, and from the models of the robot
    and its gripper. Constants stand beside the controllers that use them.
    """

    # readings
    live_noise: float = 1e-4
    """Smallest standard deviation of a live pad's readings [N]: a hundredth of the usual noise of a cell. A pad
    with less gives a constant. 0 switches this check off."""

    # descend
    approach_speed: float
    """Speed of the descent until the hand is `slow_above` over the expected contact [m/s]."""
    guarded_speed: float
    """Speed of the rest of the descent [m/s]: 0.2 mm per reading, which adds 0.5 N to the force on a rubber
    tip."""
    slow_above: float = 0.015
    """Height over the expected contact from which the hand moves at `guarded_speed` [m]."""
    early_margin: float = 0.030
    """A touch further than this above the expected contact counts as a collision, not as the garment [m]."""
    contact_force: float
    """If the force on a tip, less its bias, is at least this, the tip touches something [N]. The value is more
    than 5 sigma of twice the usual noise (0.03 N)."""
    contact_effort: float
    """Difference of a joint's effort from its running mean that counts as a contact [Nm]: it depends on the
    robot."""

    # guarded push
    press_force: float
    """Force on a tip, less its bias, at which a hand ends its guarded push through the cloth [N]."""

    # close
    grip_force: float
    """Commanded grip force [N]."""
    close_force: float = 4.0
    """If the force on each pad is at least this, the pads count as closed [N]."""

    # confirm, lift
    held_force: float
    """Minimum mean force on each pad of a confirmed grasp [N]."""
    empty_opening: float
    """Opening of closed, empty pads [m]."""
    tip_distance: float
    """Distance between the middles of the fingertips of a hand that is open to grasp [m]."""
    thickness_error: float = 0.12
    """Standard deviation of a layer's thickness between the pads, relative to the nominal thickness."""
    layer_doubt: float = 0.05
    """Smallest probability of the planned number of layers. If it is lower, the grasp counts as failed. With
    `Expectation.or_more`, a grasp of more layers than planned is accepted all the same."""
    kept_force: float = 0.6
    """Fraction of the confirmed force that a lifted grasp must keep."""

    # slip
    slip_fraction: float = 0.5
    """A grip force below this fraction of its baseline means that the cloth is lost."""
    slip_opening_fraction: float = 0.4
    """An opening below this fraction of its baseline means that the cloth is lost. The force alone does not show
    every loss, because empty pads press on each other and feel force too."""

    # release, stuck
    stuck_force: float = 0.10
    """Minimum residual force on one pad, after release and retreat, that counts as cloth on the finger [N]."""


def without_tactile(settings: GraspSettings) -> GraspSettings:
    """Return settings whose force thresholds are never reached, so that only the measurements of arms and grippers
    count. A comparison with the unchanged settings shows the benefit of the tactile sensors."""
    return replace(
        settings,
        contact_force=math.inf,
        press_force=math.inf,
        close_force=math.inf,
        held_force=-math.inf,
        kept_force=-math.inf,
        slip_fraction=0.0,
        stuck_force=math.inf,
        live_noise=0.0,
    )
