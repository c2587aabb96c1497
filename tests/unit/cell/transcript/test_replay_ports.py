"""Recording of the ports' exchanges, and their replay in the same order. A different question is reported."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import foldcell.robots.ports
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.frame_store import FRAMES
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.transition_table import Event
from foldcell.cell.transcript.channels import CellConstants, Channel
from foldcell.cell.transcript.port_recorder import PortRecorder
from foldcell.cell.transcript.replay_ports import NoRecordedAnswer, RecordedAnswers
from foldcell.cell.transcript.transcript import TRANSCRIPT, Transcript
from foldcell.robots.errors import DriverError, FailureKind, StorageError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory, Ports, Side
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import LIMITS as EXECUTION_LIMITS
from tests.builders.transcripts import write_transcript
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

LIMITS = JointLimits(
    lower=np.full(14, -3.0), upper=np.full(14, 3.0), velocity=np.full(14, 1.5),
    acceleration=np.full(14, 2.0), jerk=np.full(14, 30.0),
)  # fmt: skip


def sweep(seconds: float = 1.0) -> ArmTrajectory:
    t = np.linspace(0.0, seconds, 40)
    s = t / seconds
    q = 0.2 * (3 * s**2 - 2 * s**3)[:, None] * np.ones(14)
    qd = 0.2 * (6 * s - 6 * s**2)[:, None] / seconds * np.ones(14)
    return ArmTrajectory(t, q, qd, np.zeros_like(q))


def work(ports: Ports, commands: CommandQueue) -> list[Any]:
    """Calls of every kind that an executive makes. Returns all answers."""
    told: list[Any] = []
    ports.arms.enable()
    ports.head.command_pan(0.1)
    for gripper in ports.grippers.values():
        gripper.calibrate()
        gripper.command(gripper.max_opening, 5.0)
    ports.attendant.lay_garment()
    frame = ports.camera.capture()
    told.append((frame.stamp, frame.rgb.tobytes()))
    control = PathControl(commands, LIMITS, LIMITS, note=lambda name, values: told.append((name, values)))
    loop = ControlLoop(ports, EXECUTION_LIMITS, LastCommand())
    moved = stream(loop, sweep(), None, control)
    told.append(moved.failure or moved.unwrap().q.tobytes())
    told.append(wait(loop, 0.1))
    for side in Side:
        told += [ports.tactile[side].reading().grip, ports.grippers[side].state()]
    told.append(commands.wait(frozenset({Event.RETRY}), 0.0))
    return told


class Recorded(NamedTuple):
    ports: Ports
    commands: CommandQueue


def taken_down(
    folder: Path, cell: FakeCell, act: Callable[[Ports, CommandQueue], Any], commands: CommandQueue | None = None
) -> Any:
    """The result of `act`, whose transcript is written into the folder."""
    port_recorder = PortRecorder(folder)
    heard = Recorded(*port_recorder.between(cell.ports(), commands or CommandQueue()))
    try:
        return act(heard.ports, heard.commands)
    finally:
        port_recorder.end()
        assert port_recorder.close() is None


def answers(folder: Path) -> RecordedAnswers:
    return RecordedAnswers(Transcript(folder / TRANSCRIPT))


def again(folder: Path, act: Callable[[Ports, CommandQueue], Any]) -> Any:
    """The result of `act` from the recorded answers alone. Asserts that it uses all of them."""
    there = answers(folder)
    told = act(there.ports(), there.commands())
    assert there.next is not None and there.next.channel is Channel.END
    return told


def test_the_same_questions_get_the_same_answers(tmp_path: Path) -> None:
    cell = FakeCell()
    then = taken_down(tmp_path, cell, work)
    assert cell.commands, "the arms were commanded"
    assert again(tmp_path, work) == then


def test_a_recorded_queue_says_that_the_operator_has_left(tmp_path: Path) -> None:
    commands = CommandQueue()

    def leave(_: Ports, heard: CommandQueue) -> tuple[bool, bool]:
        before = heard.deserted
        commands.close()
        return before, heard.deserted

    assert taken_down(tmp_path, FakeCell(), leave, commands) == (False, True)


def test_a_change_of_the_plan_is_replayed(tmp_path: Path) -> None:
    commands, edit = CommandQueue(), PlanEdit("page 1", keypoints={"corner": (0.1 + 0.2, -1.0 / 3.0)})
    commands.put(Event.EDIT, edit)

    def act(ports: Ports, commands: CommandQueue) -> tuple[Any, ...]:
        taken = commands.wait(frozenset({Event.EDIT, Event.APPROVE}), 0.0)
        return taken, PlanEdit.read(commands.edit())

    assert taken_down(tmp_path, FakeCell(), act, commands) == (Event.EDIT, edit)
    assert again(tmp_path, act) == (Event.EDIT, edit)


def test_pauses_and_operator_commands_are_replayed(tmp_path: Path) -> None:
    commands, cell = CommandQueue(), FakeCell()
    for t, said in ((0.2, Event.PAUSE), (2.0, Event.RESUME), (2.0, Event.RETRY)):
        cell.at(t, lambda said=said: commands.put(said))
    then = taken_down(tmp_path, cell, work, commands)
    assert [x[0] for x in then if isinstance(x, tuple)][1:] == ["paused", "resumed"]
    assert Event.RETRY in then
    assert again(tmp_path, work) == then


def test_a_stop_is_replayed_at_the_same_tick(tmp_path: Path) -> None:
    cell = FakeCell()
    ports = cell.ports()
    cell.at(0.5, lambda: ports.stop.trigger("the button"))

    def act(ports: Ports, commands: CommandQueue) -> tuple[Any, float]:
        loop = ControlLoop(ports, EXECUTION_LIMITS, LastCommand())
        return stream(loop, sweep(), None, PathControl(None, LIMITS, LIMITS)).failure, ports.clock.now()

    failure, t = taken_down(tmp_path, cell, act)
    assert failure.kind is FailureKind.STOPPED and "the button" in failure.what
    assert again(tmp_path, act) == (failure, t)


def test_a_driver_error_is_replayed(tmp_path: Path) -> None:
    cell = FakeCell()
    cell.stop_reason = "the button"

    def act(ports: Ports, commands: CommandQueue) -> Any:
        with pytest.raises(DriverError) as caught:
            ports.arms.enable()
        return caught.value.failure()

    then = taken_down(tmp_path, cell, act)
    assert again(tmp_path, act) == then


def test_a_different_question_is_reported(tmp_path: Path) -> None:
    taken_down(
        tmp_path, FakeCell(), lambda ports, _: [ports.arms.command(np.zeros(14), np.zeros(14)) for _ in "ab"]
    )
    ports = answers(tmp_path).ports()
    ports.arms.command(np.zeros(14), np.zeros(14))
    q = np.zeros(14)
    q[3] = 1e-17
    with pytest.raises(NoRecordedAnswer) as caught:
        ports.arms.command(q, np.zeros(14))
    assert caught.value.then.startswith("a set-point for the arms")
    assert "joint 3's position differs most, by 1e-17 rad" in caught.value.now
    with pytest.raises(NoRecordedAnswer) as caught:
        answers(tmp_path).ports().camera.capture()
    assert (caught.value.then.split(":")[0], caught.value.now) == ("a set-point for the arms", "a picture")


def test_additional_questions_are_reported(tmp_path: Path) -> None:
    taken_down(tmp_path, FakeCell(), lambda ports, _: ports.clock.now())
    there = answers(tmp_path)
    assert there.ports().clock.now() == 0.0
    with pytest.raises(NoRecordedAnswer) as caught:
        there.ports().clock.now()
    assert (caught.value.then, caught.value.now) == ("the end of the run", "a reading of the clock")


def test_a_truncated_transcript_is_no_deviation(tmp_path: Path) -> None:
    taken_down(tmp_path, FakeCell(), work)
    whole = Transcript(tmp_path / TRANSCRIPT)
    write_transcript(tmp_path, whole.constants, list(whole)[:100])
    with pytest.raises(NoRecordedAnswer) as caught:
        again(tmp_path, work)
    assert caught.value.then == caught.value.now == "" and caught.value.trouble is None


def test_a_missing_picture_is_reported(tmp_path: Path) -> None:
    taken_down(tmp_path, FakeCell(), work)
    for path in (tmp_path / FRAMES).iterdir():
        path.unlink()
    with pytest.raises(NoRecordedAnswer) as caught:
        again(tmp_path, work)
    assert isinstance(caught.value.trouble, StorageError) and "missing" in caught.value.trouble.what


# stops


def test_the_stop_works_from_any_thread_and_is_not_recorded(tmp_path: Path) -> None:
    """Other threads may poll the stop at any rate. Only the executive's questions are recorded."""
    cell = FakeCell()

    def act(ports: Ports, commands: CommandQueue) -> bool:
        def other() -> None:
            for _ in range(50):
                assert not ports.stop.state().stopped
            ports.stop.trigger("from another thread")

        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        return ports.stop.state().stopped

    assert taken_down(tmp_path, cell, act)
    assert [e.channel for e in Transcript(tmp_path / TRANSCRIPT)] == [Channel.STOP, Channel.END]


def test_the_stop_works_when_recording_fails(tmp_path: Path) -> None:
    cell, port_recorder = FakeCell(), PortRecorder(tmp_path)
    heard = Recorded(*port_recorder.between(cell.ports(), CommandQueue()))
    assert port_recorder._writer is not None
    port_recorder._writer.fail("the disk is gone")
    heard.ports.stop.trigger("the button")
    assert heard.ports.stop.state().stopped and cell.stop_reason == "the button"
    assert "the disk is gone" in (port_recorder.close() or "")


def test_an_invalid_driver_answer_ends_the_transcript_and_not_the_run(tmp_path: Path) -> None:
    port_recorder = PortRecorder(tmp_path)
    ports = FakeCell().ports()
    no_time = object()
    ports.clock.now = lambda: no_time  # type: ignore[attr-defined, method-assign, assignment, return-value]
    heard = Recorded(*port_recorder.between(ports, CommandQueue()))
    assert heard.ports.clock.now() is no_time
    assert "clock.now" in (port_recorder.close() or "")


@pytest.fixture
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


def computed(cell: Workcell, skill: Callable[[], Any]) -> Outcome[Any]:
    try:
        return Outcome(cell.compute(1.0, skill))
    except DriverError as e:
        return Outcome(failure=e.failure())


@pytest.mark.parametrize("pressed", [False, True])
def test_a_stop_during_computing_is_replayed_at_any_computing_speed(
    tmp_path: Path, workers: ThreadPoolExecutor, pressed: bool
) -> None:
    """The number of polls of the stop depends on the wall clock. Only the result of the computation is
    replayed."""
    cell, port_recorder, free = FakeCell(), PortRecorder(tmp_path), threading.Event()
    ports = cell.ports()
    heard = Recorded(*port_recorder.between(ports, CommandQueue()))
    workcell = fake_workcell(cell, workers, ports=heard.ports, watched_stop=ports.stop)
    if pressed:
        threading.Timer(0.1, ports.stop.trigger, ["button"]).start()
    then = computed(workcell, lambda: free.wait(5.0 if pressed else 0.2))
    free.set()
    assert (then.failure is not None) is pressed
    port_recorder.end()
    assert port_recorder.close() is None

    there = answers(tmp_path)
    replayed = fake_workcell(cell, workers, ports=there.ports(), watched_stop=there.watched_stop())
    ages = threading.Event()
    # waiting for the discarded result would take forever
    now = computed(replayed, ages.wait if pressed else (lambda: False))
    ages.set()
    assert (now.failure and now.failure.what, now.value) == (then.failure and then.failure.what, then.value)
    assert there.next is not None and there.next.channel is Channel.END


def test_computing_ends_with_the_transcript(tmp_path: Path, workers: ThreadPoolExecutor) -> None:
    write_transcript(tmp_path, CellConstants.of(FakeCell().ports()), [])
    there, ages = answers(tmp_path), threading.Event()
    replayed = fake_workcell(FakeCell(), workers, ports=there.ports(), watched_stop=there.watched_stop())
    try:
        with pytest.raises(NoRecordedAnswer):
            replayed.compute(1.0, ages.wait)  # waiting for this result would take forever
    finally:
        ages.set()


# completeness


@pytest.mark.parametrize("name", ["Clock", "Arms", "Head", "Gripper", "Tactile", "Camera", "Stop", "Attendant"])
def test_every_method_of_every_port_is_recorded_and_replayed(name: str, tmp_path: Path) -> None:
    """A new method of a port must be recorded and replayed too."""
    protocol = getattr(foldcell.robots.ports, name)
    methods = {n for n, m in inspect.getmembers(protocol, inspect.isfunction) if not n.startswith("_")}
    attributes = set(protocol.__annotations__)
    assert methods
    taken_down(tmp_path, FakeCell(), lambda ports, _: None)
    heard = PortRecorder(tmp_path / "again")
    (tmp_path / "again").mkdir()
    for ports in (heard.between(FakeCell().ports(), CommandQueue())[0], answers(tmp_path).ports()):
        for port in of_kind(ports, name):
            for wanted in methods | attributes:
                assert hasattr(port, wanted), f"{type(port).__name__} has no {wanted}"
    heard.close()


def of_kind(ports: Ports, name: str) -> list[Any]:
    named = {"Gripper": list(ports.grippers.values()), "Tactile": list(ports.tactile.values())}
    return named.get(name) or [getattr(ports, name.lower())]


def test_every_port_is_wrapped_for_recording(tmp_path: Path) -> None:
    bare = FakeCell().ports()
    port_recorder = PortRecorder(tmp_path)
    heard, _ = port_recorder.between(bare, CommandQueue())
    for field in fields(Ports):
        if field.name not in {"driver", "simulated"}:
            assert getattr(heard, field.name) is not getattr(bare, field.name), field.name
    port_recorder.close()


def test_ports_are_not_wrapped_without_a_recording(tmp_path: Path) -> None:
    bare, queue, port_recorder = FakeCell().ports(), CommandQueue(), PortRecorder(None)
    heard = Recorded(*port_recorder.between(bare, queue))
    assert heard.ports is bare and heard.commands is queue
    port_recorder.end()
    assert port_recorder.close() is None and list(tmp_path.iterdir()) == []


def test_an_altered_answer_is_replayed_as_altered(tmp_path: Path) -> None:
    """All answers come from the transcript."""
    taken_down(tmp_path, FakeCell(), lambda ports, _: ports.arms.state())
    whole = Transcript(tmp_path / TRANSCRIPT)
    first, *rest = list(whole)
    state = replace(first.answer, head_pan=0.7)
    write_transcript(tmp_path, whole.constants, [replace(first, answer=state), *rest])
    assert answers(tmp_path).ports().arms.state().head_pan == 0.7
