"""A convex corner of an outline."""

from __future__ import annotations

from dataclasses import dataclass

from skills.vocabulary import Array

__all__ = ["Corner"]


@dataclass(frozen=True, eq=False)
class Corner:
    """point: (2,) its tip [m]; inward: (2,) unit, its bisector."""

    point: Array
    inward: Array
