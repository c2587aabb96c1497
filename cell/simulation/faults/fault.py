"""One fault of a simulated cell and the conditions for which it waits.

    cell.faults.add(Fault(FaultKind.MISSED_GRASP, side=Side.LEFT, grasp=1))
    cell.faults.add(Fault(FaultKind.CAMERA_FREEZE, at=30.0, duration=5.0))

A fault waits until all its conditions hold (cell time, number of the side's grasp, number of the fold). Then it
happens once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from foldcell.cell.simulation.faults.kinds import TRAITS, FaultKind, FaultTraits
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Side


@dataclass(frozen=True)
class Fault:
    """One fault and its conditions. Raises ConfigurationError for conditions that do not apply to its kind.

    side: the arm; None: the first arm that meets the conditions. at: earliest cell time [s]. grasp: number of the
    grasp in which the fault happens, from 1; each closing of that side's pads on cloth is a grasp. fold: number of
    the fold in which it happens, from 0; a fold ends when a lifted garment is released. size (in the unit of the
    kind), duration [s]: see FaultKind; None: the default of the kind. turn: angle [rad]. seed: draws what the
    fault leaves open, such as the direction of a shove.
    """

    kind: FaultKind
    side: Side | None = None
    at: float = 0.0
    grasp: int | None = None
    fold: int | None = None
    size: float | None = None
    duration: float | None = None
    turn: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        traits = self.traits
        if (
            self.at < 0.0
            or (self.grasp is not None and self.grasp < 1)
            or (self.fold is not None and self.fold < 0)
        ):
            raise ConfigurationError(
                f"fault {self.kind} has a time before the start, a grasp below 1 or a fold below 0",
                "cell time counts from 0 s, grasps from 1, folds from 0",
                at_s=self.at, grasp=self.grasp, fold=self.fold,
            )  # fmt: skip
        if self.side is not None and not traits.sided:
            raise ConfigurationError(f"fault {self.kind} has no side", "remove `side`")
        if self.grasp is not None and not traits.counts_grasps:
            raise ConfigurationError(
                f"fault {self.kind} does not count grasps", "remove `grasp`; use `at` or `fold`"
            )
        if self.size is not None:
            self._check_size(self.size)
        if self.duration is not None and traits.duration is None:
            raise ConfigurationError(f"fault {self.kind} happens at once", "remove the duration")
        if self.duration is not None and not self.duration >= 0.0:
            raise ConfigurationError(f"fault {self.kind} lasts {self.duration} s", "give 0 s or more")
        if self.turn and not traits.turns:
            raise ConfigurationError(f"fault {self.kind} has no angle", "remove the angle")

    def _check_size(self, size: float) -> None:
        traits = self.traits
        if traits.size is None:
            raise ConfigurationError(f"fault {self.kind} has no size", "remove the size")
        if not math.isfinite(size) or size == 0.0 or (size < 0.0 and not traits.signed):
            raise ConfigurationError(f"fault {self.kind} has the size {size}", "give a number above 0")
        if traits.unit == "share" and size > 1.0:
            raise ConfigurationError(f"fault {self.kind} has the size {size}", "a share is at most 1")

    @property
    def traits(self) -> FaultTraits:
        return TRAITS[self.kind]

    @property
    def extent(self) -> float:
        """Return `size`, or the kind's default, in the kind's unit."""
        return self.size if self.size is not None else self.traits.size or 0.0

    @property
    def lasts(self) -> float:
        """Return `duration`, or the kind's default [s]; infinite for a fault that happens at once."""
        given = self.traits.duration if self.duration is None else self.duration
        return math.inf if given is None else given
