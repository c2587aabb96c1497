"""The codec of exchanges: bit-exact values, and foreign texts are refused without being executed."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.states.transition_table import Event
from foldcell.cell.transcript.transcript_codec import Picture, pack, unpack
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import GripperState, JointSetpoint, JointState, Side, StopState, TactileReading

J = np.linspace(-1.0, 1.0, 14)
VALUES: list[Any] = [
    None, True, 3, -(2**40), 0.1, -0.0, math.inf, "Zürich", [], [1.5, ["a", None]], Picture("0f" * 32),
    GripperState(1.0, Side.RIGHT, 0.02, 3.5, True, False),
    StopState(2.0, True, "the\tbutton\n"),
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_a_value_is_unpacked_as_packed(value: Any) -> None:
    text = pack(value)
    back = unpack(text)
    assert back == value and type(back) is type(value) and pack(back) == text
    assert text.isascii() and not {"\t", "\n"} & set(text), "these characters separate the parts of the file"


@pytest.mark.parametrize(
    "value",
    [
        JointState(1.0, J, 2 * J, -J, 0.1),
        JointSetpoint(1.0, J.astype(np.float32), np.zeros(14, int), True),
        TactileReading(0.5, Side.LEFT, np.random.default_rng(1).normal(size=(2, 4, 3)), np.array([0.0, -np.nan])),
    ],
    ids=lambda value: type(value).__name__,
)
def test_readings_are_unpacked_bit_for_bit_and_read_only(value: Any) -> None:
    back = unpack(pack(value))
    for name, field in vars(value).items():
        there = getattr(back, name)
        if isinstance(field, np.ndarray):
            assert there.tobytes() == field.tobytes() and there.shape == field.shape and there.dtype == field.dtype
            assert not there.flags.writeable
        else:
            assert there == field and type(there) is type(field)


def test_scalars_and_enums_are_packed_as_plain_values() -> None:
    assert unpack(pack(np.float64(0.1))) == 0.1 and pack(np.float64(0.1)) == pack(0.1)
    assert pack(np.bool_(True)) == pack(True) and pack(np.int64(3)) == pack(3)
    assert pack(Side.LEFT) == pack("left") and unpack(pack(Event.PAUSE)) == Event.PAUSE


def test_equal_texts_mean_equal_values() -> None:
    assert pack(0.0) != pack(-0.0) and pack(1) != pack(1.0) and pack(np.zeros(2)) != pack(np.zeros((2, 1)))
    assert pack((J, J)) == pack((J.copy(), J[::-1][::-1]))


def test_a_packed_exception_is_restored() -> None:
    error = DriverError(FailureKind.CAMERA_FAULT, "no picture", "look at the cable", tries=3)
    raised = unpack(pack(error))
    assert isinstance(raised, DriverError)
    assert raised.failure() == error.failure()
    crash = unpack(pack(KeyError("a bug in a driver")))
    assert f"{type(crash).__name__}: {crash}" == "KeyError: 'a bug in a driver'"


def test_types_that_no_port_returns_are_refused() -> None:
    for value in (object(), b"x", np.array([object()])):
        with pytest.raises(TypeError, match="transcript"):
            pack(value)


@given(st.sampled_from([*VALUES, JointState(1.0, J, J, J, 0.0)]), st.data())
def test_a_damaged_value_is_unpacked_or_refused(value: Any, data: Any) -> None:
    packed = bytearray(pack(value).encode())
    packed[data.draw(st.integers(0, len(packed) - 1))] = data.draw(st.integers(0, 127))
    with suppress(ValueError):
        unpack(packed[: data.draw(st.integers(0, len(packed)))].decode())


@pytest.mark.parametrize(
    "text",
    ['{"array": ["|O8", [1], "00"]}', '{"array": 3}', '{"record": "Path"}', '{"record": "StopState", "oven": 1}',
     '{"refused": ["no kind", "", "", {}]}', '{"crashed": [1, 2]}', "[" * 100_000, "é", ""],
)  # fmt: skip
def test_foreign_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError):
        unpack(text)
