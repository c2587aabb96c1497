"""Outlines of six real garments, and their key points as marked by eye.

The outlines were measured in public pictures: four T-shirts (one a polo shirt), a shirt whose long sleeves lie
beside the body, and flared trousers. They show what the shipped templates do not have: sleeves that droop by 40 to
60 degrees, underarm seams that are short or missing, rounded shoulders, and hems that are wider than the waist.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foldcell.cell.config.yaml_file import read_yaml
from foldcell.robots.ports import Array

_FOLDER = Path(__file__).parent
LIKE = {"t_shirt": "t_shirt", "long_sleeve_shirt": "long_sleeve_shirt_small", "pants": "pants"}
"""The shipped garment of each category to which these garments are compared."""


@dataclass(frozen=True, eq=False)
class RealGarment:
    """A garment, lying flat. outline: (n, 2), keypoints: name -> (2,), in units of its height; x to the right and
    y up in its picture."""

    name: str
    category: str
    outline: Array
    keypoints: Mapping[str, Array]

    @property
    def like(self) -> str:
        return LIKE[self.category]


def real_garments() -> tuple[RealGarment, ...]:
    """Return the six garments."""
    outlines = json.loads((_FOLDER / "outlines.json").read_text(encoding="utf-8"))
    marks = read_yaml(_FOLDER / "marks.yaml", "file of key points").data
    return tuple(
        RealGarment(
            name,
            found["category"],
            np.array(found["outline"]),
            {point: np.array(place) for point, place in marks[name].items()},
        )
        for name, found in outlines.items()
    )
