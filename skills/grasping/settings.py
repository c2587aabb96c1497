"""Thresholds of the grasping controllers, with units and, where it matters, their relation to sensor noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

__all__ = ["GraspSettings", "without_tactile"]


@dataclass(frozen=True)
class GraspSettings:
    """Lengths [m], forces [N], times [s]. Times are differences of the readings' stamps."""

    # readings
    tactile_stale: float = 0.10
    """Maximum age of a tactile reading [s]."""
    gripper_stale: float = 0.50
    """Maximum age of a gripper state [s]. Electric grippers report at 20 Hz."""
    tare_readings: int = 12
    """Number of tactile readings averaged into the bias."""
    live_noise: float = 1e-4
    """Smallest standard deviation of a live pad's readings [N]: a hundredth of the usual noise of a cell. A pad
    with less gives a constant. 0 switches this check off."""
    live_readings: int = 10
    """Number of readings by which a pad that became constant during a fold is found."""

    # descend
    approach_speed: float = 0.06
    """Speed of the descent until the hand is `slow_above` over the expected contact [m/s]."""
    guarded_speed: float = 0.02
    """Speed of the rest of the descent [m/s]: 0.2 mm per reading, which adds 0.5 N to the force on a rubber
    tip."""
    acceleration: float = 0.15
    """Acceleration of the commanded height [m/s2]."""
    slow_above: float = 0.015
    early_margin: float = 0.030
    """A touch further than this above the expected contact counts as a collision, not as the garment [m]."""
    contact_force: float = 0.35
    """If the force on a tip, less its bias, is at least this, the tip touches something [N]. The value is more
    than 5 sigma of twice the usual noise (0.03 N)."""
    press_stiffness: float = 400.0
    """Increase of the contact force per height of cloth that the tips have to press flat [N/m]. Terry is assumed
    to need 250."""
    arm_stiffness: float = 1500.0
    """Stiffness of an arm at the hand, along z [N/m]. What it gives way, the hand's own height does not show."""
    tip_stiffness: float = 2500.0
    """Stiffness of a tip's rubber [N/m]."""
    contact_readings: int = 3
    contact_effort: float = 9.0
    """Difference of a joint's effort from its running mean that counts as a contact [Nm]: about 12 N at the hand,
    well over the jitter of a moving arm (4 Nm in the simulated cell)."""
    effort_readings: int = 4
    effort_time: float = 1.0
    """Time constant of the effort's running mean [s]. The mean follows slow changes of gravity, but not a
    contact."""
    stall_lag: float = 0.006
    """If the hand is further than this above its commanded height, the arm may be blocked [m]. With a stiffness
    of 1500 N/m this distance corresponds to a force of 9 N."""
    stall_window: float = 0.10
    """Time over which the speed of a lagging arm is measured [s]."""
    stall_speed: float = 0.006
    """A lagging arm that moves down more slowly than this is blocked [m/s]. An arm that is only late continues to
    move down and catches up."""
    lead: float = 0.010
    """Maximum distance of the commanded height below the measured one [m]."""
    bottom_wait: float = 1.0
    """Maximum time for the arm to reach a commanded height that is no longer lowered [s]."""

    # press
    press_force: float = 25.0
    """Force on a tip, less its bias, at which a hand stops pressing the cloth flat [N]."""

    # close
    grip_force: float = 15.0
    """Commanded grip force [N]."""
    close_force: float = 4.0
    """If the force on each pad is at least this, the pads count as closed [N]."""
    close_readings: int = 3
    still_window: float = 0.12
    still_speed: float = 0.008
    """Pads whose opening changes more slowly than this over `still_window` are at rest [m/s]."""
    close_travel: float = 0.003
    """Pads at rest that have moved less than this have not started to close [m]."""
    close_timeout: float = 2.0

    # confirm, lift
    confirm_readings: int = 15
    held_force: float = 0.8
    """Minimum mean force on each pad of a confirmed grasp [N]."""
    empty_opening: float = 0.0
    """Opening of closed, empty pads [m]."""
    thickness_error: float = 0.12
    """Standard deviation of a layer's thickness between the pads, relative to the nominal thickness."""
    opening_noise: float = 0.0003
    """Minimum assumed standard deviation of one reading of the opening [m]: twice the usual value."""
    layer_doubt: float = 0.05
    """Smallest probability of the planned number of layers. If it is lower, the grasp counts as failed. With
    `Expectation.or_more`, a grasp of more layers than planned is accepted all the same."""
    kept_force: float = 0.6
    """Fraction of the confirmed force that a lifted grasp must keep."""
    kept_opening: float = 0.6
    """Fraction of the confirmed opening that a lifted grasp must keep."""

    # slip
    slip_baseline_readings: int = 12
    slip_fraction: float = 0.5
    """A grip force below this fraction of its baseline means that the cloth is lost."""
    slip_opening_fraction: float = 0.4
    """An opening below this fraction of its baseline means that the cloth is lost. The force alone does not show
    every loss, because empty pads press on each other and feel force too."""
    slip_sigmas: float = 5.5
    """Minimum distance between a signal's baseline and the value below which the cloth counts as lost, in standard
    deviations of the mean of the last readings. As many readings are averaged as this distance requires."""
    slip_least_readings: int = 3
    """Minimum number of readings in the mean, so that one wrong reading does not count as a slip."""
    slip_most_readings: int = 10
    """Maximum number of readings in the mean. At 100 Hz a loss is then detected after about 60 ms, within the
    required 100 ms."""
    slip_drift_time: float = 3.0
    """Time constant of the baseline's adaptation to slow changes [s]."""
    slip_anchor: float = 0.75
    """Lower bound of the baseline, relative to its first value. Because of this bound, the baseline cannot follow
    a slow slip down to zero, so the slip is detected."""

    # release, stuck
    release_force: float = 10.0
    release_tolerance: float = 0.002
    release_timeout: float = 2.0
    stuck_readings: int = 20
    stuck_force: float = 0.10
    """Minimum residual force on one pad, after release and retreat, that counts as cloth on the finger [N]."""
    stuck_sigmas: float = 4.5
    drift_ratio: float = 2.0
    """Ratio of a cell's slow drift to its noise, both as standard deviations. Noisier cells drift more."""
    drift_time: float = 120.0
    """Shortest assumed period of a cell's slow drift [s]."""

    def yielding(self, force: float, tips: int) -> float:
        """Return how far a hand reads too low while the table pushes on one or both of its tips [m]. force: on a
        tip [N]."""
        return force * (tips / self.arm_stiffness + 1.0 / self.tip_stiffness)


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
