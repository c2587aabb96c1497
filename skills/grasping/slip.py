"""Controller that detects a slip during the fold, within 100 ms and without false alarms from noise.

Two signals are monitored: the force of the less loaded pad, and the opening, because pads that lost the cloth
press on each other and feel force again. The first readings give each signal's baseline. The baseline then follows
slow drift, but only down to a bound, so that a slow slip is not mistaken for drift. A signal is judged by the mean
of its last n readings. n is the smallest number for which baseline and limit of loss are `SLIP_SIGMAS` standard
deviations of the mean apart, at the measured noise. A signal that would need too many readings is ignored. A
gripper reports its opening less often than the cells report forces (for example at 20 Hz). Each report counts
once, so a loss that shows only in the opening is detected later.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from foldcell.skills.grasping.confirm import OPENING_NOISE, Held
from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.live_pads import ConstantPads, watch_pads
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome, refuse, skill

SLIP_BASELINE_READINGS = 12
"""Number of readings from which a signal's baseline follows."""
SLIP_SIGMAS = 5.5
"""Minimum distance between a signal's baseline and the value below which the cloth counts as lost, in standard
deviations of the mean of the last readings. The number of averaged readings follows from this distance."""
SLIP_LEAST_READINGS = 3
"""Minimum number of readings in the mean, so that one wrong reading does not count as a slip."""
SLIP_MOST_READINGS = 10
"""Maximum number of readings in the mean. At 100 Hz a loss is then detected after about 60 ms, within the
required 100 ms."""
SLIP_DRIFT_TIME = 3.0
"""Time constant of the baseline's adaptation to slow changes [s]."""
SLIP_ANCHOR = 0.75
"""Lower bound of the baseline, relative to its first value. Because of this bound, the baseline cannot follow
a slow slip down to zero, so the slip is detected."""

NORMAL_DIFFERENCE = 0.6745 * 2.0**0.5
"""Median absolute difference of two normally distributed readings, divided by the standard deviation of a
reading."""


@dataclass(frozen=True)
class Channel:
    """One monitored signal [N] or [m].

    fraction: share of the baseline below which the cloth counts as lost. first: initial baseline. noise: standard
    deviation of one reading. readings: number n of readings in the mean, 0 while the baseline is measured, None
    when the noise is too large. stamp: of the newest reading [s].
    """

    fraction: float
    first: float = 0.0
    baseline: float = 0.0
    noise: float = 0.0
    readings: int | None = 0
    recent: tuple[float, ...] = ()
    stamp: float = -np.inf

    @property
    def mean(self) -> float:
        return sum(self.recent) / len(self.recent)

    @property
    def lost(self) -> bool:
        """Whether the mean of the last readings is below the given fraction of the baseline."""
        complete = bool(self.readings) and len(self.recent) == self.readings
        return complete and self.mean < self.fraction * self.baseline


@dataclass(frozen=True, eq=False)
class SlipWatch:
    """State of the slip detection. stamp, gripper_stamp: of the newest tactile reading and gripper state [s]."""

    settings: GraspSettings
    bias: TactileBias
    grip: Channel
    opening: Channel
    stamp: float = -np.inf
    gripper_stamp: float = -np.inf
    constant: ConstantPads = field(default_factory=ConstantPads)


def start_slip_watch(settings: GraspSettings, bias: TactileBias, held: Held) -> SlipWatch:
    """Start the detection. held: the result of the lift check.

    Its values serve as the baseline until the detection has its own, so that an immediate loss is detected too.
    """
    grip = Channel(settings.slip_fraction, held.grip, held.grip, bias.pad_noise)
    opening = held.opening - settings.empty_opening
    return SlipWatch(
        settings, bias, grip, Channel(settings.slip_opening_fraction, opening, opening, OPENING_NOISE)
    )


@skill
def watch_slip(reading: HandReading, state: SlipWatch) -> SlipWatch | Outcome[SlipWatch]:
    """Process the reading of one tick. The detection ends only with a failure: SLIPPED, TACTILE_FAULT (a pad's
    readings are constant, so that it would not show a slip), or those of `validate_reading`."""
    refuse(validate_reading(reading))
    if reading.tactile.stamp <= state.stamp:
        return state
    s, now = state.settings, reading.tactile.stamp
    forces = state.bias.pads(reading)
    constant = watch_pads(reading.tactile.side, forces, state.constant, s)
    grip, opening = _update_channel(state.grip, float(forces.min()), now), state.opening
    if reading.gripper.stamp > state.gripper_stamp:  # a repeated report is not counted
        opening = _update_channel(opening, reading.gripper.opening - s.empty_opening, now)
    if grip.lost or opening.lost:
        return Outcome(failure=_slipped(reading, grip, opening))
    return replace(
        state, grip=grip, opening=opening, stamp=now, gripper_stamp=reading.gripper.stamp, constant=constant
    )


def _update_channel(channel: Channel, value: float, now: float) -> Channel:
    recent = (*channel.recent, value)
    if channel.readings == 0:
        return _measure_baseline(replace(channel, recent=recent, stamp=now))
    if channel.readings is None:
        return channel
    recent = recent[-channel.readings :]
    baseline = channel.baseline
    if not sum(recent) / len(recent) < 0.5 * (1.0 + channel.fraction) * baseline:  # else a loss may have begun
        rate = 1.0 - float(np.exp(-(now - channel.stamp) / SLIP_DRIFT_TIME))
        baseline = max(baseline + rate * (value - baseline), SLIP_ANCHOR * channel.first)
    return replace(channel, recent=recent, stamp=now, baseline=baseline)


def _measure_baseline(channel: Channel) -> Channel:
    """Compare the first readings with the confirmed grasp, and set the baseline when there are enough readings."""
    n = _required_readings(channel)
    if n is not None and len(channel.recent) >= n:
        candidate = replace(channel, readings=n, recent=channel.recent[-n:])
        if candidate.lost:
            return candidate
    if len(channel.recent) < SLIP_BASELINE_READINGS:
        return channel
    # The confirmed value bounds the baseline, so that the force of a grip that is already lost cannot become the
    # baseline. Medians are used, so that a loss in the last of these readings affects neither baseline nor noise.
    baseline = max(float(np.median(channel.recent)), SLIP_ANCHOR * channel.first)
    noise = max(channel.noise, float(np.median(np.abs(np.diff(channel.recent)))) / NORMAL_DIFFERENCE)
    with_baseline = replace(channel, baseline=baseline, noise=noise)
    n = _required_readings(with_baseline)
    return replace(with_baseline, readings=n, recent=with_baseline.recent[-n:] if n else ())


def _required_readings(channel: Channel) -> int | None:
    """Number n of readings whose mean separates held from lost cloth at this noise; None if n would be too
    large."""
    gap = (1.0 - channel.fraction) * channel.baseline
    if gap <= 0.0:
        return None
    n = int(np.ceil((SLIP_SIGMAS * channel.noise / gap) ** 2))
    return None if n > SLIP_MOST_READINGS else max(n, SLIP_LEAST_READINGS)


def _slipped(reading: HandReading, grip: Channel, opening: Channel) -> Failure:
    by = "grip" if grip.lost else "opening"
    return Failure(
        FailureKind.SLIPPED,
        f"the {reading.tactile.side} hand lost the cloth ({by} fell)",
        "check where the garment lies; grasp more cloth or use more force",
        {
            "side": reading.tactile.side.value,
            "by": by,
            "force_n": float(reading.tactile.grip),
            "force_baseline_n": grip.baseline,
            "opening_m": reading.gripper.opening,
            "opening_baseline_m": opening.baseline,
        },
    )
