"""The messages that the operator's page may send, as JSON objects.

{"stop": true}                        stop the robot
{"say": "pause"}                      a command that is possible now (cell/states/commands.py)
{"say": "approve", "question": 3}     an answer, with the number of the question that it belongs to
{"edit": {"grasp": "left", "to": [0.5, 0.4]}, "question": 3}      change the plan: move a grasp or a key point
{"edit": {"keypoint": "top_left", "to": [0.5, 0.4]}, "question": 3}   (shares of the picture's width and height),
{"edit": {"variant": "near_onto_far"}, "question": 3}             choose another fold variant,
{"edit": {"arc": "other"}, "question": 3}                         ask for another arc
{"judge": {"passed": false, "why": "a sleeve lies open"}, "question": 4}     the verdict on the folded garment
{"control": true}                     take control: commands of other pages are then refused

Commands are checked strictly: a command with an unknown key or a value of another type is refused, because it
could mean something else. A stop is never refused for its form. Every object with the key `stop`, whatever its
value and its other keys, and every object with `"say": "stop"` stops the robot. An unwanted stop costs a minute,
but a missed stop may cost a hand. A text, a list or a number is not a message: `"stop"` alone, `["stop"]` and
`"nonstop"` do nothing.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

STOP = "stop"
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class StopMessage:
    """A message that stops the robot."""


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class CommandMessage(_Message):
    """A command of the operator. question: number of the question that it answers."""

    say: str
    question: int | None = None


class PlanChange(_Message):
    """A change of the plan. to: where a key point or a grasp shall lie, as shares (0..1) of the picture's width
    and height."""

    keypoint: str | None = None
    grasp: Literal["left", "right"] | None = None
    to: tuple[Share, Share] | None = None
    variant: str | None = None
    arc: Literal["other"] | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        kinds = [self.keypoint, self.grasp, self.variant, self.arc]
        moved = self.keypoint is not None or self.grasp is not None
        if sum(kind is not None for kind in kinds) != 1 or moved != (self.to is not None):
            raise ValueError("exactly one change, with a place if a point is moved")
        return self


class EditMessage(_Message):
    """A change of the plan that the cell asks about. question: number of that question."""

    edit: PlanChange
    question: int


class Verdict(_Message):
    """A person's verdict on the folded garment. A garment that is not folded well needs a reason."""

    passed: bool
    why: str = Field("", max_length=500)

    @model_validator(mode="after")
    def _reasoned(self) -> Self:
        if not self.passed and not self.why.strip():
            raise ValueError("a reason is needed")
        return self


class JudgeMessage(_Message):
    """The verdict, with the number of the question that asks for it."""

    judge: Verdict
    question: int


class ControlMessage(_Message):
    """The request of a page to take control of the run."""

    control: Literal[True]


Message = ControlMessage | EditMessage | JudgeMessage | CommandMessage
KINDS: dict[str, type[Message]] = {"control": ControlMessage, "edit": EditMessage, "judge": JudgeMessage}


def read_message(text: str | bytes) -> StopMessage | Message | None:
    """Parse the text of a WebSocket frame from the page. Returns None if it is not a message."""
    try:
        message: Any = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, dict):
        return None
    if STOP in message or message.get("say") == STOP:
        return StopMessage()
    kind = next((kind for key, kind in KINDS.items() if key in message), CommandMessage)
    try:  # from JSON, in which a tuple is a list
        return kind.model_validate_json(json.dumps(message))
    except ValidationError:
        return None
