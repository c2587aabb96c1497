"""Climb the ladder: perform its steps in order until one does not pass, and remember which have passed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from foldcell.cell.calibrating.session import CalibrationEnd, CalibrationRequest, Session, perform_session
from foldcell.cell.campaigns.ladder.rung import Curve, Recording, Rung
from foldcell.cell.campaigns.ladder.runs import ScriptedRuns
from foldcell.cell.campaigns.ladder.steps import STEPS, Step
from foldcell.cell.executive.effects.moving import hold_still, make_safe
from foldcell.cell.hardware.contract.opening import rig_of
from foldcell.cell.hardware.contract.result import Result, judged
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import RunJournal
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.cell.support.json_values import to_json
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.vocabulary import Outcome

STATE = "ladder"
FRESH_S = 24 * 3600.0
"""A step that passed counts for this time [s]."""
FAILED = "a step of the ladder did not pass"


@dataclass(frozen=True, eq=False)
class StepResult(Result[Step]):
    """curve: the arms meanwhile."""

    curve: Curve | None = None


@dataclass(frozen=True)
class Climbed:
    """results: of the steps that were tried. safe: whether the cell was left at rest. signal: the signal that
    ended the ladder. run_dir: the run of the steps before the scripted runs, if any of them was tried."""

    results: Sequence[StepResult]
    safe: bool
    signal: int | None
    run_dir: Path | None


class Passes:
    """When each step has passed, in a file for one robot and driver. now: the wall clock [s]."""

    def __init__(self, path: Path, now: Callable[[], float] = time.time) -> None:
        self._path, self._now = path, now
        self._passed: dict[str, float] = json.loads(path.read_text()) if path.exists() else {}

    def missing(self, steps: Sequence[Step]) -> Step | None:
        """Return the first of the steps that has not passed within a day."""
        return next((s for s in steps if self._now() - self._passed.get(s.name, 0.0) > FRESH_S), None)

    def note(self, result: StepResult) -> None:
        """A step that does not pass also takes back the steps after it."""
        names = [step.name for step in STEPS]
        for name in names[names.index(result.of.name) :] if not result.passed else ():
            self._passed.pop(name, None)
        if result.passed:
            self._passed[result.of.name] = self._now()
        write_whole(self._path, json.dumps(self._passed, indent=1) + "\n")


def climb(
    request: CalibrationRequest,
    begin: str,
    passes: Passes,
    confirm: Callable[[str], bool],
    steps: Sequence[Step] = STEPS,
) -> Climbed:
    """Perform the steps from `begin` on, until one does not pass. A failure stops the arms; the person resets the
    stop before the next try.

    Raises ConfigurationError if a step before `begin` has not passed within the day, and as `perform_session`.
    """
    names = [step.name for step in steps]
    if begin not in names:
        raise ConfigurationError(f"there is no step '{begin}'", f"the steps are {', '.join(names)}")
    missing = passes.missing(steps[: names.index(begin)])
    if missing is not None:
        raise ConfigurationError(
            f"the step '{missing.name}' has not passed within the day",
            f"begin there: foldcell hil ladder --from '{missing.name}'",
        )
    steps = steps[names.index(begin) :]
    results, safe, signal, run_dir = list[StepResult](), True, None, None

    def tried(result: StepResult) -> None:
        results.append(result)
        passes.note(result)
        request.say(str(result))

    if steps[0].check is not None:
        end = _in_the_cell(request, [step for step in steps if step.check is not None], tried)
        safe, signal, run_dir = end.safe, end.signal, end.run_dir
    if all(result.passed for result in results) and safe and signal is None:
        for result in _with_runs(request, [step for step in steps if step.runs is not None], confirm):
            tried(result)
    return Climbed(results, safe, signal, run_dir)


def _in_the_cell(
    request: CalibrationRequest, steps: Sequence[Step], tried: Callable[[StepResult], None]
) -> CalibrationEnd[Sequence[StepResult]]:
    def work(session: Session) -> tuple[Outcome[Sequence[StepResult]], bool]:
        recording = Recording()
        cell = replace(session.cell, ports=recording.between(session.cell.ports))
        rig = rig_of(replace(session.opened, ports=cell.ports), request.settings, session.ended)
        rung = Rung(rig, cell, session.say)
        results = []
        for result in climb_cell(rung, steps, session.run, recording):
            results.append(result)
            tried(result)
        return Outcome(results), _left_safe(cell, all(result.passed for result in results))

    def figures(results: Sequence[StepResult], _: object) -> Mapping[str, Any]:
        return {"steps": [result.as_json() for result in results]}

    return perform_session(request, work, figures)


def climb_cell(rung: Rung, steps: Sequence[Step], run: RunJournal, recording: Recording) -> Iterator[StepResult]:
    """Perform steps in the open cell, each with intent and result in the journal, up to the first that does not
    pass. Then stop the arms."""
    clock = rung.rig.ports.clock
    for step in steps:
        intent = run.intent(clock.now(), STATE, step.name, {"moves": step.moves})
        began = time.monotonic()
        assert step.check is not None
        state, reason, figures = judged(step.check, rung)
        if rung.rig.ended():
            state, reason = "not_run", "the ladder was interrupted"
        event = "done" if state == "passed" else "failed"
        run.result(intent, clock.now(), {"event": event, "state": state, "what": reason, "figures": dict(figures)})
        if state != "passed":
            rung.rig.ports.stop.trigger(FAILED)
        yield StepResult(step, state, reason, time.monotonic() - began, figures, curve=recording.take())
        if state != "passed":
            return


def _left_safe(cell: Workcell, passed: bool) -> bool:
    """Park the arms after the last step. Arms that are stopped only come to rest."""
    if not passed or cell.ports.stop.state().stopped:
        return not hold_still(cell, RunContext()).record
    return make_safe(cell, RunContext()).context.failure is None


def _with_runs(
    request: CalibrationRequest, steps: Sequence[Step], confirm: Callable[[str], bool]
) -> Iterator[StepResult]:
    for step in steps:
        runs = ScriptedRuns(
            request.settings, request.logs, request.driver, request.seed, request.say,
            (lambda question: True) if is_simulated(request.driver) else confirm, [],
        )  # fmt: skip
        assert step.runs is not None
        began = time.monotonic()
        state, reason, figures = judged(step.runs, runs)
        yield StepResult(step, state, reason, time.monotonic() - began, figures, tuple(runs.reports))
        if state != "passed":
            return


def write_results(folder: Path, climbed: Climbed, driver: str) -> Mapping[str, Any]:
    """Write `ladder.json` and return its content."""
    content: dict[str, Any] = {
        "schema": 1, "driver": driver, "simulated": is_simulated(driver), "safe": climbed.safe,
        "passed": sum(result.passed for result in climbed.results), "steps": len(STEPS),
        "run_dir": climbed.run_dir and str(climbed.run_dir),
        "results": [result.as_json() for result in climbed.results],
    }  # fmt: skip
    write_whole(folder / "ladder.json", json.dumps(to_json(content), indent=1) + "\n")
    return content
