"""Any text or bytes that a page may send: it is answered, and nothing but a stop stops the robot."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.operator.console.live_view import LiveView
from foldcell.cell.operator.console.messages import StopMessage, read_message
from foldcell.cell.operator.console.server import _Page
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.skills.fold_plan.plan import plan_folds
from tests.builders.contexts import context_with
from tests.builders.records import run_record, run_status
from tests.fakes import FakeCell
from tests.scenes import camera

TOWEL = load_garment("medium_towel")
FLAT = TOWEL.flat_state(*TOWEL.poses.middle)
STEPS = plan_folds(FLAT, TOWEL).unwrap()
QUESTION = Step(State.PLANNING_MOTION, Event.APPROVAL_NEEDED, State.AWAITING_APPROVAL, Effect.ASK_APPROVAL)
ASKED = Result(Event.DONE, context_with(garment=TOWEL, flat=FLAT, steps=STEPS, step=STEPS[0]))

WORDS = [
    "stop", "say", "question", "edit", "judge", "control", "grasp", "keypoint", "to", "variant", "arc", "other",
    "passed", "why", "left", *(event.value for event in sorted(Event)), *TOWEL.keypoints,
]  # fmt: skip
LEAVES = (
    st.none() | st.booleans() | st.integers(-2, 3) | st.floats() | st.text(max_size=8) | st.sampled_from(WORDS)
)
KEYS = st.sampled_from(WORDS) | st.text(max_size=3)
ANYTHING = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3), max_leaves=8
)
NUMBER, SHARE = st.integers(0, 2), st.floats(0.0, 1.0)
PLACE = st.tuples(SHARE, SHARE)
CHANGE = st.one_of(
    st.fixed_dictionaries({"grasp": st.sampled_from(["left", "right"]), "to": PLACE}),
    st.fixed_dictionaries({"keypoint": st.sampled_from([*TOWEL.keypoints]), "to": PLACE}),
    st.fixed_dictionaries({"variant": st.text(max_size=5)}),
    st.just({"arc": "other"}),
)
VERDICT = st.fixed_dictionaries({"passed": st.booleans()}, optional={"why": st.text(max_size=9)})
VALID = st.one_of(
    st.fixed_dictionaries({"say": st.sampled_from(WORDS)}, optional={"question": NUMBER}),
    st.fixed_dictionaries({"edit": CHANGE, "question": NUMBER}),
    st.fixed_dictionaries({"judge": VERDICT, "question": NUMBER}),
    st.just({"control": True}),
    st.just({"stop": True}),
)
"""Messages of the right form: most of them are not possible now."""


@st.composite
def spoilt(draw: st.DrawFn) -> str:
    """A message of the right form, in which a value, a key or a part of the text is another one."""
    message = draw(VALID)
    if draw(st.booleans()):
        message = {**message, draw(KEYS): draw(ANYTHING)}
    text = json.dumps(message)
    if draw(st.booleans()):
        begin = draw(st.integers(0, len(text)))
        text = text[:begin] + draw(st.text(max_size=4)) + text[draw(st.integers(begin, len(text))) :]
    return text


DEEP = st.integers(1, 4000).map(lambda depth: '{"edit":' + "[" * depth)
TEXTS = st.one_of(
    VALID.map(json.dumps), spoilt(), ANYTHING.map(json.dumps), DEEP, st.text(max_size=40), st.binary(max_size=40)
)
ANSWERS = {"noted", "refused", "control"}


class Cell:
    """A served page in the middle of a question, and what its messages can reach."""

    def __init__(self, state: State) -> None:
        self.status, self.stopped = run_status(simulated=False), FakeCell()
        self.commands = CommandQueue(self.status.note_command)
        view = LiveView(camera(), offer=lambda work: True)
        view.performed(1.0, QUESTION, ASKED)
        self.status.performed(1.0, QUESTION, ASKED)
        for entering in (self.status, view):
            entering.entered(1.0, Step(State.PLANNING_MOTION, Event.APPROVAL_NEEDED, state, Effect.ASK_APPROVAL))
        if state is State.FOLDED:
            self.status.finish(run_record(driver="ros", simulated=False))
            self.status.judge(lambda judgement: None)
        self.page = _Page(self.status, view, self.commands, self.stopped.ports().stop, [], [])
        self.page._in_control = "one"

    def answer(self, text: str | bytes) -> dict[str, Any]:
        return self.page._answer(text, "one")


@settings(max_examples=250)
@given(
    st.sampled_from([State.AWAITING_APPROVAL, State.ASKING, State.FOLDING, State.PAUSED, State.FOLDED]),
    st.lists(TEXTS, min_size=1, max_size=12),
)
def test_every_message_is_answered_and_only_a_stop_stops(state: State, texts: list[str | bytes]) -> None:
    cell, put = Cell(state), []
    for text in texts:
        stopped, allowed = bool(cell.stopped.stop_reason), cell.status.allowed() | {Event.EDIT}
        answer = cell.answer(text)
        assert answer.keys() & ANSWERS, text
        json.loads(json.dumps(answer, allow_nan=False))
        asks_to_stop = isinstance(read_message(text), StopMessage)
        assert bool(cell.stopped.stop_reason) == (stopped or asks_to_stop), text
        if answer.get("noted", "stop") not in {"stop", "verdict"}:
            put.append(Event(answer["noted"]))
            assert put[-1] in allowed
    assert [cell.commands.take(frozenset(Event)) for _ in put] == put
    assert cell.commands.take(frozenset(Event)) is None
    assert cell.answer('{"stop": true}') == {"noted": "stop"} and cell.stopped.stop_reason
