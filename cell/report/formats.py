"""Figures and names as text for the report: units, labels and explanations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["FIGURE_NOTES", "figure_name", "flatten", "length", "quantity", "seconds", "words"]


def length(metres: float | None) -> str:
    """Format a length [m] as '12.3 mm'; a dash for an unknown value."""
    if metres is None or not np.isfinite(metres):
        return "–"
    return f"{metres * 1000.0:.1f} mm"


def seconds(s: float | None) -> str:
    """Format a duration [s] as '8.31 s', '83.1 s' or '2 min 03 s'."""
    if s is None or not np.isfinite(s):
        return "–"
    if s >= 120.0:
        return f"{int(s) // 60} min {int(s) % 60:02d} s"
    return f"{s:.2f} s" if s < 10.0 else f"{s:.1f} s"


def quantity(value: float | None, unit: str = "") -> str:
    """Format a figure as text: metres in mm, radians in degrees."""
    if value is None or not np.isfinite(value):
        return "–"
    if unit == "m":
        return length(value)
    if unit == "rad":
        return f"{np.degrees(value):.1f}°"
    return f"{value:.3f}" + (f" {unit}" if unit else "")


def words(name: str) -> str:
    """Convert a name to words: 'planning_motion' -> 'Planning motion'."""
    return name.replace("_", " ").strip().capitalize()


FIGURES = {
    "iou": "Overlap of the outlines (IoU)",
    "correspondence_m": "Mean distance of corresponding points",
    "edges_m": "Largest distance of edges that belong together",
    "keypoints_m": "Largest distance of a key point from its place",
    "height_m": "Height of the stack away from creases, 95th percentile",
    "crease_height_m": "Height beside creases, 95th percentile",
    "drift_m": "Drift",
    "drift_rad": "Turn",
}
FIGURE_NOTES = {
    "iou": "Intersection over union: the area that garment and target share, relative to that of both.",
    "correspondence_m": "Distance of every place of the cloth from its place in the target, on average.",
    "edges_m": "Edges that the garment file names as a pair, such as two hems, lie on each other.",
    "keypoints_m": "Key points are the named corners of the garment.",
    "height_m": "95 % of the places are lower.",
    "crease_height_m": "Within 40 mm of a fold line; 95 % of the places are lower.",
    "drift_m": "How far the whole garment lies from the target.",
    "drift_rad": "By how much the whole garment is turned.",
}


def figure_name(name: str) -> str:
    """Return the label of a figure of the score."""
    return FIGURES.get(name, words(name))


def flatten(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Flatten nested settings to pairs (dotted key, text)."""
    rows: list[tuple[str, str]] = []
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            rows += flatten(value, f"{name}.")
        elif isinstance(value, (list, tuple)):
            rows.append((name, ", ".join(str(v) for v in value)))
        else:
            rows.append((name, str(value)))
    return rows
