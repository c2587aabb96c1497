"""Fixtures shared by the tests of robots."""

from collections.abc import Iterator

import pybullet as pb
import pytest

from tests.rosmaster import rosmaster

__all__ = ["client", "rosmaster"]


@pytest.fixture
def client() -> Iterator[int]:
    number = pb.connect(pb.DIRECT)
    pb.setTimeStep(1 / 240, physicsClientId=number)
    pb.setGravity(0, 0, -9.81, physicsClientId=number)
    yield number
    pb.disconnect(physicsClientId=number)
