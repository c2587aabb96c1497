"""Thresholds of the grasping controllers, with units and, where it matters, their relation to sensor noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

__all__ = ["GraspSettings", "without_tactile"]


@dataclass(frozen=True)
class GraspSettings:
    """Lengths [m], forces [N], times [s] in terms of the readings' stamps."""

    # readings
    tactile_stale: float = 0.10
    """Maximum age of a tactile reading [s]."""
    gripper_stale: float = 0.50
    """Maximum age of a gripper state [s]. Electric grippers report at 20 Hz."""
    tare_readings: int = 12
    """Number of tactile readings averaged into the bias."""

    # descend
    approach_speed: float = 0.06
    """Speed down to `slow_above` over the expected contact [m/s]."""
    guarded_speed: float = 0.02
    """Speed below `slow_above` [m/s]: 0.2 mm per reading, or 0.5 N per reading on a rubber tip."""
    acceleration: float = 0.15
    """Acceleration of the commanded height [m/s2]."""
    slow_above: float = 0.015
    early_margin: float = 0.030
    """A touch this far above the expected contact is not the garment [m]."""
    contact_force: float = 0.35
    """Increase of a tip's force over its bias that is a contact [N]: more than 5 sigma, for twice the usual noise
    of 0.03 N."""
    press_stiffness: float = 400.0
    """Force per height of cloth pressed flat under a tip [N/m]. The assumed value for terry is 250."""
    contact_readings: int = 3
    contact_effort: float = 9.0
    """Increase of a joint's effort over its running mean that is a contact [Nm]: about 12 N at the hand, well over
    the jitter of a moving arm (4 Nm in the simulated cell)."""
    effort_readings: int = 4
    effort_time: float = 1.0
    """Time constant of the effort's running mean [s]. The mean follows slow changes of gravity, but not a
    contact."""
    stall_lag: float = 0.006
    """Lag behind the guarded descent above which an arm may be blocked [m]: 9 N on Baxter's arm."""
    stall_window: float = 0.10
    """Time over which the speed of a lagging arm is judged [s]."""
    stall_speed: float = 0.006
    """A lagging arm that moves down more slowly than this is blocked [m/s]. An arm that is only late catches
    up."""
    lead: float = 0.010
    """Maximum distance of the commanded height below the measured one [m]."""
    bottom_wait: float = 1.0
    """Maximum time for the arm to follow a command that is no longer lowered [s]."""

    # press
    press_force: float = 25.0
    """Increase of a tip's force at which a hand stops pressing the cloth flat [N]."""

    # close
    grip_force: float = 15.0
    """Commanded grip force [N]."""
    close_force: float = 4.0
    """Force on both pads at which they count as closed [N]."""
    close_readings: int = 3
    still_window: float = 0.12
    still_speed: float = 0.008
    """An opening that changes more slowly than this over the window is at rest [m/s]."""
    close_travel: float = 0.003
    """Pads at rest that have moved less than this have not started to close [m]."""
    close_timeout: float = 2.0

    # confirm, lift
    confirm_readings: int = 15
    held_force: float = 0.8
    """Minimum mean force on each pad [N]."""
    empty_opening: float = 0.0
    """Opening of closed, empty pads [m]."""
    thickness_error: float = 0.12
    """Standard deviation of a layer's thickness between the pads, relative to the nominal thickness."""
    opening_noise: float = 0.0003
    """Minimum assumed standard deviation of one opening reading [m]: twice the usual."""
    layer_doubt: float = 0.05
    """The planned number of layers is rejected below this probability."""
    kept_force: float = 0.6
    """Fraction of the confirmed force that a lifted grasp must keep."""
    kept_opening: float = 0.6
    """The same for the opening."""

    # slip
    slip_baseline_readings: int = 12
    slip_fraction: float = 0.5
    """A grip force below this fraction of its baseline is a loss."""
    slip_opening_fraction: float = 0.4
    """An opening below this fraction of its baseline is a loss. Pads that lost the cloth press on each other and
    still feel force."""
    slip_sigmas: float = 5.5
    """Distance between holding and losing that the mean must resolve, in standard deviations."""
    slip_least_readings: int = 3
    """Minimum number of readings in the mean: one wrong reading is not a slip."""
    slip_most_readings: int = 10
    """Maximum number of readings in the mean. At 100 Hz a loss shows after 60 ms; 100 ms are allowed."""
    slip_drift_time: float = 3.0
    """Time constant of the baseline's adaptation to slow changes [s]."""
    slip_anchor: float = 0.75
    """Lower bound of the baseline, relative to its first value, so that a slow slip is detected too."""

    # release, stuck
    release_force: float = 10.0
    release_tolerance: float = 0.002
    release_timeout: float = 2.0
    stuck_readings: int = 20
    stuck_force: float = 0.10
    """Minimum residual force on one pad after release and retreat that counts as cloth on the finger [N]."""
    stuck_sigmas: float = 4.5
    drift_ratio: float = 2.0
    """Ratio of a cell's slow drift to its noise, both as standard deviations. Noisier cells drift more."""
    drift_time: float = 120.0
    """Shortest period of the drift [s]."""


def without_tactile(settings: GraspSettings) -> GraspSettings:
    """Settings whose force thresholds are never reached: only the arms' and the grippers' own measurements count.
    To measure what the tactile sensors are worth."""
    return replace(
        settings,
        contact_force=math.inf,
        press_force=math.inf,
        close_force=math.inf,
        held_force=-math.inf,
        kept_force=-math.inf,
        slip_fraction=0.0,
        stuck_force=math.inf,
    )
