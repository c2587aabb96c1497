"""Measures the quality of the meshes of all shipped garments."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.physics import EDGES
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour


def smallest_angle(mesh: ClothMesh) -> float:
    """Return the smallest angle of a mesh's triangles [rad]."""
    p = mesh.rest[mesh.triangles]
    u, v = np.roll(p, -1, axis=1) - p, np.roll(p, -2, axis=1) - p
    sine = np.abs(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
    return float(np.arctan2(sine, (u * v).sum(axis=2)).min())


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
            angles.append(smallest_angle(mesh))
            shortest.append(float(mesh.edge_length.min()) / edge)
            longest.append(float(mesh.edge_length.max()) / edge)
    return {
        "mesh_garments": len(names),
        "mesh_min_angle_deg": float(np.rad2deg(min(angles))),
        "mesh_shortest_edge_rel": min(shortest),
        "mesh_longest_edge_rel": max(longest),
        "mesh_cpu_s_max": max(seconds),
    }
