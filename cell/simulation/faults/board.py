"""The faults that were injected into one simulated cell: waiting, active and past ones."""

from __future__ import annotations

from foldcell.cell.simulation.faults.fault import Fault
from foldcell.cell.simulation.faults.kinds import FaultKind
from foldcell.robots.ports import Side


class FaultBoard:
    """The faults of one world: waiting faults, active faults, and past faults (for the ground truth).

    now: the world's present time [s]; fold: number of the present fold, from 0. The world sets both. The cell's
    clock is ahead of the world's time by `clock_offset` [s], and `Fault.at` is a time of that clock.
    """

    def __init__(self) -> None:
        self.now, self.fold = 0.0, 0
        self._waiting: list[Fault] = []
        self._lasting: list[tuple[Fault, float, Side | None]] = []
        """Active faults, each with its end [s] and the side that met its conditions."""
        self.happened: list[tuple[float, Fault]] = []
        self.clock_offset = 0.0

    @property
    def empty(self) -> bool:
        """Whether no fault was ever added."""
        return not (self._waiting or self.happened)

    def add(self, fault: Fault) -> None:
        self._waiting.append(fault)

    def take(
        self,
        kind: FaultKind,
        side: Side | None = None,
        grasp: int | None = None,
        lifted: float = 0.0,
    ) -> Fault | None:
        """Trigger and return the first waiting fault of this kind whose conditions hold; None if there is none."""
        for fault in self._waiting:
            if (
                fault.kind is kind
                and self.now + self.clock_offset >= fault.at
                and (fault.side is None or fault.side is side)
                and (fault.grasp is None or fault.grasp == grasp)
                and (fault.fold is None or fault.fold == self.fold)
                and (kind is not FaultKind.DROPPED_CORNER or lifted >= fault.extent)
            ):
                self._waiting.remove(fault)
                self._lasting.append((fault, self.now + fault.lasts, side))
                self.happened.append((self.now, fault))
                return fault
        return None

    def active(self, kind: FaultKind, side: Side | None = None) -> Fault | None:
        """Return the first active fault of this kind; None if there is none. Also triggers a waiting fault whose
        conditions hold."""
        if self.empty:
            return None
        self.take(kind, side)
        return next(
            (
                fault
                for fault, end, affected in self._lasting
                if fault.kind is kind and self.now < end and (affected is None or affected is side)
            ),
            None,
        )

    def end(self, kind: FaultKind, side: Side | None = None) -> None:
        """End the active faults of this kind that affect `side`."""
        self._lasting = [
            (fault, end, affected)
            for fault, end, affected in self._lasting
            if fault.kind is not kind or affected not in (None, side)
        ]
