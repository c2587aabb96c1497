"""Faults that a script or a test injects into a simulated cell.

    cell.faults.add(Fault(FaultKind.MISSED_GRASP, side=Side.LEFT, grasp=1))
    cell.faults.add(Fault(FaultKind.CAMERA_FREEZE, at=30.0, duration=5.0))

A fault waits until all its conditions hold (cell time, number of the side's grasp, number of the fold). Then it
happens once.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from robots.errors import ConfigurationError
from robots.ports import Side

__all__ = ["Fault", "FaultBoard", "FaultKind"]


class FaultKind(StrEnum):
    MISSED_GRASP = "missed_grasp"
    """The garment slips out of the pads while they close."""
    DROPPED_CORNER = "dropped_corner"
    """A held corner slips out when the hand is `size` [m] (default 0.06) above the table."""
    SUDDEN_DROP = "sudden_drop"
    """An arm drops by `size` [m] at the tool (default 0.03) and returns within `duration` [s] (default 0.4)."""
    GRIPPER_STUCK = "gripper_stuck"
    """A gripper does not move, for `duration` [s]."""
    CAMERA_FREEZE = "camera_freeze"
    """The camera repeats its last picture, for `duration` [s]."""
    CAMERA_BLACK = "camera_black"
    """The camera's pictures are black and without depth, for `duration` [s]."""
    CAMERA_SILENT = "camera_silent"
    """The camera does not answer (DriverError), for `duration` [s]."""
    NO_GARMENT = "no_garment"
    """The attendant lays no garment."""


_GRASP_KINDS = (FaultKind.MISSED_GRASP, FaultKind.DROPPED_CORNER)
_ARM_KINDS = (*_GRASP_KINDS, FaultKind.SUDDEN_DROP, FaultKind.GRIPPER_STUCK)
_DEFAULT_SIZE = {FaultKind.DROPPED_CORNER: 0.06, FaultKind.SUDDEN_DROP: 0.03}
_DEFAULT_DURATION = {FaultKind.SUDDEN_DROP: 0.4}
_LASTING_KINDS = (
    FaultKind.SUDDEN_DROP,
    FaultKind.GRIPPER_STUCK,
    FaultKind.CAMERA_FREEZE,
    FaultKind.CAMERA_BLACK,
    FaultKind.CAMERA_SILENT,
)


@dataclass(frozen=True)
class Fault:
    """One fault and its conditions. Raises ConfigurationError for conditions that do not apply to its kind.

    side: the arm; None: the first arm that meets the conditions. at: earliest cell time [s]. grasp: number of the
    grasp in which the fault happens, from 1; each closing of that side's pads on cloth is a grasp. fold: number of
    the fold in which it happens, from 0; a fold ends when a lifted garment is released. size [m], duration [s]:
    see FaultKind; None: the default of the kind. If the kind has no default duration, the fault then lasts until
    the end of the run.
    """

    kind: FaultKind
    side: Side | None = None
    at: float = 0.0
    grasp: int | None = None
    fold: int | None = None
    size: float | None = None
    duration: float | None = None

    def __post_init__(self) -> None:
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
        if self.side is not None and self.kind not in _ARM_KINDS:
            raise ConfigurationError(f"fault {self.kind} has no side", "remove `side`")
        if self.grasp is not None and self.kind not in _GRASP_KINDS:
            raise ConfigurationError(
                f"fault {self.kind} does not count grasps", "remove `grasp`; use `at` or `fold`"
            )
        if self.size is not None and self.kind not in _DEFAULT_SIZE:
            raise ConfigurationError(f"fault {self.kind} has no size", "remove the size")
        if self.duration is not None and self.kind not in _LASTING_KINDS:
            raise ConfigurationError(f"fault {self.kind} happens at once", "remove the duration")

    @property
    def extent(self) -> float:
        """Return `size`, or the kind's default [m]."""
        return self.size if self.size is not None else _DEFAULT_SIZE.get(self.kind, 0.0)

    @property
    def lasts(self) -> float:
        """Return `duration`, or the kind's default [s]."""
        return self.duration if self.duration is not None else _DEFAULT_DURATION.get(self.kind, float("inf"))


class FaultBoard:
    """The faults of one world: waiting faults, active faults, and past faults (for the ground truth)."""

    def __init__(self) -> None:
        self._waiting: list[Fault] = []
        self._lasting: list[tuple[Fault, float, Side | None]] = []
        """Active faults, each with its end [s] and the side that met its conditions."""
        self.happened: list[tuple[float, Fault]] = []

    @property
    def empty(self) -> bool:
        """Whether no fault was ever added."""
        return not (self._waiting or self._lasting)

    def add(self, fault: Fault) -> None:
        self._waiting.append(fault)

    def take(
        self,
        kind: FaultKind,
        now: float,
        fold: int,
        side: Side | None = None,
        grasp: int | None = None,
        lifted: float = 0.0,
    ) -> Fault | None:
        """Trigger and return the first waiting fault of this kind whose conditions hold; None if there is none."""
        for fault in self._waiting:
            if (
                fault.kind is kind
                and now >= fault.at
                and (fault.side is None or fault.side is side)
                and (fault.grasp is None or fault.grasp == grasp)
                and (fault.fold is None or fault.fold == fold)
                and (kind is not FaultKind.DROPPED_CORNER or lifted >= fault.extent)
            ):
                self._waiting.remove(fault)
                self._lasting.append((fault, now + fault.lasts, side))
                self.happened.append((now, fault))
                return fault
        return None

    def lasting(self, kind: FaultKind, now: float, fold: int, side: Side | None = None) -> bool:
        """Whether a fault of this kind is active. Also triggers a waiting fault whose conditions hold."""
        self.take(kind, now, fold, side)
        return any(
            fault.kind is kind and now < end and (affected is None or affected is side)
            for fault, end, affected in self._lasting
        )
