"""What several of these tests need."""

from tests.rosmaster import rosmaster

__all__ = ["rosmaster"]
