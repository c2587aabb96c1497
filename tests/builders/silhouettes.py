"""Garments for tests of perception: a silhouette with named key points, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass

from foldcell.robots.ports import Array


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The smallest `GarmentOutline`. template: (k, 2) [m], one row per key point."""

    name: str
    category: str
    keypoints: tuple[str, ...]
    template: Array
