"""A simulated hand: readings of known forces and openings through noisy, drifting sensors.

It uses none of the code under test. The noise figures are those of the simulated cell; `scale` multiplies them
all.
"""

from __future__ import annotations

import numpy as np

from foldcell.robots.ports import GripperState, Side, TactileReading
from foldcell.skills.grasping.hand_reading import HandReading

RATE = 100.0
CELL_NOISE, CELL_GAIN, CELL_DRIFT, DRIFT_TIME = 0.01, 0.01, 0.02, 120.0
TIP_NOISE, OPENING_NOISE, FORCE_NOISE, EFFORT_NOISE = 0.03, 0.00015, 0.3, 0.3
TABLE_STIFFNESS, CLOTH_STIFFNESS, ARM_STIFFNESS = 2500.0, 250.0, 1500.0
GRIPPER_SPEED, FORCE_TIME = 0.10, 0.05


class SensedHand:
    """A hand whose true values a test sets: `pads`, `tip`, `opening`, `height`, `effort`. `read` advances time by
    one reading."""

    def __init__(self, seed: int, scale: float = 1.0) -> None:
        self.rng = np.random.default_rng([seed, round(10 * scale)])
        self.scale = scale
        self.now = 0.0
        self.pads, self.tip = np.zeros(2), np.zeros(2)
        self.opening, self.height, self.effort = 0.035, 0.05, np.zeros(7)
        self.gain = 1.0 + self.scale * CELL_GAIN * self.rng.standard_normal((2, 4, 3))
        self.phase = self.rng.uniform(0.0, 2 * np.pi, (2, 4, 3))
        self.offset = 0.0
        share = self.rng.uniform(0.5, 1.5, (2, 4, 3))  # how a pad's force is distributed over its cells
        self.share = share / share.sum(axis=(1, 2), keepdims=True)
        self._sensed = self.gain * self.share

    @property
    def drift(self) -> np.ndarray:
        """(2, 4, 3) present error of each cell [N]. `offset` is added to all cells."""
        wave = np.sin(2 * np.pi * self.now / DRIFT_TIME + self.phase)
        return self.offset + self.scale * CELL_DRIFT * np.sqrt(2.0) * wave

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def read(self) -> HandReading:
        self.wait(1 / RATE)
        noise = self.scale * self.rng.standard_normal(40)
        cells = self._sensed * self.pads[:, None, None]
        cells += self.drift
        cells += CELL_NOISE * noise[:24].reshape(2, 4, 3)
        tactile = TactileReading(self.now, Side.LEFT, cells, self.tip + TIP_NOISE * noise[24:26])
        opening, force = self.opening + OPENING_NOISE * noise[26], 0.5 * (self.pads[0] + self.pads[1])
        force += FORCE_NOISE * noise[27]
        gripper = GripperState(self.now, Side.LEFT, opening, force, False, True)
        return HandReading(self.now, tactile, gripper, self.height, self.effort + EFFORT_NOISE * noise[28:35])


class DescendingHand(SensedHand):
    """An arm that follows commanded heights with a lag and yields under load, over cloth on a hard table at height
    0."""

    def __init__(self, seed: int, scale: float = 1.0, top: float = 0.0025, floor: float = 0.0) -> None:
        super().__init__(seed, scale)
        self.top, self.floor, self.stiffness = top, floor, ARM_STIFFNESS
        self.lag = self.rng.uniform(0.02, 0.06)
        self.wanted = self.height
        self.lever = np.array(
            [0.0, 0.7, 0.1, 0.5, 0.0, 0.2, 0.0]
        )  # lever arm of a force at the tool, for each joint [m]
        self.peak = 0.0
        self.follow(self.height)

    def follow(self, command: float) -> None:
        """One tick: the unloaded height follows the command, and the load pushes the arm back against its
        stiffness."""
        self.wanted += (command - self.wanted) * (1 - np.exp(-1 / RATE / self.lag))
        self.height = self.wanted if self.wanted >= self.top else self._rest_height()
        force = self.reaction(self.height)
        self.tip = force * np.array([0.6, 0.4])
        self.effort = np.array([0.0, 20.0, 0.0, 8.0, 0.0, 1.0, 0.0]) + 4.0 * self.height + force * self.lever
        self.peak = max(self.peak, force)

    def reaction(self, height: float) -> float:
        """Force on both tips together at this height of the tool [N]."""
        cloth = min(max(self.top - height, 0.0), self.top - self.floor) * CLOTH_STIFFNESS
        return float(2 * (cloth + max(self.floor - height, 0.0) * TABLE_STIFFNESS))

    def _rest_height(self) -> float:
        """Height at which the arm's spring towards `wanted` balances the contact force [m]."""
        low, high = self.wanted, self.top
        for _ in range(20):
            middle = (low + high) / 2
            if self.reaction(middle) > self.stiffness * (middle - self.wanted):
                low = middle
            else:
                high = middle
        return (low + high) / 2


class ClosingHand(SensedHand):
    """Pads that close at the gripper's speed onto cloth of thickness `thickness`, then press."""

    def __init__(self, seed: int, scale: float = 1.0, thickness: float = 0.0025, jammed: bool = False) -> None:
        super().__init__(seed, scale)
        self.thickness, self.jammed = thickness, jammed

    def drive(self, opening: float, force: float) -> None:
        """One tick towards a command."""
        if self.jammed:
            return
        goal = max(opening, self.thickness)
        step = GRIPPER_SPEED / RATE
        self.opening += float(np.clip(goal - self.opening, -step, step))
        pressing = opening < self.thickness + 1e-6 and self.opening <= goal + 1e-6
        aim = force if pressing else 0.0
        self.pads = self.pads + (aim - self.pads) * (1 - np.exp(-1 / RATE / FORCE_TIME))
