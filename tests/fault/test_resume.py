"""Resuming runs: one was stopped with cloth in the hands, one died between two effects."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.runs.checkpoint_writer import CheckpointWriter, Interrupted, interrupted_run
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.cell.support.files.packing import packed
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import Ports
from tests.runs import Onlooker, decided_again, fold_request, once_folded_towel

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


class Died(BaseException):
    """Stands for a kill. The run must not catch it."""


def last_run(request: FoldRequest) -> Interrupted:
    with Journal.open(request.logs / "journal.db", readonly=True) as journal:
        return interrupted_run(journal, "last", request.logs)


def after_the_restart(request: FoldRequest) -> tuple[RunRecord, Onlooker]:
    """Resume the journal's last run. Returns the result and the onlooker."""
    onlooker, interrupted = Onlooker(), last_run(request)
    return onlooker.fold(interrupted.request, interrupted=interrupted), onlooker


def die(ports: Ports, commands: CommandQueue, n: int) -> None:
    raise Died


def test_a_run_stopped_with_lifted_cloth_is_resumed_and_folds_it(tmp_path: Path) -> None:
    """Nothing re-arms by itself. On resume the hands open, the arms park, and the towel is found and folded."""
    # the library's arcs, because released cloth lies less neatly
    request = fold_request(tmp_path, {}, garment=once_folded_towel(tmp_path), record_truth=True)
    stopping = Onlooker()

    def stop(ports: Ports, effect: Effect, t: float) -> None:
        if effect is Effect.FOLD:
            ports.stop.trigger("a test")

    stopping.at_set_point = stop
    first = stopping.fold(request)
    assert (first.state, [s.done for s in first.steps]) == ("stopped", [False])
    last = stopping.set_points[-1]
    result, resumed = after_the_restart(request)
    begun = resumed.set_points[0]
    assert begun.effect is Effect.REENTER, "the first motion is that of the effect that opens the hands and parks"
    assert np.abs(begun.q - last.q).max() < 0.05, "the first set-point is near the arms' present position"
    assert resumed.performed[0][0] is Effect.REENTER and resumed.count(Effect.PHOTOGRAPH_TABLE) == 0
    assert [e for e, _ in resumed.performed][1:4] == [Effect.LOOK, Effect.ESTIMATE, Effect.RECOGNISE]
    assert (result.result, [s.done for s in result.steps]) == ("folded", [True])
    assert result.score is not None and result.score.passed, result.score
    assert np.abs(resumed.last_q - load_model().q_park).max() < 0.02


def test_a_run_that_died_before_its_first_effect_ended_starts_over(tmp_path: Path) -> None:
    """The journal has the intent of the first effect, and nothing lies on the table yet."""
    request = fold_request(tmp_path)
    with pytest.raises(Died):
        Onlooker(before={Effect.PREPARE: die}).fold(request)
    interrupted = last_run(request)
    resumed = Onlooker(before={Effect.AWAIT_GARMENT: die})
    with pytest.raises(Died):
        resumed.fold(interrupted.request, interrupted=interrupted)
    assert resumed.performed == [(Effect.REENTER, Event.START_OVER), (Effect.PHOTOGRAPH_TABLE, Event.DONE)]
    assert last_run(request).context.reentry is Event.LAY, "the resumed run has photographed the table"


def test_a_run_that_died_between_the_arc_and_the_release_inspects_the_fold_and_does_not_repeat_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checkpoint says that the hands have carried the cloth to its target, where the resumed run lets go. It
    inspects the fold first."""
    request, keep = fold_request(tmp_path, record=True), CheckpointWriter.keep

    def keep_and_die(writer: CheckpointWriter, context: RunContext) -> None:
        keep(writer, context)
        if context.fold.carried:
            raise Died

    with monkeypatch.context() as patch:
        patch.setattr(CheckpointWriter, "keep", keep_and_die)
        first = Onlooker()
        with pytest.raises(Died):
            first.fold(request)
    assert first.performed[-1] == (Effect.FOLD, Event.DONE)
    before = decided_again(request.logs)
    assert before.same and before.broken_off == "the transcript breaks off here"
    interrupted = last_run(request)
    resumed = Onlooker(before={Effect.APPROACH: lambda ports, commands, n: commands.put(Event.ABORT)})
    result = resumed.fold(interrupted.request, interrupted=interrupted)
    assert resumed.performed[:3] == [
        (Effect.REENTER, Event.LOOK_AFTER), (Effect.LOOK, Event.DONE), (Effect.INSPECT, Event.NEXT_FOLD),
    ]  # fmt: skip
    assert [step.done for step in result.steps] == [True, False], "the second fold was next"
    after = decided_again(request.logs)
    assert after.same and after.broken_off is None, "the replay starts from the context at the resume"
    assert after.set_points == len(resumed.set_points)
    shutil.rmtree(Path(result.run_dir) / "began_with")
    with pytest.raises(StorageError, match="its initial checkpoint is missing"):
        decided_again(request.logs)


SHIFT = 0.03  # [m]


def moved(world: bytes, shift: float) -> bytes:
    """The world checkpoint with the garment shifted to the left by `shift` [m]."""
    with np.load(io.BytesIO(world)) as data:
        arrays = dict(data)
    for name in ("x", "xp", "ref", "last"):
        arrays[f"cloth.state.{name}"][:, 1] += shift
    return packed(**arrays)


def test_a_resumed_run_finds_a_garment_that_was_moved(tmp_path: Path) -> None:
    """The garment is moved between the two runs. The second run finds it at its new place."""
    request = fold_request(tmp_path)

    with pytest.raises(Died):
        Onlooker(before={Effect.APPROACH: die}).fold(request)
    stopped = Onlooker()
    result = stopped.fold(request, lambda ports: ports.stop.trigger("at once"), last_run(request))
    assert (result.state, stopped.set_points) == ("stopped", []), "a resume does not reset the stop"
    interrupted = last_run(request)  # the stopped run, which can also be resumed
    believed = interrupted.context.recognition.perception
    elsewhere = replace(interrupted, world=moved(interrupted.world, SHIFT))
    onlooker = Onlooker(before={Effect.APPROACH: lambda ports, commands, n: commands.put(Event.ABORT)})
    onlooker.fold(interrupted.request, interrupted=elsewhere)
    seen = next(r.context.recognition.perception for r in reversed(onlooker.results) if r.context.recognition)
    way = seen.state.contour.mean(axis=0) - believed.state.contour.mean(axis=0)
    assert np.allclose(way, (0.0, SHIFT), atol=0.004)
