"""From places in a picture of a garment to its outline in metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robots.ports import Array
from skills.garments.fitted import fitted_template

__all__ = ["PictureMeasure", "as_laid"]


def as_laid(pixels: Array) -> Array:
    """Turn places (n, 2) in a picture (column, row) into the laid pose: up is forward (x), left is left (y)."""
    return -pixels[:, ::-1]


@dataclass(frozen=True, eq=False)
class PictureMeasure:
    """The size of a picture and the scale of what it shows.

    columns, rows: of the picture [px]. to_laid: converts places (n, 2) in it [px] to the laid pose, in any unit.
    measured: indices of the two key points that lie `length` [m] apart; None if `to_laid` gives metres.
    """

    columns: int
    rows: int
    measured: tuple[int, int] | None
    length: float | None
    to_laid: Callable[[Array], Array] = as_laid

    def template(self, pixels: Array, like: Array) -> Array:
        """Return the template (k, 2) [m] that key points (k, 2) [px] give to a garment like the template `like`
        (k, 2). Raises ValueError for points that give no scale."""
        return fitted_template(self.to_laid(pixels), like, self.measured, self.length)
