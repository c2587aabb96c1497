"""A class of fabrics: the ranges of the properties that fabrics of this class have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Fabric", "Span"]

Span = tuple[float, float]
"""Smallest and largest value."""


@dataclass(frozen=True)
class Fabric:
    """A class of fabrics, as in fabrics.yaml.

    Each property has the range of the class and the source of the range: areal_mass [kg/m2]; bending_length:
    Peirce's, of the geometric mean of the rigidities along warp and weft [m]; bending_ratio: rigidity along the
    warp divided by that along the weft [1]; thickness: distance that one layer keeps to the next [m];
    friction_layers: coefficient between layers [1].
    """

    name: str
    title: str
    areal_mass: Span
    bending_length: Span
    bending_ratio: Span
    thickness: Span
    friction_layers: Span
    sources: Mapping[str, str]
