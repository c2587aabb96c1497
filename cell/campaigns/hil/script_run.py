"""Perform runs with scripted actions, and check the run of a script against the script's expectations."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foldcell.cell.campaigns.hil.director import Director, Observations
from foldcell.cell.campaigns.hil.script import LIMIT_S, Action, Script
from foldcell.cell.config.cell_settings import CellSettings, overlaid
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.transition_table import Effect, State
from foldcell.cell.support.junit import JUnitCase
from foldcell.robots.errors import CellError, ConfigurationError

if TYPE_CHECKING:
    from foldcell.cell.executive.runner import EffectFunction


@dataclass(frozen=True)
class ScriptResult:
    """Result of a script. broken: messages about expectations that were not met; result: result of the run, None
    if there was no run."""

    script: Script
    broken: tuple[str, ...]
    result: RunRecord | None
    seconds: float

    @property
    def passed(self) -> bool:
        return not self.broken

    @property
    def faulty(self) -> bool:
        """Whether the run did not start, or ended in a fault that the script does not expect."""
        if self.result is None:
            return True
        return self.result.state == State.FAULT and State.FAULT not in self.script.expect.end

    def as_case(self) -> JUnitCase:
        output = self.result.run_dir if self.result is not None else ""
        return JUnitCase(
            self.script.name, self.broken, seconds=self.seconds, file=str(self.script.path), output=output
        )

    def as_json(self) -> dict[str, Any]:
        run = self.result
        return {
            "script": str(self.script.path), "name": self.script.name, "passed": self.passed,
            "broken": list(self.broken), "garment": self.script.garment, "seed": self.script.seed,
            "end": run.state if run else None, "robot_time_s": run.robot_time_s if run else None,
            "wall_time_s": self.seconds, "run_dir": run.run_dir if run else None,
        }  # fmt: skip


def check_script(script: Script, settings: CellSettings, driver: str) -> CellSettings:
    """Check a script and return the settings for its run. Raises ConfigurationError for a script that this driver
    cannot run."""
    if script.needs_simulation and not is_simulated(driver):
        raise ConfigurationError(
            f"{script.path}: only a simulated cell has faults and is scored",
            "use `tell` to ask a person instead, leave out `passed`, or use --driver sim or emulator",
        )
    own = overlaid(settings, script.cell, script.path, script.setting_lines)
    if script.garment != "auto":
        load_garment(script.garment_named, own.surface)
    return own


def run_script(
    script: Script,
    settings: CellSettings,
    logs: Path,
    *,
    driver: str = "sim",
    world: str = "xpbd",
    live: bool = False,
    realtime: bool = False,
    tell: Callable[[str], None] = print,
    instead: Mapping[Effect, EffectFunction] | None = None,
) -> ScriptResult:
    """Perform the script in a run, whose folder is under `logs`. A run that cannot start counts as a broken
    expectation, so that the next script can still run. instead: see `fold_once`."""
    began = time.monotonic()
    try:
        own = check_script(script, settings, driver)
        request = FoldRequest(
            garment=script.garment_named, seed=script.seed, driver=driver, settings=own,
            logs=logs, live=live, approve=script.attended,
            terminal=not is_simulated(driver), realtime=realtime, world=world,
            quiet=True,
        )  # fmt: skip
        result, seen = fold_scripted(request, script.do, tell, script.limit_s, instead)
    except CellError as e:
        return ScriptResult(script, (f"there was no run: {e.what}",), None, time.monotonic() - began)
    broken = broken_expectations(script, result, seen)
    return ScriptResult(script, broken, result, time.monotonic() - began)


def fold_scripted(
    request: FoldRequest,
    actions: Sequence[Action],
    tell: Callable[[str], None],
    limit_s: float = LIMIT_S,
    instead: Mapping[Effect, EffectFunction] | None = None,
) -> tuple[RunRecord, Observations]:
    """Perform a run with scripted actions. The request's seed draws random moments. tell, limit_s: see
    `Director`; instead: see `fold_once`. Raises CellError if the run cannot start."""
    from foldcell.cell.runs.fold_run import fold_once

    director = Director(actions, load_robot(request.settings).q_park, tell, request.seed, limit_s)
    try:
        return fold_once(request, director.begin, (director,), instead=instead), director.seen()
    finally:
        director.close()


def broken_expectations(script: Script, result: RunRecord, seen: Observations) -> tuple[str, ...]:
    """Return the broken expectations, one sentence each; empty if the script passed. An action that was never
    carried out also counts as a broken expectation, because without it the script tests nothing."""
    return tuple(_broken(script, result, seen))


def _broken(script: Script, result: RunRecord, seen: Observations) -> Iterator[str]:
    expect = script.expect
    if seen.overdue:
        yield f"was still running after {script.limit_s:g} s (limit_s)"
    for what in seen.trouble:
        yield f"the script could not be carried out: {what}"
    if seen.sent_after_stop:
        yield f"{seen.sent_after_stop} set-points were sent after a stop"
    if result.state not in expect.end:
        why = f": {result.failure.what}" if result.failure else ""
        yield f"ended {result.state}{why}; expected {_words(expect.end, ' or ')}"
    if _first_missing(expect.failures, seen.failures):
        yield f"had the failures {_words(seen.failures)}; expected {_words(expect.failures)} in this order"
    others = [kind for kind in dict.fromkeys(seen.failures) if kind not in expect.failures]
    if expect.only_failures and others:
        yield f"also had the failures {_words(others)}; expected none but {_words(expect.failures)}"
    if left := _first_missing(expect.through, seen.states):
        yield f"never entered {left.value} as expected (through {_words(expect.through)})"
    for state in expect.not_through:
        if state in seen.states:
            yield f"entered {state.value}, which was not expected"
    made = sum(step.done for step in result.steps)
    if expect.folds is not None and made != expect.folds:
        yield f"made {made} folds; expected {expect.folds}"
    if expect.within_s is not None and result.robot_time_s > expect.within_s:
        yield f"took {result.robot_time_s:.1f} s of robot time; expected at most {expect.within_s:g} s"
    if expect.passed is not None and result.score is None:
        yield "there is no score"
    elif expect.passed is not None and result.score is not None and result.score.passed != expect.passed:
        yield f"the scorer {'passed' if result.score.passed else 'did not pass'} the run, unexpectedly"
    if expect.parked is not None and seen.parked != expect.parked:
        yield "the arms were not parked with open hands at the end" if expect.parked else "the arms were parked"
    for action in seen.missed:
        yield f"{action} ({action.when}) never happened"


def _first_missing(wanted: Sequence[StrEnum], found: Sequence[StrEnum]) -> StrEnum | None:
    """Return the first item that does not occur in this order; None if all do."""
    rest = iter(found)
    return next((w for w in wanted if w not in rest), None)


def _words(names: Sequence[StrEnum], between: str = ", ") -> str:
    return between.join(name.value for name in names) or "none"
