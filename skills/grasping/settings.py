"""Thresholds of the grasping controllers, with units. Where the sensors' noise matters, it is said how."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["GraspSettings"]


@dataclass(frozen=True)
class GraspSettings:
    """All lengths in metres, forces in newtons, times in seconds of the readings' stamps."""

    # readings
    tactile_stale: float = 0.10
    """Oldest tactile reading to act on [s]."""
    gripper_stale: float = 0.50
    """Oldest gripper state to act on [s]: electric grippers report at 20 Hz."""
    zero_readings: int = 12
    """Tactile readings that make a zero."""

    # descend
    approach_speed: float = 0.06
    """Down to `slow_above` over the expected contact [m/s]."""
    guarded_speed: float = 0.02
    """From there on [m/s]: 0.2 mm a reading, 0.5 N a reading on a rubber tip."""
    acceleration: float = 0.15
    """Of the commanded height [m/s2]."""
    slow_above: float = 0.015
    early_margin: float = 0.030
    """Touching something this far above the expected contact is not the garment."""
    contact_force: float = 0.35
    """Rise of a tip's force over its zero: over 5 sigma at twice a tip's noise of 0.03 N."""
    press_stiffness: float = 400.0
    """Cloth that is pressed flat under a tip bears less than this [N/m]; terry was taken to bear 250."""
    contact_readings: int = 3
    contact_effort: float = 9.0
    """Rise of a joint's effort over its running mean [Nm]: about 12 N at the hand, well over what an arm in
    motion shows by its own jitter (4 Nm in the simulated cell)."""
    effort_readings: int = 4
    effort_time: float = 1.0
    """Time constant of that running mean [s]: gravity's share changes slowly in a descent, a push does not."""
    stall_lag: float = 0.006
    """An arm that stays this far behind its guarded descent is held up by something [m]: 9 N on Baxter's,"""
    stall_window: float = 0.10
    """if over this time [s]"""
    stall_speed: float = 0.006
    """it comes down more slowly than this [m/s]: one that is late catches up."""
    lead: float = 0.010
    """How far the commanded height may run ahead of the measured one."""
    bottom_wait: float = 1.0
    """How long the arm may take to follow a command that waits for it [s]."""

    # press
    press_force: float = 25.0
    """Rise of a tip's force at which a hand that presses, for its pads to close under the cloth, stops."""

    # close
    grip_force: float = 15.0
    """Squeeze asked of the gripper."""
    close_force: float = 4.0
    """Force on both pads at which they count as closed."""
    close_readings: int = 3
    still_window: float = 0.12
    still_speed: float = 0.008
    """An opening that changes slower than this over the window stands still [m/s]."""
    close_travel: float = 0.003
    """Pads that stand still before they moved this far have not started."""
    close_timeout: float = 2.0

    # confirm, lift
    confirm_readings: int = 15
    held_force: float = 0.8
    """Least mean force on each pad."""
    empty_opening: float = 0.0
    """Opening of closed pads with nothing between [m]."""
    thickness_error: float = 0.12
    """Standard deviation of a layer's thickness between the pads, as a share of the nominal one."""
    opening_noise: float = 0.0003
    """Standard deviation of one opening reading that is always reckoned with: twice the usual."""
    layer_doubt: float = 0.05
    """The planned number of layers is given up below this probability."""
    kept_fraction: float = 0.6
    """Share of the confirmed force and opening that a lifted grasp must keep."""

    # slip
    slip_baseline_readings: int = 12
    slip_fraction: float = 0.5
    """A grip under this share of its baseline is lost."""
    slip_opening_fraction: float = 0.4
    """The same for the opening: pads that lost the cloth close on one another and still feel force."""
    slip_sigmas: float = 5.5
    """Distance between holding and losing that a mean of readings must resolve."""
    slip_least_readings: int = 3
    """Shortest mean: one wrong reading is no slip."""
    slip_most_readings: int = 10
    """Longest mean: a loss shows when about half of it lies behind, 60 ms at 100 Hz; 100 ms are allowed."""
    slip_drift_time: float = 3.0
    """Time constant with which the baseline follows slow changes [s]."""
    slip_anchor: float = 0.75
    """The baseline never falls below this share of its first value: a slow slip is a slip."""

    # release, stuck
    release_force: float = 10.0
    release_tolerance: float = 0.002
    release_timeout: float = 2.0
    stuck_readings: int = 20
    stuck_force: float = 0.10
    """Least residual force on one pad after release and retreat that counts as cloth on the finger."""
    stuck_sigmas: float = 4.5
    drift_ratio: float = 2.0
    """Standard deviation of a cell's slow drift over that of its noise: noisier cells drift more."""
    drift_time: float = 120.0
    """Shortest period of that drift [s]."""
