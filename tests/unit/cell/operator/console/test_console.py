"""The operator's page over a real socket: messages, commands and access."""

from __future__ import annotations

import argparse
import json
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from foldcell.cell.commands.shared import origin as page_origin
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.operator.console.live_view import LiveView
from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.console.server import operators_page
from foldcell.cell.operator.local_server import open_listener
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.observers import Step
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.stages import Repair
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.errors import DriverError, Failure, FailureKind, StorageError
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.fold_plan.repair import RepairGoal
from tests.builders.contexts import context_with
from tests.builders.records import run_record, run_status
from tests.fakes import FakeCell
from tests.inspections import a_claim
from tests.scenes import camera

ALL = frozenset(Event)


def enter(board: RunStatus, state: State, t: float = 1.0) -> None:
    board.entered(t, Step(State.IDLE, Event.DONE, state, Effect.NOTHING))


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell()


@pytest.fixture
def board() -> RunStatus:
    return run_status()


@pytest.fixture
def commands(board: RunStatus) -> CommandQueue:
    return CommandQueue(board.note_command)


@pytest.fixture
def view() -> LiveView:
    return LiveView(camera())


@pytest.fixture
def address(
    cell: FakeCell, board: RunStatus, view: LiveView, commands: CommandQueue, monkeypatch: pytest.MonkeyPatch
) -> Iterator[str]:
    """A served page that does not linger at its end: no test listens to it then."""
    monkeypatch.setattr("foldcell.cell.operator.console.server.LAST_WORD_S", 0.0)
    with operators_page(board, view, commands, cell.ports().stop, None, open_listener()) as address:
        yield address


def origin_of(address: str) -> str:
    return "/".join(address.split("/")[:3])


def linked(address: str, origin: str | None = None, page: str = "one") -> ClientConnection:
    link = address.replace("http", "ws") + f"link?page={page}"
    return connect(link, origin=origin or origin_of(address))  # type: ignore[arg-type]


def heard(link: ClientConnection, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The next message that fulfils `wanted`. Heartbeats do not extend the time limit."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        message = dict(json.loads(link.recv(timeout=5.0)))
        if wanted(message):
            return message
    raise AssertionError("nothing of the kind was told")


def told(link: ClientConnection, key: str) -> Any:
    """The value of `key` in the next message that has this key."""
    return heard(link, lambda message: key in message)[key]


def say(link: ClientConnection, **message: Any) -> dict[str, Any]:
    link.send(json.dumps(message))
    return heard(link, lambda answer: "noted" in answer or "refused" in answer)


def test_the_page_is_complete(address: str) -> None:
    with urllib.request.urlopen(address) as answer:
        text = answer.read().decode()
    assert "const VIEWER = null" in text and "{{" not in text
    assert text.count("</script>") == 1
    assert answer.headers["X-Frame-Options"] == "DENY" and answer.headers["Referrer-Policy"] == "no-referrer"


def test_one_page_has_control_until_another_one_takes_it(
    address: str, board: RunStatus, commands: CommandQueue, cell: FakeCell
) -> None:
    enter(board, State.FOLDING)
    with linked(address, page="one") as one:
        assert told(one, "control") == "yours"
        with linked(address, page="two") as two:
            assert told(two, "control") == "other"
            assert "refused" in say(two, say="pause")
            assert say(two, stop=True) == {"noted": "stop"} and cell.stop_reason, "STOP needs no control"
            two.send(json.dumps({"control": True}))
            assert heard(two, lambda m: m.get("control") == "yours")
            assert heard(one, lambda m: m.get("control") == "other")
            assert say(two, say="pause") == {"noted": "pause"}
            assert "refused" in say(one, say="abort")
        assert commands.take(frozenset(Event)) is Event.PAUSE and commands.take(frozenset(Event)) is None


def test_a_page_keeps_control_when_it_opens_its_link_anew(address: str, board: RunStatus) -> None:
    enter(board, State.FOLDING)
    with linked(address, page="one") as old, linked(address, page="one") as new:
        assert told(new, "control") == "yours"
        old.close()
        assert say(new, say="pause") == {"noted": "pause"}


def test_the_picture_is_served_with_its_number(address: str, view: LiveView) -> None:
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(f"{address}picture.jpg")
    assert error.value.code == 404, "nothing was seen yet"
    view.between(FakeCell().ports()).stop.state()
    with linked(address) as link:
        number = heard(link, lambda m: m.get("picture") is not None)["picture"]["number"]
    with urllib.request.urlopen(f"{address}picture.jpg?n={number}") as answer:
        content, headers = answer.read(), answer.headers
    assert int(headers["X-Picture"]) == number and headers["Cache-Control"] == "no-store"
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) is not None


def test_a_page_is_told_at_once_of_a_new_picture(
    address: str, view: LiveView, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only by the next heartbeat."""
    monkeypatch.setattr("foldcell.cell.operator.console.server.ALIVE_S", 1000.0)
    with linked(address) as link:
        told(link, "run_status")
        view.between(FakeCell().ports()).stop.state()
        assert heard(link, lambda m: m.get("picture") is not None)["picture"]["number"] >= 0


@pytest.mark.parametrize("path", ["", "0123456789abcdef/", "../"])
def test_the_page_needs_the_secret_address(address: str, path: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(f"{origin_of(address)}/{path}")
    assert error.value.code == 404
    with pytest.raises(InvalidStatus), linked(f"{origin_of(address)}/{path}", origin_of(address)):
        pass


def test_a_forwarded_page_is_linked_and_nothing_else(
    cell: FakeCell, board: RunStatus, view: LiveView, commands: CommandQueue, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("foldcell.cell.operator.console.server.LAST_WORD_S", 0.0)
    mine, stop = "http://localhost:9000", cell.ports().stop
    with operators_page(board, view, commands, stop, None, open_listener(), mine) as address:
        link = address.replace("http", "ws") + "link?page=one"
        for own in (mine, origin_of(address)):
            with connect(link, origin=own) as opened:  # type: ignore[arg-type]
                assert "run_status" in json.loads(opened.recv())
        for other in (
            "http://localhost:9001",
            "https://localhost:9000",
            "http://localhost:9000.evil.example",
            None,
        ):
            with pytest.raises(InvalidStatus), connect(link, origin=other):  # type: ignore[arg-type]
                pass
        with urllib.request.urlopen(address) as answer:
            assert "ws://localhost:9000" in answer.headers["Content-Security-Policy"]
            assert f'"{mine}"' in answer.read().decode()


@pytest.mark.parametrize("wrong", ["localhost:9000", "*", "http://*", "http://a b", "ftp://a", "http://a/b", ""])
def test_only_one_origin_can_be_named(wrong: str) -> None:
    assert page_origin("http://LocalHost:9000/") == "http://localhost:9000"
    with pytest.raises(argparse.ArgumentTypeError):
        page_origin(wrong)


def test_pages_of_other_sites_are_refused(address: str, commands: CommandQueue) -> None:
    link = address.replace("http", "ws") + "link"
    for origin in ("http://evil.example", origin_of(address).replace("http", "https"), None):
        with pytest.raises(InvalidStatus), connect(link, origin=origin):  # type: ignore[arg-type]
            pass
    with (
        pytest.raises(InvalidStatus),
        connect(link, origin=origin_of(address), additional_headers={"Host": "evil.example"}),  # type: ignore[arg-type]
    ):
        pass
    request = urllib.request.Request(address, headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(request)
    assert error.value.code == 400 and commands.take(ALL) is None


def test_the_page_receives_every_change_of_the_run_status(address: str, board: RunStatus) -> None:
    with linked(address) as link:
        assert told(link, "run_status")["state"] == "idle"
        enter(board, State.OPTIMISING)
        board.computing(3, 25, "simulations at most")
        shown = heard(link, lambda message: message.get("run_status", {}).get("progress") is not None)[
            "run_status"
        ]
        assert shown["progress"] == {"done": 3, "total": 25, "remark": "simulations at most"}
        assert shown["allowed"] == ["pause", "abort"] and shown["simulated"] and shown["seed"] == 3
        failure = Failure(FailureKind.OPTIMISER_FAILED, "nothing was found", "look again")
        step = Step(State.PLANNING, Event.DONE, State.OPTIMISING, Effect.CHOOSE_TRAJECTORY)
        result = Result(Event.FAILED, RunContext().with_failure(failure))
        board.record.performed(2.0, step, result)
        board.performed(2.0, step, result)
        (remark,) = told(link, "run_status")["remarks"]
        assert remark["kind"] == "failure" and "nothing was found" in remark["text"]


def test_a_garment_file_is_shown_by_its_name() -> None:
    """Underscores are shown as blanks, which would change a path."""
    shown = run_status("/data/our_lab/my_own_towel.yaml").snapshot()
    assert shown["garment"] == "my_own_towel"


def test_allowed_commands_enter_the_queue(address: str, board: RunStatus, commands: CommandQueue) -> None:
    enter(board, State.FOLDING)
    with linked(address) as link:
        assert "refused" in say(link, say="approve") and "refused" in say(link, say="resume")
        assert say(link, say="pause") == {"noted": "pause"}
        assert commands.take(ALL) is Event.PAUSE
        assert board.allowed() == {Event.RESUME, Event.ABORT}, "a pause that was requested can be resumed"
        assert say(link, say="resume") == {"noted": "resume"} and commands.take(ALL) is Event.RESUME
        assert Event.RESUME not in board.allowed()


def test_an_answer_belongs_to_its_question(address: str, board: RunStatus, commands: CommandQueue) -> None:
    """A late click that arrives when the next fold is shown approves nothing."""
    enter(board, State.AWAITING_APPROVAL)
    with linked(address) as link:
        first = told(link, "run_status")["question"]["number"]
        enter(board, State.APPROACHING)
        enter(board, State.AWAITING_APPROVAL)
        assert say(link, say="approve", question=first) == {"refused": "this question is no longer open"}
        assert "refused" in say(link, say="approve") and "refused" in say(link, say="pause")
        assert commands.take(ALL) is None
        assert say(link, say="approve", question=first + 1) == {"noted": "approve"}
        assert commands.take(ALL) is Event.APPROVE


def test_a_change_of_the_plan_enters_the_queue_with_its_author(
    address: str, board: RunStatus, view: LiveView, commands: CommandQueue
) -> None:
    towel = load_garment("medium_towel")
    flat = towel.flat_state(*towel.poses.middle)
    steps = plan_folds(flat, towel).unwrap()
    context = context_with(garment=towel, flat=flat, steps=steps, step=steps[0])
    step = Step(State.PLANNING_MOTION, Event.APPROVAL_NEEDED, State.AWAITING_APPROVAL, Effect.ASK_APPROVAL)
    change = {"edit": {"variant": "right_onto_left"}}
    with linked(address, page="one") as one, linked(address, page="two") as two:
        assert told(two, "control") == "other"
        assert "refused" in say(one, **change, question=0), "nothing is asked"
        for observer in (view, board):
            observer.performed(1.0, step, Result(Event.APPROVAL_NEEDED, context))
            observer.entered(1.0, step)
        shown = heard(one, lambda m: (m.get("run_status") or {}).get("changes") is not None)["run_status"]
        number = shown["question"]["number"]
        assert shown["changes"]["variants"] == ["left_onto_right", "right_onto_left"]
        assert "refused" in say(two, **change, question=number), "this page has no control"
        assert "refused" in say(one, **change, question=number - 1)
        assert say(one, **change, question=number) == {"noted": "edit"}
    assert commands.take(frozenset({Event.EDIT})) is Event.EDIT
    edit = PlanEdit.read(commands.edit())
    assert edit.variant == "right_onto_left" and edit.by == "page one"


def test_the_operator_can_skip_a_pressing(address: str, board: RunStatus, commands: CommandQueue) -> None:
    enter(board, State.AWAITING_PRESSING)
    with linked(address) as link:
        question = told(link, "run_status")["question"]
        assert "Press it flat" in question["text"]
        assert "refused" in say(link, say="pause"), "the cell is not moving, so it cannot be paused"
        assert say(link, say="skip", question=question["number"]) == {"noted": "skip"}
        assert commands.take(ALL) is Event.SKIP


def test_a_question_about_a_failure_says_what_retry_requires(board: RunStatus) -> None:
    """A retry makes the fold again, so the garment must first be laid as it was before the fold."""
    planned: Any = tuple(SimpleNamespace(name=name, variant="") for name in ("half", "quarter"))
    for steps, told in (
        ((), ""),
        (planned, " Before the cell looks again, lay the garment as it was before this fold."),
    ):
        context = context_with(steps=steps).with_failure(Failure(FailureKind.SLIPPED, "it slipped", "look"))
        step = Step(State.CLEARING, Event.DONE, State.RECOVERING, Effect.CHOOSE_RECOVERY)
        board.performed(2.0, step, Result(Event.ASK, context))
        enter(board, State.ASKING)
        shown = board.snapshot()
        assert shown["question"]["text"] == f"It slipped. Look.{told}"
        assert shown["labels"]["retry"] == "Look again"


@pytest.mark.parametrize("goal", list(RepairGoal))
def test_a_question_about_a_repair_says_what_the_hands_do_and_offers_no_skip(
    board: RunStatus, goal: RepairGoal
) -> None:
    nothing: Any = None
    plan: Any = SimpleNamespace(goal=goal)
    repair = Repair(plan, nothing, nothing, nothing, nothing, nothing)
    steps: Any = (SimpleNamespace(name="half", variant=""),)
    step = Step(State.PLANNING_REPAIR, Event.DONE, State.PLANNING_MOTION, Effect.PLAN_MOTION)
    board.performed(
        2.0, step, Result(Event.APPROVAL_NEEDED, context_with(steps=steps, repair=repair, carried=False))
    )
    enter(board, State.AWAITING_APPROVAL)
    shown, where = board.snapshot(), {"undo": "back where it lay before", "complete": "on to the target of"}[goal]
    text, answers = shown["question"]["text"], shown["question"]["answers"]
    assert f"the hands carry the moved cloth {where} the fold." in text and text.startswith("Fold 1 of 1: half.")
    assert where in answers["approve"] and list(answers) == ["approve", "retry", "abort"] == shown["allowed"]
    facts = dict(shown["facts"])
    assert where in facts["Repair"] and "Arc" not in facts and "ideal fold" not in facts["Predicted error"]


@pytest.mark.parametrize("state", [State.FOLDING, State.AWAITING_APPROVAL, State.PAUSED, State.MAKING_SAFE])
def test_stop_works_in_every_state_and_bypasses_the_queue(
    state: State, address: str, board: RunStatus, commands: CommandQueue, cell: FakeCell
) -> None:
    enter(board, state)
    with linked(address) as link:
        assert say(link, stop=True) == {"noted": "stop"}
        assert cell.stop_reason and commands.take(ALL) is None
        heard(link, lambda message: bool(message.get("stopped")))


NONSENSE = (
    b"\x00\xff", '{"say": "\\ud800"}', "[" * 4000, "", "{", "[]", "3", "null", '{"say": 7}', '{"say": ["pause"]}',
    '"stop"', '["stop"]', '"nonstop"', '"{\\"stop\\": true}"', '[{"stop": true}]', "stop", '{"say": "nonstop"}',
    '{"what": "stop"}', '{"say": "pause", "now": true}', '{"say": "pause", "question": "1"}', '{"question": 1}',
    '{"SAY": "pause"}', '{"say": "pause", "question": [1]}',
)  # fmt: skip


@pytest.mark.parametrize("message", NONSENSE)
def test_every_message_gets_an_answer(
    message: str | bytes, address: str, board: RunStatus, cell: FakeCell
) -> None:
    enter(board, State.FOLDING)
    with linked(address) as link:
        link.send(message)
        assert told(link, "refused")
        assert say(link, say="pause") == {"noted": "pause"}, "the link stays open"
    assert not cell.stop_reason


STOPS = (
    '{"stop": true}', '{"stop": false}', '{"stop": null}', '{"stop": {"now": [1, 2]}}', '{"stop": "please"}',
    '{"stop": true, "say": "pause", "question": "x", "extra": 1}', '{"say": "stop"}', '{"say": "stop", "now": 1}',
    '{"say": 7, "stop": true}', '{"stop": true, "stop": 3}', b'{"stop": true}', ' \n{"stop":\ttrue}\n',
)  # fmt: skip


@pytest.mark.parametrize("message", STOPS)
def test_a_stop_is_never_refused_for_its_form(
    message: str | bytes, address: str, board: RunStatus, commands: CommandQueue, cell: FakeCell
) -> None:
    enter(board, State.FOLDING)
    with linked(address) as link:
        link.send(message)
        assert heard(link, lambda answer: "noted" in answer or "refused" in answer) == {"noted": "stop"}
    assert cell.stop_reason and commands.take(ALL) is None


@pytest.mark.parametrize("question", [True, 1.0, "1"])
def test_the_number_of_a_question_is_a_whole_number(
    question: object, address: str, board: RunStatus, commands: CommandQueue
) -> None:
    """Of Python `true` would be the first question."""
    enter(board, State.AWAITING_APPROVAL)
    with linked(address) as link:
        assert told(link, "run_status")["question"]["number"] == 1
        assert "refused" in say(link, say="approve", question=question)
        assert commands.take(ALL) is None
        assert say(link, say="approve", question=1) == {"noted": "approve"}


def test_a_stop_that_fails_is_reported_as_such(
    address: str, cell: FakeCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The operator has to know that the other stop is needed."""

    def broken(self: object, reason: str) -> None:
        raise DriverError(FailureKind.HARDWARE_FAULT, "the robot does not answer")

    monkeypatch.setattr(type(cell.ports().stop), "trigger", broken)
    with linked(address) as link:
        assert "the robot does not answer" in say(link, stop=True)["refused"]


def test_the_page_receives_the_end_before_it_closes(
    cell: FakeCell, board: RunStatus, view: LiveView, commands: CommandQueue, tmp_path: Path
) -> None:
    page = operators_page(board, view, commands, cell.ports().stop, None, open_listener())
    address = page.__enter__()
    with linked(address) as link:
        told(link, "run_status")
        board.finish(run_record(state=State.NOT_FOLDED, run_dir=str(tmp_path)))
        page.__exit__(None, None, None)
        shown = told(link, "run_status")
    assert shown["end"]["result"] == "not_folded" and shown["end"]["report"] == str(tmp_path / "report.html")
    assert shown["end"]["go_on"] == "", "an aborted run has no command to resume"
    assert shown["allowed"] == []
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address, timeout=2.0)


def test_the_page_says_what_the_camera_saw_of_the_last_fold(board: RunStatus) -> None:
    board.finish(run_record(claim=a_claim(says="folded as planned")))
    assert board.snapshot()["end"]["claim"] == "folded as planned, reliability 98 %"


def test_the_page_explains_how_to_resume_after_a_stop(board: RunStatus, tmp_path: Path) -> None:
    board.finish(run_record(state=State.STOPPED, run_dir=str(tmp_path / "nothing-begun")))
    assert board.snapshot()["end"]["go_on"] == "", "a run without a checkpoint cannot be resumed"
    (tmp_path / "run-1" / "checkpoint").mkdir(parents=True)
    (tmp_path / "run-1" / "checkpoint" / "context").write_bytes(b"context_with")
    board.finish(run_record(state=State.STOPPED, run_dir=str(tmp_path / "run-1")))
    assert board.snapshot()["end"]["go_on"] == f"foldcell resume run-1 --logs {tmp_path}", (
        "the command names the run's folder"
    )
    step = Step(State.ASKING, Event.SKIP, State.INSPECTING, Effect.NEXT_STEP)
    board.performed(2.0, step, Result(Event.GIVE_UP, RunContext(through=True)))
    board.finish(run_record(state=State.FAULT, run_dir=str(tmp_path / "run-1")))
    assert board.snapshot()["end"]["go_on"] == "", "a run that is through its plan cannot be resumed"


def test_an_occupied_port_is_reported(address: str) -> None:
    port = int(origin_of(address).rpartition(":")[2])
    with pytest.raises(StorageError, match=str(port)):
        open_listener(port)


def test_a_link_that_cannot_send_the_status_is_closed(
    address: str, board: RunStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page that gets no status must notice, so that it opens another link."""
    with linked(address) as link:
        told(link, "run_status")
        monkeypatch.setattr(board, "snapshot", lambda: 1 / 0)
        enter(board, State.FOLDING)
        with pytest.raises(ConnectionClosed):
            heard(link, lambda message: False)


def test_the_pause_note_disappears_after_the_pause(board: RunStatus) -> None:
    enter(board, State.FOLDING)
    board.note_command(Event.PAUSE)
    board.note("paused on the way: resume or abort")
    board.note_command(Event.RESUME)
    board.note("going on")
    assert board.snapshot()["note"] == "going on" and board.snapshot()["allowed"] == ["pause", "abort"]


def test_the_page_in_control_gives_the_verdict(address: str, board: RunStatus) -> None:
    given: list[Judgement] = []
    board.judge(given.append)
    number = board.snapshot()["judging"]
    with linked(address, page="one") as one, linked(address, page="two") as two:
        assert told(one, "run_status")["judging"] == number
        assert "refused" in say(two, judge={"passed": True}, question=number)
        assert "refused" in say(one, judge={"passed": True}, question=number - 1)
        assert say(one, judge={"passed": False, "why": " open "}, question=number) == {"noted": "verdict"}
    assert given == [Judgement(False, "open")]
