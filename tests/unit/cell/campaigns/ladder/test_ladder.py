"""The ladder at a cell without dynamics: a sound cell passes, and each fault fails exactly at its step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from foldcell.cell.calibrating.session import CalibrationRequest
from foldcell.cell.campaigns.ladder import climb as climbing
from foldcell.cell.campaigns.ladder import runs as ladder_runs
from foldcell.cell.campaigns.ladder.climb import FAILED, FRESH_S, Climbed, Passes, StepResult, climb, climb_cell
from foldcell.cell.campaigns.ladder.page import write_page
from foldcell.cell.campaigns.ladder.rung import Recording, Rung
from foldcell.cell.campaigns.ladder.runs import ScriptedRuns
from foldcell.cell.campaigns.ladder.steps import STEPS
from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.contract.rig import BrokenError
from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import JointSetpoint, JointState, Ports, Side, TactileReading, frozen
from tests.broken_drivers import (
    Break,
    along_the_ray,
    brakes_late,
    degrees,
    first_two_exchanged,
    forgetful,
    mirrored,
    motors_on_after_a_reset,
    nan_is_zero,
    never_holds,
    wall_clock,
    with_command,
    with_gripper,
    with_picture,
    with_state,
)
from tests.fakes import FakeCell
from tests.kinematic_cell import KinematicCell, kinematic_rig
from tests.workcells import fake_workcell

SETTINGS = load_settings()
IN_THE_CELL = [step for step in STEPS if step.check is not None]
WITH_RUNS = [step for step in STEPS if step.runs is not None]


class Journal:
    """Notes the intents and results of a run."""

    def __init__(self) -> None:
        self.intents: list[str] = []
        self.results: list[Mapping[str, Any]] = []

    def intent(self, t: float, state: str, name: str, payload: Mapping[str, Any]) -> int:
        self.intents.append(name)
        return len(self.intents)

    def result(self, intent: int, t: float, payload: Mapping[str, Any]) -> None:
        self.results.append(payload)


def climbed(broken: Break, journal: Journal | None = None) -> tuple[list[StepResult], Ports]:
    recording = Recording()
    with kinematic_rig(SETTINGS, camera_calibration(SETTINGS), SETTINGS.table, broken) as rig:
        ports = recording.between(rig.ports)
        rig = replace(rig, ports=ports)
        limits = rig.model.commissioning
        models = {"robot": rig.model, "checker": rig.checker, "execution_checker": rig.checker, "limits": limits}
        cell = fake_workcell(FakeCell(), ports=ports, **models)
        run: Any = journal or Journal()
        return list(climb_cell(Rung(rig, cell, lambda what: None), IN_THE_CELL, run, recording)), ports


def slow_clock(cell: KinematicCell) -> Ports:
    def sleep_until(t: float) -> None:
        cell.sleep_until(t + 0.5 * (t - cell.t))

    return replace(cell.ports(), clock=forwarding(cell, sleep_until=sleep_until))


def with_reading(change: Any) -> Break:
    def broken(cell: KinematicCell) -> Ports:
        ports = cell.ports()
        pads: dict[Side, Any] = {
            side: forwarding(hand, reading=lambda hand=hand: change(hand, hand.reading()))
            for side, hand in cell.hands.items()
        }
        return replace(ports, tactile=pads)

    return broken


def dead(_: Any, reading: TactileReading) -> TactileReading:
    return replace(reading, cells=frozen(np.zeros_like(reading.cells)), tip=frozen(np.zeros(2)))


def no_tips(_: Any, reading: TactileReading) -> TactileReading:
    return replace(reading, tip=frozen(reading.cells[0, 0, :2].copy()))


def closed_pads_press(hand: Any, reading: TactileReading) -> TactileReading:
    return replace(reading, cells=frozen(reading.cells + (0.5 if hand.opening < 0.001 else 0.0)))


def last_joint_stuck(cell: KinematicCell, state: JointState) -> JointState:
    q = state.q.copy()
    q[-1] = cell.model.q_park[-1]
    return replace(state, q=frozen(q))


def weak_together(cell: KinematicCell, q: Any, qd: Any) -> JointSetpoint:
    """The right arm stands while both arms are to go further than a single joint's turn."""
    if len(q) != len(cell.q):
        return cell.command(q, qd)
    half, away = len(q) // 2, np.abs(q - cell.model.q_park) * (np.arange(len(q)) % 7 < 6)
    if min(away[:half].max(), away[half:].max()) > 0.04:
        q, qd = q.copy(), qd.copy()
        q[half:], qd[half:] = cell.q[half:], 0.0
    return cell.command(q, qd)


FAULTS: dict[str, Break] = {
    "clock": slow_clock,
    "connection": with_state(degrees),
    "joint state": with_state(wall_clock),
    "enable": with_command(nan_is_zero),
    "stop at rest": motors_on_after_a_reset,
    "grippers": with_gripper(command=forgetful),
    "pads": with_reading(dead),
    "head": mirrored,
    "camera": with_picture(along_the_ray),
    "one joint": with_state(last_joint_stuck),
    "each joint": with_state(first_two_exchanged),
    "both arms": with_command(weak_together),
    "stop in motion": brakes_late,
    "link loss": never_holds,
    "guarded descent": with_reading(no_tips),
    "grasp nothing": with_reading(closed_pads_press),
}


def test_a_sound_cell_passes_every_step_and_the_page_shows_it(tmp_path: Path) -> None:
    journal = Journal()
    results, ports = climbed(KinematicCell.ports, journal)
    assert [(r.of.name, r.reason) for r in results if not r.passed] == []
    assert journal.intents == [step.name for step in IN_THE_CELL] == list(FAULTS)
    assert len(journal.results) == len(results) and not ports.stop.state().stopped
    figures = {name: value for r in results for name, value in r.figures.items()}
    assert any(words == f"rest {figures['rest_s']:.4g} s" for r in results for words in r.measured)
    assert figures["rest_s"] > 0.0 and figures["left_rise_m"] == pytest.approx(0.05, abs=2e-3)
    page = write_page(tmp_path, Climbed(results, True, None, None), "kinematic", True, "commissioning")
    text = page.read_text()
    assert "16 of 20 steps passed" in text and "simulated" in text and text.count("not tried") == 4
    assert text.count("<svg") >= 5 and "src=" not in text


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_fails_exactly_its_step_and_leaves_the_arms_stopped(name: str) -> None:
    results, ports = climbed(FAULTS[name])
    assert [(r.of.name, r.reason) for r in results[:-1] if not r.passed] == []
    assert (results[-1].of.name, results[-1].state) == (name, "failed"), results[-1].reason
    assert ports.stop.state().stopped


@pytest.mark.parametrize("broken", [step.name for step in WITH_RUNS])
def test_a_scripted_run_that_fails_fails_its_step(
    broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = {
        "hold": "grasp a cloth",
        "pull": "pull until it slips",
        "approved_fold": "one fold",
        "stop_in_fold": "stop in a fold",
    }

    def run_script(script: Any, settings: Any, logs: Path, **_: Any) -> Any:
        bad = order[script.name] == broken
        record = SimpleNamespace(run_dir=str(tmp_path / script.name), robot_time_s=1.0)
        return SimpleNamespace(passed=not bad, broken=("it fell",) if bad else (), result=record)

    monkeypatch.setattr(ladder_runs, "run_script", run_script)
    resumed = SimpleNamespace(result="folded", failure=None, robot_time_s=2.0)
    monkeypatch.setattr(ScriptedRuns, "_resumed", lambda self, run: resumed)
    passes = Passes(tmp_path / "passes.json")
    for step in IN_THE_CELL:
        passes.note(StepResult(step, "passed"))
    request = CalibrationRequest("ladder", 0, "sim", SETTINGS, tmp_path, False, lambda text: None)
    end = climb(request, WITH_RUNS[0].name, passes, lambda question: True)
    assert [r.passed for r in end.results] == [True] * (len(end.results) - 1) + [False]
    assert end.results[-1].of.name == broken and "it fell" in end.results[-1].reason and end.safe


def test_a_person_presses_each_pad_of_a_real_cell() -> None:
    """The cell without dynamics stands for a robot; its person presses what a line asks for."""
    (pads,) = [step for step in STEPS if step.name == "pads"]
    asked: list[str] = []

    def pressed(hand: Any, reading: TactileReading) -> TactileReading:
        cells = reading.cells.copy()
        for pad in range(2):
            cells[pad] += 0.2 * bool(asked and f"pad {pad} of the {hand.side} hand" in asked[-1])
        return replace(reading, cells=frozen(cells))

    def real(cell: KinematicCell) -> Ports:
        return replace(with_reading(pressed)(cell), simulated=False)

    def perform(obeyed: bool) -> None:
        with kinematic_rig(SETTINGS, camera_calibration(SETTINGS), SETTINGS.table, real) as rig:
            assert pads.check is not None
            pads.check(Rung(rig, cast(Any, None), asked.append if obeyed else lambda text: None))

    perform(True)
    assert len(asked) == len(set(asked)) == 4
    asked.clear()
    with pytest.raises(BrokenError, match="pad 0 of the left hand has not felt a finger"):
        perform(False)


def test_a_step_is_begun_only_if_those_before_it_have_passed_within_a_day(tmp_path: Path) -> None:
    now = [1000.0 + FRESH_S]
    passes = Passes(tmp_path / "passes.json", lambda: now[0])
    request = CalibrationRequest("ladder", 0, "sim", SETTINGS, tmp_path, False, lambda text: None)

    def refused(begin: str) -> str:
        with pytest.raises(ConfigurationError) as caught:
            climb(request, begin, passes, lambda question: True)
        return caught.value.what

    assert "'clock' has not passed" in refused("connection")
    assert "no step 'roof'" in refused("roof")
    for step in STEPS[:4]:
        passes.note(StepResult(step, "passed"))
    again = Passes(tmp_path / "passes.json", lambda: now[0])
    assert again.missing(STEPS[:4]) is None and again.missing(STEPS) is STEPS[4]
    again.note(StepResult(STEPS[2], "failed"))
    assert again.missing(STEPS[:2]) is None and again.missing(STEPS[:4]) is STEPS[2]
    now[0] += FRESH_S + 1.0
    assert again.missing(STEPS[:2]) is STEPS[0]


def test_an_interrupted_ladder_stops_the_arms_and_goes_no_further() -> None:
    recording = Recording()
    with kinematic_rig(SETTINGS, camera_calibration(SETTINGS), SETTINGS.table, KinematicCell.ports) as rig:
        rig = replace(rig, ended=lambda: rig_now() > 1.5)

        def rig_now() -> float:
            return rig.now

        run: Any = Journal()
        results = list(climb_cell(Rung(rig, None, lambda what: None), IN_THE_CELL, run, recording))  # type: ignore[arg-type]
        assert results[-1].state == "not_run" and "interrupted" in results[-1].reason and len(results) < 4
        assert rig.ports.stop.state().reason == FAILED


def test_the_page_of_the_documentation_lists_the_steps() -> None:
    text = (Path(__file__).resolve().parents[5] / "docs/do/bring_up.md").read_text()
    rows = [f"| {step.name} | {step.proves} | {step.moves} | {step.person} |" for step in STEPS]
    assert [line for line in text.splitlines() if line.startswith("| ")][1:] == rows


@pytest.mark.parametrize(
    "words",
    ["ladder --from roof", "ladder --live", "ladder --world mujoco", "tests/hil/no_garment.yaml --from clock"],
)
def test_the_command_refuses_before_anything_moves(words: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(climbing, "perform_session", None)  # nothing is opened
    assert main(["hil", *words.split(), "--logs", str(tmp_path)]) == 64
