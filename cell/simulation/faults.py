"""Faults on demand: what a script or a test lets go wrong, and when.

    cell.faults.add(Fault(FaultKind.MISSED_GRASP, side=Side.LEFT, grasp=1))
    cell.faults.add(Fault(FaultKind.CAMERA_FREEZE, at=30.0, duration=5.0))

A fault waits for everything that it states (a cell time, the n-th grasp of a side, a fold) and then happens
once. Only simulated cells can be hurt like this.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from robots.errors import ConfigurationError
from robots.ports import Side

__all__ = ["Fault", "FaultBoard", "FaultKind"]


class FaultKind(StrEnum):
    MISSED_GRASP = "missed_grasp"
    """The garment slips out of a pinch as it closes."""
    DROPPED_CORNER = "dropped_corner"
    """A held corner slips out once it is lifted by `size` [m] (default 0.06)."""
    SUDDEN_DROP = "sudden_drop"
    """An arm drops by `size` [m] at the tool (default 0.03) and comes back within `duration` [s]."""
    GRIPPER_STUCK = "gripper_stuck"
    """A gripper does not move, for `duration` [s]."""
    CAMERA_FREEZE = "camera_freeze"
    """The camera gives its last picture again, for `duration` [s]."""
    CAMERA_BLACK = "camera_black"
    """Its pictures are black and without depth, for `duration` [s]."""
    CAMERA_SILENT = "camera_silent"
    """It does not answer (DriverError), for `duration` [s]."""
    NO_GARMENT = "no_garment"
    """The attendant lays nothing."""


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
    """What goes wrong, and when.

    side: which arm; None: whichever meets the conditions first. at: not before this cell time [s]. grasp: the
    n-th closing of that side's pads on cloth, from 1. fold: while the n-th fold is under way, from 0 (folds are
    counted by lifted garments let go again). size [m], duration [s] (None: until the end): see FaultKind.
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
                f"fault {self.kind}: a time before the start, a grasp below 1 or a fold below 0",
                "cell time counts from 0 s, grasps from 1, folds from 0",
                at_s=self.at, grasp=self.grasp, fold=self.fold,
            )  # fmt: skip
        if self.side is not None and self.kind not in _ARM_KINDS:
            raise ConfigurationError(f"fault {self.kind} has no side", "leave `side` out")
        if self.grasp is not None and self.kind not in _GRASP_KINDS:
            raise ConfigurationError(
                f"fault {self.kind} does not count grasps", "leave `grasp` out; use `at` or `fold`"
            )
        if self.size is not None and self.kind not in _DEFAULT_SIZE:
            raise ConfigurationError(f"fault {self.kind} has no size", "leave the size out")
        if self.duration is not None and self.kind not in _LASTING_KINDS:
            raise ConfigurationError(f"fault {self.kind} happens at once", "leave the duration out")

    @property
    def extent(self) -> float:
        """`size`, or the kind's default [m]."""
        return self.size if self.size is not None else _DEFAULT_SIZE.get(self.kind, 0.0)

    @property
    def lasts(self) -> float:
        """`duration`, or the kind's default [s]."""
        return self.duration if self.duration is not None else _DEFAULT_DURATION.get(self.kind, float("inf"))


class FaultBoard:
    """The faults of one world: those that wait, those that last, and what happened (for the record of truth)."""

    def __init__(self) -> None:
        self._waiting: list[Fault] = []
        self._lasting: list[tuple[Fault, float, Side | None]] = []
        """Each with its end [s], and the side that met its conditions."""
        self.happened: list[tuple[float, Fault]] = []

    @property
    def empty(self) -> bool:
        """No fault was ever asked for."""
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
        """The first waiting fault of this kind whose conditions hold, which has then happened."""
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
        """Whether a fault of this kind is under way (starting it if it is due)."""
        self.take(kind, now, fold, side)
        return any(
            fault.kind is kind and now < end and (met is None or met is side) for fault, end, met in self._lasting
        )
