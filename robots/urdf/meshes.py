"""Meshes of a robot for a renderer (OBJ) and for a viewer (binary glTF), simplified."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from robots.model_cache import thinned

__all__ = ["CREASE", "glb", "plastic", "thinned_obj"]

CREASE = np.radians(35.0)
"""Smallest angle at which an edge is shaded as sharp [rad]."""


def thinned_obj(source: Path, cell: float) -> str:
    """Convert a mesh file to one OBJ in the link's frame, with vertices clustered on a grid of `cell` [m]."""
    mesh = trimesh.load_scene(source).to_mesh()
    thin = thinned(np.asarray(mesh.vertices), np.asarray(mesh.faces), cell)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in thin.vertices]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in thin.vertex_normals]
    lines += ["f " + " ".join(f"{k + 1}//{k + 1}" for k in face) for face in thin.faces]
    return "\n".join(lines) + "\n"


def glb(path: Path, cell: float, material: Callable[[trimesh.Trimesh], PBRMaterial]) -> bytes:
    """Convert a mesh file to GLB in the link's frame [m], with vertices clustered on a grid of `cell` [m].
    material: of each part of the file."""
    scene = trimesh.load_scene(path)
    out = trimesh.Scene()
    for number, part in enumerate(scene.dump(concatenate=False)):
        if not isinstance(part, trimesh.Trimesh):
            continue
        thin = thinned(np.asarray(part.vertices, dtype=np.float64), np.asarray(part.faces), cell)
        shaded = trimesh.graph.smooth_shade(thin, angle=CREASE)
        shaded.visual = TextureVisuals(material=material(part))  # type: ignore[no-untyped-call]
        out.add_geometry(shaded, geom_name=f"{path.stem}_{number}")
    return bytes(out.export(file_type="glb", include_normals=True))  # type: ignore[no-untyped-call]


def plastic(colour: tuple[int, int, int]) -> PBRMaterial:
    """Return a dull material of a colour (sRGB, 0 to 255)."""
    linear = (np.array(colour) / 255.0) ** 2.2  # glTF's colour factors are linear
    return PBRMaterial(baseColorFactor=[*linear, 1.0], metallicFactor=0.0, roughnessFactor=0.8)  # type: ignore[no-untyped-call]
