"""The printed figures of an entry of the trajectory library."""

from __future__ import annotations

from typing import Any

from skills.trajectory.trajectory_library import LibraryEntry

__all__ = ["figures"]


def figures(entry: LibraryEntry) -> dict[str, Any]:
    return {
        "garment": entry.garment,
        "category": entry.category,
        "step": entry.step,
        "variant": entry.variant,
        "size_m": entry.size_m,
        "method": entry.method,
        "dissimilarity_initial_m": entry.dissimilarity_initial,
        "dissimilarity_m": entry.dissimilarity,
        "simulations": entry.simulations,
        "version": entry.version,
    }
