"""Fixtures shared by the tests of robots."""

from tests.rosmaster import rosmaster

__all__ = ["rosmaster"]
