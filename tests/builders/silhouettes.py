"""Garments that are no more than a silhouette with named key points, for tests of perception."""

from __future__ import annotations

from dataclasses import dataclass

from robots.ports import Array

__all__ = ["Silhouette"]


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The smallest `GarmentOutline`. template: (k, 2) [m], a key point each."""

    name: str
    category: str
    keypoints: tuple[str, ...]
    template: Array
