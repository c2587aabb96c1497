"""Whole runs of the simulated cell for tests: cheap settings, and an onlooker that observes and interferes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.runs.checkpoint_writer import Interrupted
from foldcell.cell.runs.decide_again import Verdict, decide_again
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.simulation import Fault
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.ports import Array, JointSetpoint, Ports

PLAIN: Mapping[str, Mapping[str, Any]] = {"optimiser": {"method": "initial", "use_library": False}}
"""One simulation instead of an optimisation, for tests in which the quality of the fold does not matter."""

FEW_PICTURES: Mapping[str, Any] = {"key_frames": 2}
"""The least number of pictures of a fold. No decision depends on them, and rendering them takes long."""


def fold_request(
    folder: Path,
    settings: Mapping[str, Any] = PLAIN,
    *,
    garment: str = "small_towel",
    seed: int = 1,
    **changes: Any,
) -> FoldRequest:
    """A request for a run with its journal in `folder`/logs. By default it has no recording and no score, and
    few pictures of each fold."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cell.yaml"
    (folder / "logs").mkdir(exist_ok=True)
    options: dict[str, Any] = {"quiet": True, "record": False, "record_truth": False, **changes}
    settings = {"recorder": FEW_PICTURES, **settings}
    path.write_text(yaml.safe_dump({k: dict(v) for k, v in settings.items()}), encoding="utf-8")
    return FoldRequest(
        garment=garment, seed=seed, driver="sim", settings=load_settings(path),
        logs=folder / "logs", **options,
    )  # fmt: skip


def once_folded_towel(folder: Path) -> str:
    """The path of a new garment file in `folder`: the small towel, whose plan ends after its first fold. No run
    that folds a garment is shorter."""
    data = yaml.safe_load(shipped_garment_path("small_towel").read_text(encoding="utf-8"))
    data["plan"], data["edge_pairs"], data["final_layers"] = data["plan"][:1], data["edge_pairs"][1:], 2
    path = folder / "small_towel.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return str(path)


def decided_again(logs: Path, run: str = "last") -> Verdict:
    """Replay the decisions of a recorded run."""
    with Journal.open(logs / "journal.db", readonly=True) as journal:
        record = journal.run(run)
        return decide_again(record, journal.entries(record.id))


@dataclass(frozen=True, eq=False)
class LastCommand:
    """One set-point: its effect, the command that the driver got, and the command that the driver sent."""

    t: float
    effect: Effect
    q: Array
    qd: Array
    sent: JointSetpoint


@dataclass
class Onlooker:
    """Observes a run: it notes every effect, event and set-point, and may act before and after an effect.

    `before` and `after` get (ports, commands, n). n counts the executions of this effect, from 1. `at_set_point`
    is called after each set-point.
    """

    before: dict[Effect, Callable[[Ports, CommandQueue, int], object]] = field(default_factory=dict)
    after: dict[Effect, Callable[[Ports, CommandQueue, int], object]] = field(default_factory=dict)
    at_set_point: Callable[[Ports, Effect, float], object] = lambda ports, effect, t: None
    performed: list[tuple[Effect, Event]] = field(default_factory=list)
    results: list[Result] = field(default_factory=list)
    set_points: list[LastCommand] = field(default_factory=list)
    last_q: Array = field(default_factory=lambda: np.zeros(14))
    openings: list[float] = field(default_factory=list)
    under_way: Effect = Effect.NOTHING
    cell: OpenCell | None = None
    ports: Ports | None = None
    """The ports of the cell itself, without the recorder: the onlooker's calls are not recorded."""

    def fold(
        self,
        request: FoldRequest,
        script: Callable[[Ports], object] = lambda ports: None,
        interrupted: Interrupted | None = None,
    ) -> RunRecord:
        """Run `fold_once` under observation."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "foldcell.cell.runs.fold_run.EFFECTS", {e: self._watched(e, f) for e, f in EFFECTS.items()}
            )

            def begin(cell: OpenCell, commands: CommandQueue) -> None:
                self.cell, self.ports = cell, cell.ports
                self._listen(patch, cell.ports)
                script(cell.ports)

            return fold_once(request, begin, interrupted=interrupted)

    def inject(self, fault: Fault) -> None:
        """Inject a fault into the simulated cell."""
        assert self.cell is not None and self.cell.simulated is not None
        self.cell.simulated.faults.add(fault)

    def count(self, effect: Effect) -> int:
        return sum(1 for e, _ in self.performed if e is effect)

    def events(self, effect: Effect) -> list[Event]:
        """The events with which an effect ended, in order."""
        return [event for e, event in self.performed if e is effect]

    def kinds(self) -> list[str]:
        """The kinds of all failures, in order."""
        failing = {Event.FAILED, Event.CRASH, Event.STOP}
        return [r.context.failure.kind.value for r in self.results if r.event in failing and r.context.failure]

    def _watched(self, effect: Effect, perform: Callable[[Workcell, RunContext], Result]) -> Any:
        def watched(cell: Workcell, context: RunContext) -> Result:
            self.under_way = effect
            n, ports = self.count(effect) + 1, self.ports
            assert ports is not None
            if effect in self.before:
                self.before[effect](ports, cell.commands, n)
            try:
                result = perform(cell, context)
            except Exception:
                self.performed.append((effect, Event.FAILED))
                raise
            self.performed.append((effect, result.event))
            self.results.append(result)
            self.last_q = ports.arms.state().q
            self.openings = [gripper.state().opening for gripper in ports.grippers.values()]
            if effect in self.after:
                self.after[effect](ports, cell.commands, n)
            return result

        return watched

    def _listen(self, patch: pytest.MonkeyPatch, ports: Ports) -> None:
        arms = type(ports.arms)
        command = arms.command

        def heard(port: Any, q: Array, qd: Array) -> JointSetpoint:
            sent = command(port, q, qd)
            self.set_points.append(LastCommand(ports.clock.now(), self.under_way, np.array(q), np.array(qd), sent))
            self.at_set_point(ports, self.under_way, ports.clock.now())
            return sent

        patch.setattr(arms, "command", heard)
