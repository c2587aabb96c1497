"""Resuming an interrupted run: the state it enters, and runs that cannot be resumed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foldcell.cell.journal.journal import Journal, RunJournal
from foldcell.cell.runs.checkpoint_writer import CheckpointWriter, interrupted_run
from foldcell.cell.runs.reentry import reentry_event
from foldcell.cell.runs.request_file import keep_request
from foldcell.cell.runs.resumable import RESUMED_FROM, check_resumable
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Event, State
from foldcell.robots.errors import ConfigurationError, Failure, FailureKind, StorageError
from foldcell.robots.ports import Side
from foldcell.skills.grasping.confirm import Held, LayerCount
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.vocabulary import PredictedShape
from tests.builders.contexts import context_with
from tests.runs import fold_request

S, E = State, Event
SEEN = [S.PREPARING, S.PHOTOGRAPHING, S.AWAITING_GARMENT, S.LOOKING, S.RECOGNISING, S.PLANNING, S.OPTIMISING,
        S.PLANNING_MOTION]  # fmt: skip
FOLD = [S.APPROACHING, S.GRASPING, S.LIFTING, S.FOLDING, S.RELEASING, S.RETREATING, S.LOOKING_AFTER, S.INSPECTING]
SHAPE = PredictedShape(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros((3, 2)))
NOTHING: Any = None
PLANNED = context_with(predicted=SHAPE, trajectory=NOTHING, step=NOTHING, motion=NOTHING)
CARRIED = context_with(PLANNED, carried=True)


@pytest.mark.parametrize(
    ("way", "context", "event"),
    [
        ([], RunContext(), E.START_OVER),
        (SEEN[:2], RunContext(), E.START_OVER),
        (SEEN[:3], RunContext(), E.LAY),
        (SEEN[:4], RunContext(), E.LOOK_AGAIN),
        (SEEN, RunContext(), E.LOOK_AGAIN),
        ([*SEEN, S.AWAITING_APPROVAL], PLANNED, E.LOOK_AGAIN),
        (SEEN + FOLD[:1], PLANNED, E.LOOK_AGAIN),
        (SEEN + FOLD[:4], PLANNED, E.LOOK_AGAIN),  # the garment was in the hands: it is released and located
        (SEEN + FOLD[:5], PLANNED, E.LOOK_AFTER),  # the garment was carried to its target
        (SEEN + FOLD[:4], CARRIED, E.LOOK_AFTER),  # so it was, but the release had not begun
        ([*SEEN, *FOLD[:4], S.LAYING_BACK, S.CLEARING], CARRIED, E.LOOK_AFTER),  # it was laid down at its target
        ([*SEEN, *FOLD[:4], S.LAYING_BACK, S.CLEARING], PLANNED, E.LOOK_AGAIN),  # it was laid back
        (SEEN + FOLD, PLANNED, E.LOOK_AFTER),
        # the fold was inspected, and the plan is at the next fold
        (SEEN + FOLD, context_with(index=1), E.LOOK_AGAIN),
        ([*SEEN, *FOLD[:4], S.CLEARING, S.RECOVERING, S.GIVING_UP, S.NOT_FOLDED], PLANNED, E.LOOK_AGAIN),
        ([*SEEN, *FOLD[:6], S.CLEARING, S.MAKING_SAFE, S.FAULT], PLANNED, E.LOOK_AFTER),
        ([*SEEN, *FOLD, S.RECOVERING, S.PLANNING_REPAIR], CARRIED, E.LOOK_AGAIN),  # the repair was not begun
        ([*SEEN, *FOLD[:4], S.RECOVERING, S.PLANNING_SPREAD], PLANNED, E.LOOK_AGAIN),
        ([*SEEN, *FOLD[:4], S.PAUSED], PLANNED, E.LOOK_AGAIN),
        ([*SEEN, *FOLD[:4], S.STOPPED], PLANNED, E.LOOK_AGAIN),
        ([S.IDLE, S.RESUMING], replace(PLANNED, reentry=E.LOOK_AFTER), E.LOOK_AFTER),  # interrupted again
        ([S.IDLE, S.RESUMING], RunContext(reentry=E.LAY), E.LAY),
        # the states are newer than the saved reentry
        ([S.RESUMING, S.LOOKING], replace(PLANNED, reentry=E.LOOK_AFTER), E.LOOK_AGAIN),
    ],
)
def test_a_resumed_run_begins_with_the_picture_that_its_last_state_needs(
    way: list[State], context: RunContext, event: Event
) -> None:
    assert reentry_event(way, context) is event


class Logs:
    """A logs folder with interrupted runs."""

    def __init__(self, folder: Path) -> None:
        self.request = fold_request(folder, seed=4)
        self.journal = Journal.open(self.request.logs / "journal.db")
        self.clock = 1000.0

    def begin(self, driver: str = "sim") -> RunJournal:
        self.clock += 10.0
        request = replace(self.request, driver=driver)
        run = self.journal.begin_run(
            garment="small_towel", seed=4, driver=driver, settings_hash=request.settings.fingerprint(),
            wall_clock=lambda: self.clock,
        )  # fmt: skip
        keep_request(run.directory, request)
        return run

    def cut_off(self, context: RunContext = PLANNED, driver: str = "sim", through: int = 4) -> str:
        run = self.begin(driver)
        run.result(run.intent(0.0, S.PREPARING, "prepare"), 1.0)
        for state in SEEN + FOLD[:through]:
            run.event(1.0, state, "done")
        CheckpointWriter(run.directory, (lambda: b"the world") if driver != "ros" else None).keep(context)
        run.abandon()
        return run.id

    def resume(self, name: str, **changes: Any) -> Any:
        return interrupted_run(self.journal, name, self.request.logs, **changes)


@pytest.fixture
def logs(tmp_path: Path) -> Iterator[Logs]:
    made = Logs(tmp_path)
    yield made
    made.journal.close()


def test_a_resumed_run_has_the_saved_context(logs: Logs) -> None:
    failed = PLANNED.with_failure(Failure(FailureKind.SLIPPED, "lost")).with_failure(
        Failure(FailureKind.SLIPPED, "lost")
    )
    grip = Held(3.0, 12.0, 0.004, LayerCount((0.0, 1.0), 1.0, 0.1))
    unloaded = TactileBias(2.0, np.zeros((2, 4, 3)), np.zeros(2), 0.01)
    in_hand: Any = {"held": {Side.LEFT: grip}, "biases": {Side.LEFT: unloaded}}
    name = logs.cut_off(context_with(failed, index=1, waited_s=7.0, **in_hand))
    found = logs.resume("last", quiet=True)
    assert (found.run, found.world) == (name, b"the world")
    assert (found.request.seed, found.request.garment, found.request.quiet) == (4, "small_towel", True)
    assert found.context.fold.index == 1 and found.context.attempts == failed.attempts
    assert found.context.reentry is E.LOOK_AGAIN
    assert found.context.failure is None and found.context.waited_s == 0.0, "the waiting time starts anew"
    assert not found.context.fold.held and not found.context.fold.biases, (
        "the hands are empty, because a resumed run first opens them"
    )


@pytest.mark.parametrize(("through", "carried"), [(4, False), (5, True), (6, True)])
def test_a_fold_whose_release_had_begun_is_inspected_first(logs: Logs, through: int, carried: bool) -> None:
    """The checkpoint is from before the release, so the resumed run must know that the fold was carried."""
    logs.cut_off(through=through)
    assert logs.resume("last").context.fold.carried is carried


@pytest.mark.parametrize(("through", "uncertain"), [(1, False), (2, True)])
def test_a_garment_whose_grasp_was_interrupted_may_lie_anywhere(logs: Logs, through: int, uncertain: bool) -> None:
    """The checkpoint is from before the grasp. After the approach the hands have not touched the garment yet."""
    logs.cut_off(through=through)
    context = logs.resume("last").context
    assert (context.fold.touched, context.fold.uncertain) == (uncertain, uncertain)


def test_a_run_that_died_before_its_first_effect_starts_over(logs: Logs) -> None:
    run = logs.begin()
    CheckpointWriter(run.directory, lambda: b"the world").keep(RunContext())
    run.abandon()
    assert logs.resume(run.id).context.reentry is E.START_OVER, "the table is still empty"


def test_a_run_on_hardware_has_no_world_checkpoint(logs: Logs) -> None:
    logs.cut_off(driver="ros")
    assert logs.resume("last").world is None


def test_a_folded_run_cannot_be_resumed(logs: Logs) -> None:
    run = logs.begin()
    run.end("folded")
    with pytest.raises(ConfigurationError, match="has folded"):
        logs.resume(run.id)


def test_a_run_with_skipped_folds_cannot_be_resumed(logs: Logs) -> None:
    """The last fold was made, so a resumed run would make it twice."""
    logs.cut_off(replace(PLANNED, through=True))
    with pytest.raises(ConfigurationError, match="finished its plan"):
        logs.resume("last")


def test_a_running_run_cannot_be_resumed(logs: Logs) -> None:
    run = logs.begin()
    with pytest.raises(ConfigurationError, match="still running"):
        logs.resume(run.id)
    run.abandon()


def test_a_run_without_a_checkpoint_cannot_be_resumed(logs: Logs) -> None:
    run = logs.begin()
    run.abandon()
    with pytest.raises(ConfigurationError, match="has no checkpoint") as e:
        logs.resume(run.id)
    assert "foldcell fold" in e.value.hint


def test_a_checkpoint_is_valid_once_its_last_file_exists(logs: Logs) -> None:
    run = logs.begin()
    (run.directory / "checkpoint").mkdir()
    run.abandon()
    with pytest.raises(ConfigurationError, match="has no checkpoint"):
        logs.resume(run.id)


def test_a_calibration_cannot_be_resumed(logs: Logs) -> None:
    run = logs.journal.begin_run(garment="calibrate-table", seed=1, driver="sim")
    run.abandon()
    with pytest.raises(ConfigurationError, match="is a calibration"):
        logs.resume(run.id)


def test_a_missing_run_folder_is_reported(logs: Logs) -> None:
    name = logs.cut_off()
    shutil.rmtree(logs.request.logs / name)
    with pytest.raises(ConfigurationError, match="is gone"):
        logs.resume(name)


@pytest.mark.parametrize("file", ["cell.yaml", "request.json"])
def test_changed_settings_are_refused(logs: Logs, file: str) -> None:
    name = logs.cut_off()
    path = logs.request.logs / name / file
    text = path.read_text(encoding="utf-8")
    changed = text.replace('"seed": 4', '"seed": 5') if file == "request.json" else text.replace("15.0", "55.0")
    assert changed != text
    path.write_text(changed, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="do not match the journal"):
        logs.resume(name)


def test_a_run_can_be_resumed_once(logs: Logs) -> None:
    """The garment lies where the later run left it. The order of the runs does not depend on the wall clock."""
    first = logs.cut_off()
    logs.clock -= 3600.0
    later = logs.begin()
    later.event(0.0, S.IDLE, RESUMED_FROM, {"run": first})
    CheckpointWriter(later.directory, lambda: b"the world").keep(replace(PLANNED, reentry=E.LOOK_AFTER))
    later.abandon()
    with pytest.raises(ConfigurationError, match=f"already resumed as {later.id}") as e:
        logs.resume(first)
    assert e.value.hint == f"foldcell resume {later.id}"
    assert logs.resume(later.id).context.reentry is E.LOOK_AFTER, "the later run can also be resumed"


@pytest.mark.parametrize(("driver", "refused"), [("sim", False), ("emulator", False), ("ros", True)])
def test_a_real_run_cannot_be_resumed_after_a_later_run(logs: Logs, driver: str, refused: bool) -> None:
    """Each simulated run has its own world, but there is only one real table."""
    first = logs.cut_off(driver=driver)
    logs.clock -= 3600.0  # the order does not depend on the clock
    elsewhere = logs.begin("sim" if driver == "ros" else "ros")
    elsewhere.abandon()
    check_resumable(logs.journal, first)
    failed = logs.begin(driver)  # the robot was off, so this run did nothing
    failed.abandon()
    assert logs.resume(first).run == logs.resume("last").run == first
    rehearsed = logs.begin("sim" if driver == "ros" else "ros")  # a run at another table
    rehearsed.intent(0.0, S.PREPARING, "prepare")
    rehearsed.abandon()
    assert logs.resume(first).run == first
    other = logs.begin(driver)
    other.intent(0.0, S.PREPARING, "prepare")
    other.abandon()
    logs.begin(driver).abandon()  # the robot was off again
    if refused:
        with pytest.raises(ConfigurationError, match=f"the last is {other.id}"):
            logs.resume(first)
    else:
        assert logs.resume(first).run == first


def test_a_missing_world_checkpoint_is_a_storage_error(logs: Logs) -> None:
    name = logs.cut_off()
    (logs.request.logs / name / "world.npz").unlink()
    with pytest.raises(StorageError, match="the simulated world"):
        logs.resume(name)


def test_a_folded_run_leaves_no_checkpoint(tmp_path: Path) -> None:
    checkpoint_writer = CheckpointWriter(tmp_path, lambda: b"the world")
    checkpoint_writer.keep(PLANNED)
    checkpoint_writer.forget()
    checkpoint_writer.forget()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "world.npz").mkdir()  # a file that cannot be removed stays, without an error
    checkpoint_writer.forget()
