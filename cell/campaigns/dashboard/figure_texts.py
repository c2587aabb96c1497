"""Figures as text with units. The unit follows from the last part of a figure's name."""

from __future__ import annotations

import math
from typing import Any

__all__ = ["figure_text", "value_text"]

LONGEST = 120
"""Longest text of a value of unknown kind [characters]."""


def figure_text(name: str, value: Any) -> str:
    """Return a figure in mm (`_m`), degrees (`_rad`), s (`_s`), percent (reliability) or as a share; empty if the
    value is missing."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return value_text(value)
    if name.endswith("_m"):
        return f"{1e3 * value:.1f} mm"
    if name.endswith("_rad"):
        return f"{math.degrees(value):.1f}°"
    if name.endswith("_s"):
        return f"{value:.1f} s"
    return f"{100 * value:.0f} %" if name == "reliability" else f"{value:.3f}"


def value_text(value: Any) -> str:
    """Return a value of any kind as short text; empty if it is missing."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
