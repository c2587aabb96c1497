"""Measures the quality of the meshes of all shipped garments."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.physics import EDGES
from cell.config.garments.garment_file import list_garments, load_garment
from skills.cloth.mesh import mesh_from_contour


def quality(quick: bool, tell: Tell) -> dict[str, Any]:
    """Measure the smallest angle, and the shortest and longest edge relative to the requested edge length."""
    angles, shortest, longest, seconds = [], [], [], []
    names = sorted(list_garments())
    for name in names:
        garment = load_garment(name)
        for edge in EDGES[-1:] if quick else EDGES:
            start = time.thread_time()
            mesh = mesh_from_contour(garment.template, edge, garment.layers)
            seconds.append(time.thread_time() - start)
            angles.append(mesh.quality.min_angle)
            shortest.append(mesh.quality.shortest_edge / edge)
            longest.append(mesh.quality.longest_edge / edge)
    return {
        "mesh_garments": len(names),
        "mesh_min_angle_deg": float(np.rad2deg(min(angles))),
        "mesh_shortest_edge_rel": min(shortest),
        "mesh_longest_edge_rel": max(longest),
        "mesh_cpu_s_max": max(seconds),
    }
