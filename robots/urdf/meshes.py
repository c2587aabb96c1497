"""Meshes of a robot for a renderer (OBJ) and for a viewer (binary glTF), simplified."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from foldcell.robots.ports import Array
from foldcell.robots.urdf.description import RGB

__all__ = ["CREASE", "given_colour", "glb", "plastic", "thinned_obj"]

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


def thinned(vertices: Array, faces: NDArray, cell: float) -> trimesh.Trimesh:
    """Simplify by vertex clustering: replace the vertices (n, 3) [m] in each grid cell of size `cell` [m] by their
    mean, and remove collapsed faces."""
    _, cluster = np.unique(np.round(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    cluster = cluster.ravel()
    count = np.bincount(cluster)
    mean = np.stack([np.bincount(cluster, vertices[:, k]) for k in range(3)], axis=1) / count[:, None]
    f = cluster[faces]
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    _, first = np.unique(np.sort(f, axis=1), axis=0, return_index=True)
    return trimesh.Trimesh(mean, f[np.sort(first)], process=False)


def given_colour(part: trimesh.Trimesh) -> RGB:
    """Return the colour (sRGB) that a mesh file gives to one of its parts; grey if it gives none."""
    given = getattr(getattr(part.visual, "material", None), "baseColorFactor", None)
    r, g, b = (int(x) for x in ((90, 90, 90) if given is None else given)[:3])
    return r, g, b


def plastic(colour: RGB) -> PBRMaterial:
    """Return a dull material of a colour (sRGB, 0 to 255)."""
    linear = (np.array(colour) / 255.0) ** 2.2  # glTF's colour factors are linear
    return PBRMaterial(baseColorFactor=[*linear, 1.0], metallicFactor=0.0, roughnessFactor=0.8)  # type: ignore[no-untyped-call]
