"""The messages that the operator's page may send, as JSON objects.

{"stop": true}                        stop the robot
{"say": "pause"}                      a command that is possible now (cell/states/commands.py)
{"say": "approve", "question": 3}     an answer, with the number of the question that it belongs to
{"control": true}                     take control: commands of other pages are then refused

Commands are checked strictly: a command with an unknown key or a value of another type is refused, because it
could mean something else. A stop is never refused for its form. Every object with the key `stop`, whatever its
value and its other keys, and every object with `"say": "stop"` stops the robot. An unwanted stop costs a minute,
but a missed stop may cost a hand. A text, a list or a number is not a message: `"stop"` alone, `["stop"]` and
`"nonstop"` do nothing.
"""

from __future__ import annotations

import json
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

__all__ = ["CommandMessage", "ControlMessage", "StopMessage", "read_message"]

STOP = "stop"


class StopMessage:
    """A message that stops the robot."""


class CommandMessage(BaseModel):
    """A command of the operator. question: number of the question that it answers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    say: str
    question: int | None = None


class ControlMessage(BaseModel):
    """The request of a page to take control of the run."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    control: Literal[True]


def read_message(text: str | bytes) -> StopMessage | CommandMessage | ControlMessage | None:
    """Parse the text of a WebSocket frame from the page. Returns None if it is not a message."""
    try:
        message: Any = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, dict):
        return None
    if STOP in message or message.get("say") == STOP:
        return StopMessage()
    kind = ControlMessage if "control" in message else CommandMessage
    try:
        return kind.model_validate(message)
    except ValidationError:
        return None
