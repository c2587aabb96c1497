"""Faults in whole runs: each is detected, recovered within limits, and ends in a declared and safe state.

An operator's abort ends most runs as soon as the tested behaviour has occurred. The scripts of tests/hil show more
faults.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.journal.journal import Journal, performed
from foldcell.cell.planning.fold_planning import plan_arms
from foldcell.cell.simulation import Fault, FaultKind
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Ports
from foldcell.skills.trajectory.search.optimise import optimise_fold
from foldcell.skills.vocabulary import Outcome
from tests.runs import PLAIN, Onlooker, decided_again, fold_request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def abort(ports: Ports, commands: CommandQueue, n: int) -> None:
    commands.put(Event.ABORT)


def parked(onlooker: Onlooker) -> bool:
    """Whether the arms are parked and the hands open."""
    return bool(np.abs(onlooker.last_q - load_model().q_park).max() < 0.02 and min(onlooker.openings) > 0.03)


def told(request: FoldRequest) -> list[Any]:
    with Journal.open(request.logs / "journal.db", readonly=True) as journal:
        return journal.entries(journal.run("last").id)


# the journal


def test_losing_the_journal_during_a_fold_ends_the_run_as_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hands hold the garment in place, the run ends as a fault, and the result explains the missing files."""
    journals: list[Journal] = []
    opened = Journal.open

    def keep(path: Path) -> Journal:
        journals.append(opened(path))
        return journals[-1]

    def lose(*_: Any) -> None:
        journals[0]._connection.execute("PRAGMA query_only = ON")

    monkeypatch.setattr("foldcell.cell.runs.ownership.Journal.open", keep)
    onlooker, request = Onlooker(before={Effect.FOLD: lose}), fold_request(tmp_path, record=True)
    result = onlooker.fold(request)
    monkeypatch.undo()
    assert (result.result, result.state, result.exit_code) == ("fault", "fault", 3)
    assert result.failure.kind == "unrecorded" and "free the garment from the hands" in result.failure.hint
    assert [effect for effect, _ in onlooker.performed[-2:]] == [Effect.FOLD, Effect.HOLD]
    held = [s for s in onlooker.set_points if s.effect is Effect.HOLD]
    assert len(held) == 1 and not np.any(held[0].qd)
    assert min(onlooker.openings) < 0.01, "the hands still hold the garment"
    with Journal.open(request.logs / "journal.db", readonly=True) as journal:
        assert journal.run("last").status == "interrupted"
        assert performed(journal.entries(journal.run("last").id))[-1].name == "fold"
    again = decided_again(request.logs)
    assert again.same and again.broken_off == "the journal of the run breaks off here"


# seeing


@pytest.mark.parametrize("kind", [FaultKind.CAMERA_FREEZE, FaultKind.CAMERA_SILENT])
def test_a_broken_camera_is_retried_before_the_run_ends(kind: FaultKind, tmp_path: Path) -> None:
    """The camera breaks after the picture of the empty table; a frozen one keeps showing that table."""
    onlooker, request = Onlooker(), fold_request(tmp_path, {"recovery": {"patience": 3.0}})
    onlooker.after[Effect.PHOTOGRAPH_TABLE] = lambda ports, commands, n: onlooker.inject(Fault(kind))
    result = onlooker.fold(request)
    assert (result.state, result.exit_code) == ("not_folded", 2)
    assert 1 <= onlooker.events(Effect.CHOOSE_RECOVERY).count(Event.LOOK_AGAIN) <= 4
    expected = {FaultKind.CAMERA_FREEZE: {"camera_fault", "no_garment"}}.get(kind, {"camera_fault"})
    assert set(onlooker.kinds()) <= expected and result.failure.kind in expected
    assert onlooker.count(Effect.APPROACH) == 0 and parked(onlooker)


def test_a_camera_failure_during_a_fold_changes_neither_the_fold_nor_its_inspection(tmp_path: Path) -> None:
    """Pictures during a fold are for the recording only. Afterwards the folded garment is inspected and not
    recognised as a smaller flat one."""
    onlooker, request = Onlooker(), fold_request(tmp_path, {"recorder": {"key_frames": 6}, **PLAIN})
    onlooker.after[Effect.LIFT] = lambda ports, commands, n: onlooker.inject(
        Fault(FaultKind.CAMERA_SILENT, duration=8.0)
    )
    onlooker.after[Effect.INSPECT] = abort
    onlooker.fold(request)
    assert onlooker.events(Effect.FOLD) == [Event.DONE]
    assert onlooker.events(Effect.CHOOSE_RECOVERY)[0] is Event.LOOK_AFTER
    assert onlooker.events(Effect.INSPECT) == [Event.NEXT_FOLD]


def test_the_empty_table_is_photographed_after_a_camera_recovers(tmp_path: Path) -> None:
    onlooker, request = Onlooker(), fold_request(tmp_path)
    onlooker.after[Effect.PREPARE] = lambda ports, commands, n: onlooker.inject(
        Fault(FaultKind.CAMERA_BLACK, duration=0.8)
    )
    onlooker.after[Effect.PLAN_FOLDS] = abort
    onlooker.fold(request)
    assert onlooker.events(Effect.PHOTOGRAPH_TABLE) == [Event.FAILED, Event.DONE]
    assert onlooker.events(Effect.CHOOSE_RECOVERY) == [Event.START_OVER]
    assert onlooker.events(Effect.RECOGNISE) == [Event.DONE]


# planning


def test_the_initial_arc_is_used_when_the_optimiser_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    methods = []

    def broken(step: Any, mesh: Any, vertices: Any, material: Any, method: str, *rest: Any, **options: Any) -> Any:
        methods.append(method)
        if method == "initial":
            return optimise_fold(step, mesh, vertices, material, method, *rest, **options)
        failure = Failure(FailureKind.OPTIMISER_FAILED, "no simulation came to an end", "look again")
        return Outcome(failure=failure, notes={"simulations": 7})

    monkeypatch.setattr("foldcell.cell.planning.fold_planning.optimise_fold", broken)
    onlooker = Onlooker()
    request = fold_request(tmp_path, {"optimiser": {"use_library": False}})
    onlooker.after[Effect.PLAN_MOTION] = abort
    result = onlooker.fold(request)
    assert methods == ["default", "initial"]
    assert onlooker.events(Effect.CHOOSE_TRAJECTORY) == [Event.FAILED, Event.DONE]
    assert onlooker.events(Effect.CHOOSE_RECOVERY) == [Event.OPTIMISE_AGAIN]
    assert onlooker.events(Effect.PLAN_MOTION) == [Event.DONE], "the initial arc can be executed"
    assert Adjustment.PLAIN_ARC in onlooker.results[-1].context.fold.adjustments
    assert (result.state, result.exit_code) == ("not_folded", 2)
    spent = [e.cell_time for e in told(request) if e.name == "choose_trajectory"]
    assert spent[1] - spent[0] == pytest.approx(0.7), "failed simulations are charged their time too"


def test_a_run_ends_when_the_optimiser_always_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failure = Failure(FailureKind.OPTIMISER_FAILED, "no simulation came to an end", "look again")
    monkeypatch.setattr(
        "foldcell.cell.planning.fold_planning.optimise_fold", lambda *_, **__: Outcome(failure=failure)
    )
    onlooker = Onlooker()
    result = onlooker.fold(fold_request(tmp_path))
    assert (result.state, result.failure.kind) == ("not_folded", "optimiser_failed")
    assert onlooker.count(Effect.CHOOSE_TRAJECTORY) == 2 and onlooker.count(Effect.APPROACH) == 0


def test_a_crashing_skill_ends_the_run_as_a_fault_with_parked_arms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("of course")

    monkeypatch.setattr("foldcell.cell.executive.effects.seeing.perceive", crash)
    onlooker, request = Onlooker(), fold_request(tmp_path)
    result = onlooker.fold(request)
    assert (result.result, result.exit_code) == ("fault", 3)
    assert result.failure.kind == "skill_crashed"
    assert onlooker.performed[-2] == (Effect.MAKE_SAFE, Event.DONE) and parked(onlooker)
    assert any("Traceback" in str(e.payload) for e in told(request))


def test_an_unreachable_fold_is_planned_in_the_other_variant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    which = "half"
    first = {step.name: step.variants[0].name for step in load_garment("small_towel").plan}

    def blocked(settings: Any, robot: Any, checker: Any, limits: Any, garment: Any, step: Any, *rest: Any) -> Any:
        if step.name == which and step.variant == first[which]:
            return Outcome(failure=Failure(FailureKind.UNREACHABLE, "something stands there", "move it"))
        return plan_arms(settings, robot, checker, limits, garment, step, *rest)

    monkeypatch.setattr("foldcell.cell.executive.effects.planning.plan_arms", blocked)
    onlooker = Onlooker(before={Effect.APPROACH: abort})
    request = fold_request(tmp_path, {}, seed=5, record=True)
    onlooker.fold(request)
    assert onlooker.events(Effect.CHOOSE_RECOVERY) == [Event.GRASP_AGAIN, Event.GRASP_AGAIN, Event.PLAN_AGAIN]
    ways = {step.name: step.variant for step in onlooker.results[-1].context.steps}
    assert {name for name, way in ways.items() if way != first[name]} == {which}
    assert onlooker.events(Effect.PLAN_MOTION)[-1] is Event.DONE and onlooker.kinds()[-1] == "aborted"
    again = decided_again(request.logs)
    assert again.same and again.broken_off is None, "the replay chooses the other variant too"


# laying back


def test_cloth_in_the_hands_is_laid_back_when_the_joint_state_is_lost_for_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The garment lies as before the fold, up to the slack of the cloth, and is found there."""
    onlooker, request = Onlooker(), fold_request(tmp_path, seed=5, record=True)
    lost: list[Any] = []
    shapes: list[Any] = []

    def note_shape(*_: Any) -> None:
        assert onlooker.cell is not None and onlooker.cell.simulated is not None
        garment = onlooker.cell.simulated.truth.now().garment
        assert garment is not None
        shapes.append(garment.vertices)

    def lose(ports: Ports, effect: Effect, t: float) -> None:
        if effect is not Effect.FOLD or lost:
            return
        began.append(t)
        if t - began[0] > 0.6:
            arms = type(ports.arms)
            last, now = ports.arms.state(), arms.state
            lost.append(t)
            monkeypatch.setattr(arms, "state", lambda port: last if ports.clock.now() < t + 1.0 else now(port))

    began: list[float] = []
    onlooker.at_set_point = lose
    onlooker.before[Effect.GRASP] = note_shape
    onlooker.after[Effect.CLEAR] = note_shape
    onlooker.after[Effect.RECOGNISE] = lambda ports, commands, n: abort(ports, commands, n) if n == 2 else None
    result = onlooker.fold(request)
    assert onlooker.kinds()[:1] == ["stale_state"]
    at = onlooker.performed.index((Effect.FOLD, Event.FAILED))
    assert onlooker.performed[at + 1 : at + 7] == [
        (Effect.LAY_BACK, Event.DONE), (Effect.CLEAR, Event.DONE), (Effect.CHOOSE_RECOVERY, Event.LOOK_AGAIN),
        (Effect.LOOK, Event.TOUCHED), (Effect.ESTIMATE, Event.DONE), (Effect.RECOGNISE, Event.DONE),
    ]  # fmt: skip
    moved = np.linalg.norm(shapes[1] - shapes[0], axis=1)
    assert moved.mean() < 0.01 and np.quantile(moved, 0.95) < 0.03, moved
    assert (result.state, result.exit_code) == ("not_folded", 2) and parked(onlooker)
    again = decided_again(request.logs)
    assert again.same and again.broken_off is None, "the replay lays the cloth back too"


# stop


def test_a_stop_ends_a_long_optimisation_promptly(tmp_path: Path) -> None:
    """The optimiser's threads stop computing, and their intermediate result is discarded."""
    onlooker = Onlooker()
    searching = {"optimiser": {"simulations": 300, "method": "paper", "use_library": False}}
    request = fold_request(tmp_path, searching, record=True)
    pressed: list[float] = []

    def press(ports: Ports) -> None:
        pressed.append(time.monotonic())
        ports.stop.trigger("the button")

    onlooker.before[Effect.CHOOSE_TRAJECTORY] = lambda ports, c, n: threading.Timer(1.0, press, [ports]).start()
    result = onlooker.fold(request)
    assert time.monotonic() - pressed[0] < 15.0
    assert (result.state, result.failure.kind) == ("stopped", "stopped")
    assert not (request.logs / "library.json").exists()
    again = decided_again(request.logs)
    assert again.same and again.broken_off is None and again.wall_time_s < 15.0, (
        "the replay does not run the discarded search"
    )


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_stops_the_run_and_is_named_as_its_reason(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    before = signal.getsignal(number)
    onlooker, request = Onlooker(), fold_request(tmp_path)
    onlooker.before[Effect.LOOK] = lambda ports, commands, n: os.kill(os.getpid(), number)
    result = onlooker.fold(request)
    assert (result.state, result.exit_code, result.signal) == ("stopped", code, number)
    assert number.name in result.failure.what
    assert signal.getsignal(number) is before, "the signal handler is restored"
    assert onlooker.performed[-1][0] is Effect.HOLD
