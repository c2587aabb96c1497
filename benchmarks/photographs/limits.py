"""Figures of a set of photographs beside their limits."""

from __future__ import annotations

import math
from collections.abc import Mapping

Limits = Mapping[str, tuple[str, float]]
"""Figure -> '>=' or '<=', and the value that it is compared with."""


def held(limits: Limits, name: str, value: float) -> bool:
    """Whether the limit is kept. A share of no pictures breaks none."""
    relation, limit = limits[name]
    return math.isnan(value) or (value >= limit if relation == ">=" else value <= limit)


def print_figures(figures: Mapping[str, float], limits: Limits) -> None:
    width = max(map(len, figures)) + 2
    for name, value in figures.items():
        asked = ""
        if name in limits:
            relation, bound = limits[name]
            asked = f"  (asked {relation} {bound}: {'held' if held(limits, name, value) else 'MISSED'})"
        print(f"{name:{width}}{value:9.3f}{asked}")
