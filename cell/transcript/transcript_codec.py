"""One exchange between the executive and its cell, as a value and as JSON.

An exchange is a question (port, method and arguments) and its answer. Equal texts mean equal values, bit for bit:
JSON writes each float with all its digits (NaN and Infinity are allowed). Values that JSON does not have are
objects with one of these keys:

    array     dtype, shape, and the items in C order as hexadecimal digits
    record    name of a type in RECORDS, beside its fields
    picture   name of a camera frame in the run's frame store
    refused   kind, what, hint and figures of a DriverError
    crashed   name and text of any other exception

Reading executes no code from the file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from foldcell.cell.support.json_values import to_json
from foldcell.cell.transcript.channels import Channel
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import GripperState, JointSetpoint, JointState, Side, StopState, TactileReading, frozen


@dataclass(frozen=True)
class Picture:
    """A camera frame, represented by its name in the frame store: 64 hexadecimal digits."""

    name: str


@dataclass(frozen=True)
class Exchange:
    """A question and its answer. question: the packed arguments; answer: the answer as `unpack` returns
    it, which is an exception if the cell raised it."""

    channel: Channel
    question: str
    answer: Any

    def in_words(self) -> str:
        """Return the question in words."""
        return self.channel.in_words(unpack(self.question))

    def time_after(self, now: float) -> float:
        """Return the latest known cell time after this exchange [s]. now: the one before it."""
        if self.channel is Channel.NOW and isinstance(self.answer, float):
            return self.answer
        return max(now, *unpack(self.question)) if self.channel is Channel.SLEEP else now


RECORDS: dict[str, type] = {
    kind.__name__: kind for kind in (JointState, JointSetpoint, GripperState, TactileReading, StopState)
}


def pack(value: object) -> str:
    """Convert a value to JSON, without line breaks and tabs. Raises TypeError for a type that no port uses."""
    return json.dumps(value, default=_to_object)


def unpack(text: str) -> Any:
    """Convert JSON to the packed value: a tuple gives a list, an enum its value, a camera frame a Picture. Raises
    ValueError for an invalid text."""
    try:
        return json.loads(text, object_hook=_from_object)
    except (LookupError, TypeError, AttributeError, ArithmeticError, RecursionError) as e:
        raise ValueError(f"it is no packed value: {e}") from None


def _to_object(value: Any) -> Any:
    if isinstance(value, np.bool_ | np.integer):
        return value.item()
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        return {"array": [value.dtype.str, value.shape, value.tobytes().hex()]}
    if type(value).__name__ in RECORDS:
        return {"record": type(value).__name__, **vars(value)}
    if isinstance(value, Picture):
        return {"picture": value.name}
    if isinstance(value, DriverError):
        return {"refused": [value.kind, value.what, value.hint, to_json(value.values)]}
    if isinstance(value, Exception):
        return {"crashed": [type(value).__name__, str(value)]}
    raise TypeError(f"a {type(value).__name__} cannot be written to a transcript")


def _from_object(fields: dict[str, Any]) -> Any:
    if "array" in fields:
        dtype, shape, items = fields["array"]
        if np.dtype(dtype).kind not in "fiub":
            raise ValueError(f"an array of {dtype} is not allowed")
        return frozen(np.frombuffer(bytes.fromhex(items), dtype).reshape(shape))
    if "record" in fields:
        kind = RECORDS[fields.pop("record")]
        side = {"side": Side(fields["side"])} if "side" in fields else {}
        return kind(**fields | side)
    if "picture" in fields:
        return Picture(fields["picture"])
    if "refused" in fields:
        failure, what, hint, figures = fields["refused"]
        error = DriverError(FailureKind(failure), what, hint)
        error.values = dict(figures)
        return error
    if "crashed" in fields:
        name, text = fields["crashed"]
        return type(name, (Exception,), {})(text)  # a class with the name of the recorded one
    return fields
