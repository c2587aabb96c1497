"""The scripted runs of the ladder's last steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foldcell.cell.campaigns.hil.script import Script
from foldcell.cell.campaigns.hil.script_run import ScriptResult, run_script
from foldcell.cell.campaigns.ladder.pull import pulling
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.executive.runner import EffectFunction
from foldcell.cell.hardware.contract.rig import require
from foldcell.cell.hardware.driver import stop_circuit
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.states.transition_table import Effect
from foldcell.cell.support.files.paths import journal_path

GARMENT = "small_towel"
HOLD_S = 10.0
REASON = "a step of the ladder"


@dataclass(frozen=True, eq=False)
class ScriptedRuns:
    """Performs scripted runs at the cell. confirm: asks a person at a robot, and returns whether the person
    agrees. reports: the folders of the runs so far."""

    settings: CellSettings
    logs: Path
    driver: str
    seed: int
    tell: Callable[[str], None]
    confirm: Callable[[str], bool]
    reports: list[str]

    def hold(self) -> Mapping[str, float]:
        """Pause a fold with the cloth in the hands, and go on."""
        pause = {"when": {"state": "folding", "after_s": 1.0}, "say": "pause"}
        go_on = {"when": {"state": "folding", "after_s": 1.0 + HOLD_S}, "say": "resume"}
        end = {"when": {"state": "optimising", "visit": 2}, "say": "abort"}
        expect = {"end": ["not_folded"], "folds": 1, "through": ["folding", "releasing"], "parked": True}
        return self._passed("hold", {"do": [pause, go_on, end], "expect": expect})

    def pull(self) -> Mapping[str, float]:
        """Pull the cloth apart in the place of a fold, until a hand reports that it slips."""
        figures: dict[str, float] = {}
        end = {"when": {"state": "looking", "visit": 2}, "say": "abort"}
        expect = {
            "end": ["not_folded"], "folds": 0, "failures": ["slipped", "aborted"], "only_failures": True,
            "through": ["folding", "laying_back", "looking"], "parked": True,
        }  # fmt: skip
        passed = self._passed("pull", {"do": [end], "expect": expect}, {Effect.FOLD: pulling(figures)})
        return {**passed, **figures}

    def approved_fold(self) -> Mapping[str, float]:
        """Approve the first fold, and end the run before the second. At a robot a person answers, and
        may go on."""
        answers = [
            {"when": {"state": "awaiting_approval", "visit": visit, "after_s": 1.0}, "say": say}
            for visit, say in ((1, "approve"), (2, "abort"))
        ]
        through = ["awaiting_approval", "approaching"]
        expect: dict[str, Any] = {"end": ["not_folded"], "folds": 1, "through": through, "parked": True}
        if not is_simulated(self.driver):
            answers = []
            expect = {"end": ["folded", "not_folded"], "through": [*through, "inspecting"], "parked": True}
        return self._passed("approved_fold", {"attended": True, "do": answers, "expect": expect})

    def stop_and_resume(self) -> Mapping[str, float]:
        stop = {"when": {"state": "folding", "after_s": 1.0}, "stop": REASON}
        expect = {"end": ["stopped"], "not_through": ["releasing"], "parked": False}
        stopped = self._performed("stop_in_fold", {"do": [stop], "expect": expect})
        if not is_simulated(self.driver):
            agreed = self.confirm("The arms hold the cloth. Is the cause cleared, and nobody within reach?")
            require(agreed, "the person did not agree to reset the stop")
            with stop_circuit(self.settings) as circuit:
                circuit.reset()
        resumed = self._resumed(Path(stopped.run_dir).name)
        why = resumed.failure.what if resumed.failure else ""
        require(resumed.result != "fault", f"the resumed run ended as a fault: {why}")
        return {"robot_time_s": resumed.robot_time_s}

    def _passed(
        self, name: str, script: Mapping[str, Any], instead: Mapping[Effect, EffectFunction] | None = None
    ) -> Mapping[str, float]:
        return {"robot_time_s": self._performed(name, script, instead).robot_time_s}

    def _performed(
        self, name: str, script: Mapping[str, Any], instead: Mapping[Effect, EffectFunction] | None = None
    ) -> RunRecord:
        made = Script.model_validate({"about": name, "garment": GARMENT, "seed": self.seed, **script})
        made._path = Path(f"{name}.yaml")
        return self._kept(
            run_script(made, self.settings, self.logs, driver=self.driver, tell=self.tell, instead=instead)
        )

    def _kept(self, result: ScriptResult) -> RunRecord:
        if result.result is not None:
            self.reports.append(result.result.run_dir)
        require(result.passed, "; ".join(result.broken))
        assert result.result is not None
        return result.result

    def _resumed(self, run: str) -> RunRecord:
        from foldcell.cell.runs.checkpoint_writer import interrupted_run
        from foldcell.cell.runs.fold_run import fold_once

        with Journal.open(journal_path(self.logs), readonly=True) as journal:
            interrupted = interrupted_run(journal, run, self.logs, quiet=True)
        record = fold_once(interrupted.request, interrupted=interrupted)
        self.reports.append(record.run_dir)
        return record
