"""Watching a grip through the fold: a loss is known within 100 ms, and noise is no loss.

Two signals are watched: the weaker pad's force, and the opening (pads that lost the cloth close on one
another and feel force again). Each has a baseline from its first readings, which then follows slow drift but
never far down, so that a slow slip is not taken for drift. A signal is judged by the mean of its last n
readings; n is the smallest that tells holding from losing by `slip_sigmas` at today's noise, and a signal
that would need too many to be told in time is left out. A gripper says its opening less often than the cells are
read (Baxter's at 20 Hz): each of its words counts once, and a loss that only the opening tells is known as many
words later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.confirm import Held
from skills.grasping.hand_reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Failure, FailureKind, Outcome

__all__ = ["Channel", "SlipWatch", "start_slip_watch", "watch_slip"]

NORMAL_DIFFERENCE = 0.6745 * 2.0**0.5
"""Median absolute difference of two normal readings, in standard deviations of one."""


@dataclass(frozen=True)
class Channel:
    """One watched signal: how low it may fall, and the readings that it is judged by.

    readings: n of the mean, 0 while the baseline is gathered, None when the noise is too large to judge it.
    stamp: when its newest reading was taken note of [s].
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
        """Whether the mean of the last readings is below what still counts as held."""
        judged = bool(self.readings) and len(self.recent) == self.readings
        return judged and self.mean < self.fraction * self.baseline


@dataclass(frozen=True, eq=False)
class SlipWatch:
    """stamp, gripper_stamp: of the newest tactile reading and of the newest gripper state [s]."""

    settings: GraspSettings
    tare: TactileBias
    grip: Channel
    opening: Channel
    stamp: float = -np.inf
    gripper_stamp: float = -np.inf


def start_slip_watch(settings: GraspSettings, tare: TactileBias, held: Held) -> SlipWatch:
    """`held`: what the lift check found. Its figures stand in until the watch has its own baseline, so that a
    loss in the first readings is seen too."""
    grip = Channel(settings.slip_fraction, held.grip, held.grip, tare.pad_noise)
    opening = held.opening - settings.empty_opening
    return SlipWatch(
        settings, tare, grip, Channel(settings.slip_opening_fraction, opening, opening, settings.opening_noise)
    )


def watch_slip(reading: HandReading, state: SlipWatch) -> SlipWatch | Outcome[SlipWatch]:
    """One tick of a watch that only ever ends in a failure: SLIPPED, or what `fault` says."""
    bad = fault(reading, state.settings)
    if bad:
        return Outcome(failure=bad)
    if reading.tactile.stamp <= state.stamp:
        return state
    s, now = state.settings, reading.tactile.stamp
    grip, opening = _follow(state.grip, float(state.tare.pads(reading).min()), now, s), state.opening
    if reading.gripper.stamp > state.gripper_stamp:  # the same word again is no further evidence
        opening = _follow(opening, reading.gripper.opening - s.empty_opening, now, s)
    if grip.lost or opening.lost:
        return Outcome(failure=_slipped(reading, grip, opening))
    return replace(state, grip=grip, opening=opening, stamp=now, gripper_stamp=reading.gripper.stamp)


def _follow(channel: Channel, value: float, now: float, s: GraspSettings) -> Channel:
    recent = (*channel.recent, value)
    if channel.readings == 0:
        return _gather(replace(channel, recent=recent, stamp=now), s)
    if channel.readings is None:
        return channel
    dt = now - channel.stamp
    channel = replace(channel, recent=recent[-channel.readings :], stamp=now)
    if channel.mean < 0.5 * (1.0 + channel.fraction) * channel.baseline:
        return channel  # perhaps on its way down: no time to adapt
    rate = 1.0 - float(np.exp(-dt / s.slip_drift_time))
    followed = channel.baseline + rate * (value - channel.baseline)
    return replace(channel, baseline=max(followed, s.slip_anchor * channel.first))


def _gather(channel: Channel, s: GraspSettings) -> Channel:
    """First readings: judged against the confirmed grasp; when there are enough, they make the baseline."""
    n = _resolving(channel, s)
    if n is not None and len(channel.recent) >= n:
        last = replace(channel, readings=n, recent=channel.recent[-n:])
        if last.lost:
            return last
    if len(channel.recent) < s.slip_baseline_readings:
        return channel
    # The confirmed figure bounds the baseline: a grip that was lost meanwhile must not become normal.
    # Medians: a loss among the very last of these readings must pass neither for baseline nor for noise.
    baseline = max(float(np.median(channel.recent)), s.slip_anchor * channel.first)
    noise = max(channel.noise, float(np.median(np.abs(np.diff(channel.recent)))) / NORMAL_DIFFERENCE)
    ready = replace(channel, baseline=baseline, noise=noise)
    n = _resolving(ready, s)
    return replace(ready, readings=n, recent=ready.recent[-n:] if n else ())


def _resolving(channel: Channel, s: GraspSettings) -> int | None:
    """How many readings tell holding from losing at this noise; None: more than there is time for."""
    gap = (1.0 - channel.fraction) * channel.baseline
    if gap <= 0.0:
        return None
    n = int(np.ceil((s.slip_sigmas * channel.noise / gap) ** 2))
    return None if n > s.slip_most_readings else max(n, s.slip_least_readings)


def _slipped(reading: HandReading, grip: Channel, opening: Channel) -> Failure:
    by = "grip" if grip.lost else "opening"
    return Failure(
        FailureKind.SLIPPED,
        f"the {reading.tactile.side} hand lost the cloth ({by} fell)",
        "look where the garment lies; grasp with more cloth or more force",
        {
            "by": by,
            "force_n": float(reading.tactile.grip),
            "force_baseline_n": grip.baseline,
            "opening_m": reading.gripper.opening,
            "opening_baseline_m": opening.baseline,
        },
    )
