"""One exchange between the executive and its cell, as a value and as bytes.

An exchange is a question (port, method and arguments) and its answer. Equal bytes mean equal values, bit for bit:

    N T F         nothing, true, false           i  integer, 8 bytes       f  float, 8 bytes
    s  text       length (4), UTF-8              (  tuple: count (4), then its items
    a  array      length (1) and name of the dtype, dimensions (1), each (4), then the items in C order
    r  record     index in RECORDS (1), then its fields in order
    e  enum       index in ENUMS (1), then its value
    p  picture    the 32 bytes of its name in the run's frame store
    !  refusal    kind, what, hint, and the figures as JSON: a DriverError
    x  crash      name and text of any other exception

All numbers are little-endian. Reading executes no code from the file.
"""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.states.transition_table import Event
from cell.support.json_values import to_json
from robots.errors import DriverError, FailureKind
from robots.ports import (
    BoardPlace,
    GripperState,
    JointSetpoint,
    JointState,
    Side,
    StopState,
    TactileReading,
    frozen,
)

__all__ = ["ENUMS", "RECORDS", "Channel", "Exchange", "Picture", "Raised", "pack", "pack_raised", "unpack"]


class Channel(Enum):
    """The kinds of question. The value of each kind is its name in a transcript."""

    NOW = "clock.now"
    SLEEP = "clock.sleep_until"
    ARMS = "arms.state"
    ENABLE = "arms.enable"
    SET_POINT = "arms.command"
    HEAD = "head.command_pan"
    CALIBRATE = "gripper.calibrate"
    GRIP = "gripper.command"
    GRIPPER = "gripper.state"
    TACTILE = "tactile.reading"
    CAPTURE = "camera.capture"
    GLIMPSE = "camera.glimpse"
    STOP = "stop.state"
    LAY = "attendant.lay_garment"
    BOARD = "attendant.bring_board"
    TAKE = "commands.take"
    WAIT = "commands.wait"
    EDIT = "commands.edit"
    END = "end"  # the end of the run, the last exchange


@dataclass(frozen=True)
class Picture:
    """A camera frame, represented by its name in the frame store: 64 hexadecimal digits."""

    name: str


@dataclass(frozen=True)
class Raised:
    """An exception as an answer."""

    error: Exception


@dataclass(frozen=True)
class Exchange:
    """A question and its answer. question: the packed arguments; answer: the packed answer."""

    channel: Channel
    question: bytes
    answer: bytes


RECORDS: tuple[type, ...] = (JointState, JointSetpoint, GripperState, TactileReading, StopState)
ENUMS: tuple[type[Enum], ...] = (Side, BoardPlace, Event)

_COUNT = struct.Struct("<I")
_FLOAT = struct.Struct("<cd")
_INT = struct.Struct("<cq")


def pack(value: object) -> bytes:
    """Pack a value into bytes. Raises TypeError for a type that no port uses."""
    packer = _PACKERS.get(type(value))
    if packer is None:
        raise TypeError(f"a {type(value).__name__} cannot be written to a transcript")
    return packer(value)


def pack_raised(error: Exception) -> bytes:
    """Pack an exception as an answer."""
    if isinstance(error, DriverError):
        figures = json.dumps(to_json(error.values))
        return b"!" + b"".join(map(_text, (error.kind.value, error.what, error.hint, figures)))
    return b"x" + _text(type(error).__name__) + _text(str(error))


def unpack(data: bytes) -> Any:
    """Unpack a value: a camera frame gives a Picture, an exception gives a Raised. Raises ValueError for invalid
    bytes."""
    try:
        value, end = _unpack(memoryview(data), 0)
    except (struct.error, LookupError, TypeError, RecursionError) as e:
        raise ValueError(f"it is no packed value: {e}") from None
    if end != len(data):
        raise ValueError(f"{len(data) - end} bytes too many")
    return value


# packing


def _text(value: str) -> bytes:
    data = value.encode()
    return _COUNT.pack(len(data)) + data


def _array(value: NDArray[Any]) -> bytes:
    name = value.dtype.str.encode()
    shape = struct.pack(f"<{value.ndim}I", *value.shape)
    return b"".join((b"a", bytes((len(name),)), name, bytes((value.ndim,)), shape, value.tobytes()))


def _tuple(value: tuple[object, ...]) -> bytes:
    return b"".join((b"(", _COUNT.pack(len(value)), *map(pack, value)))


def _record(number: int, kind: type) -> Callable[[Any], bytes]:
    head = b"r" + bytes((number,))
    names = tuple(f.name for f in dataclasses.fields(kind))
    return lambda value: head + b"".join([pack(getattr(value, name)) for name in names])


def _members(number: int, kind: type[Enum]) -> Callable[[Any], bytes]:
    packed = {member: b"e" + bytes((number,)) + _text(str(member.value)) for member in kind}
    return packed.__getitem__


def _float(value: float) -> bytes:
    return _FLOAT.pack(b"f", value)


def _int(value: int) -> bytes:
    return _INT.pack(b"i", value)


def _bool(value: bool) -> bytes:
    return b"T" if value else b"F"


_PACKERS: Mapping[type, Callable[[Any], bytes]] = {
    type(None): lambda value: b"N",
    bool: _bool,
    np.bool_: _bool,
    int: _int,
    np.int64: _int,
    float: _float,
    np.float64: _float,
    str: lambda value: b"s" + _text(value),
    tuple: _tuple,
    np.ndarray: _array,
    Picture: lambda value: b"p" + bytes.fromhex(value.name),
    **{kind: _record(i, kind) for i, kind in enumerate(RECORDS)},
    **{kind: _members(i, kind) for i, kind in enumerate(ENUMS)},
}


# unpacking


def _unpack(data: memoryview, at: int) -> tuple[Any, int]:
    """Return the value that begins at byte `at`, and the position of its end."""
    tag = bytes(data[at : at + 1])
    return _UNPACKERS[tag](data, at + 1)


def _take(data: memoryview, at: int, size: int) -> tuple[bytes, int]:
    if at + size > len(data):
        raise ValueError("it is truncated")
    return bytes(data[at : at + size]), at + size


def _read_text(data: memoryview, at: int) -> tuple[str, int]:
    (size,) = _COUNT.unpack_from(data, at)
    text, end = _take(data, at + _COUNT.size, size)
    return text.decode(), end


def _read_array(data: memoryview, at: int) -> tuple[NDArray[Any], int]:
    name, at = _take(data, at + 1, data[at])
    dtype = np.dtype(name.decode("ascii"))
    if dtype.kind not in "fiub":
        raise ValueError(f"an array of {dtype} is not allowed")
    dimensions = data[at]
    shape = struct.unpack_from(f"<{dimensions}I", data, at + 1)
    at += 1 + 4 * dimensions
    items, end = _take(data, at, dtype.itemsize * int(np.prod(shape, dtype=np.int64)))
    return frozen(np.frombuffer(items, dtype).reshape(shape)), end


def _read_tuple(data: memoryview, at: int) -> tuple[tuple[Any, ...], int]:
    (count,) = _COUNT.unpack_from(data, at)
    at += _COUNT.size
    items = []
    for _ in range(count):
        item, at = _unpack(data, at)
        items.append(item)
    return tuple(items), at


def _read_record(data: memoryview, at: int) -> tuple[Any, int]:
    kind, at = RECORDS[data[at]], at + 1
    values = []
    for _ in dataclasses.fields(kind):
        value, at = _unpack(data, at)
        values.append(value)
    return kind(*values), at


def _read_enum(data: memoryview, at: int) -> tuple[Enum, int]:
    kind = ENUMS[data[at]]
    value, end = _read_text(data, at + 1)
    return kind(value), end


def _read_picture(data: memoryview, at: int) -> tuple[Picture, int]:
    name, end = _take(data, at, 32)
    return Picture(name.hex()), end


def _read_refusal(data: memoryview, at: int) -> tuple[Raised, int]:
    kind, at = _read_text(data, at)
    what, at = _read_text(data, at)
    hint, at = _read_text(data, at)
    figures, at = _read_text(data, at)
    error = DriverError(FailureKind(kind), what, hint)
    error.values = dict(json.loads(figures))
    return Raised(error), at


def _read_crash(data: memoryview, at: int) -> tuple[Raised, int]:
    name, at = _read_text(data, at)
    text, at = _read_text(data, at)
    return Raised(type(name, (Exception,), {})(text)), at  # a class with the name of the recorded one


def _read_float(data: memoryview, at: int) -> tuple[float, int]:
    return struct.unpack_from("<d", data, at)[0], at + 8


def _read_int(data: memoryview, at: int) -> tuple[int, int]:
    return struct.unpack_from("<q", data, at)[0], at + 8


_UNPACKERS: Mapping[bytes, Callable[[memoryview, int], tuple[Any, int]]] = {
    b"N": lambda data, at: (None, at),
    b"T": lambda data, at: (True, at),
    b"F": lambda data, at: (False, at),
    b"i": _read_int,
    b"f": _read_float,
    b"s": _read_text,
    b"(": _read_tuple,
    b"a": _read_array,
    b"r": _read_record,
    b"e": _read_enum,
    b"p": _read_picture,
    b"!": _read_refusal,
    b"x": _read_crash,
}
