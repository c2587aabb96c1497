"""Baxter's URDF for PyBullet, cached on disk in two versions: one for motion, one for rendering.

PyBullet does not support `package://`. It loads every mesh that the file names and renders every triangle. The
body for motion therefore has no visuals, and the body for rendering has only simplified OBJ meshes.
"""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import trimesh

from robots.baxter.model import baxter_srdf_path, baxter_urdf_path, package_root
from robots.model_cache import cached_urdf, thinned

__all__ = ["moving_urdf", "seen_urdf", "srdf_disabled_pairs"]

FORMAT = 6
"""Version of the output. Increase it when the output changes, so that old caches are not used."""
CELL = 0.006
"""Grid size of the vertex clustering for the arms [m]. This is two or three pixels in the head camera's
picture."""
COARSE_CELL = 0.020
"""Grid size for torso and pedestal [m]. The camera sees little more of them than their shadow."""
MADE_WITH = f"{FORMAT} {CELL} {COARSE_CELL}"
RED, DARK, GREY = (0.62, 0.12, 0.12, 1.0), (0.20, 0.21, 0.23, 1.0), (0.55, 0.56, 0.58, 1.0)


def moving_urdf() -> Path:
    """Return the URDF with collision shapes and inertias, without visuals. Raises StorageError if the cache is not
    writable."""
    return cached_urdf(baxter_urdf_path(), "baxter-bullet-moving", MADE_WITH, _write_moving)


def seen_urdf() -> Path:
    """Return the URDF with simplified visuals, without collision shapes. Raises StorageError if the cache is not
    writable."""
    return cached_urdf(baxter_urdf_path(), "baxter-bullet-seen", MADE_WITH, _write_seen)


def srdf_disabled_pairs() -> frozenset[frozenset[str]]:
    """Return the pairs of links that the SRDF excludes from collision checks."""
    root = ET.parse(baxter_srdf_path()).getroot()
    return frozenset(
        frozenset((pair.attrib["link1"], pair.attrib["link2"])) for pair in root.iter("disable_collisions")
    )


def _urdf_without(*tags: str) -> ET.Element:
    """Return the wheel's URDF without the elements `tags` of its links."""
    root = ET.parse(baxter_urdf_path()).getroot()
    for link in root.iter("link"):
        for tag in tags:
            for element in link.findall(tag):
                link.remove(element)
    for tag in ("gazebo", "transmission"):
        for element in root.findall(tag):
            root.remove(element)
    return root


def _write_moving(build: Path, folder: Path) -> None:
    root = _urdf_without("visual")
    for mesh in root.iter("mesh"):
        # copied, because the cache may outlive the installation
        source = package_root() / mesh.attrib["filename"].removeprefix("package://")
        shutil.copyfile(source, build / source.name)
        mesh.set("filename", str(folder / source.name))
    ET.ElementTree(root).write(build / "baxter.urdf", encoding="utf-8", xml_declaration=True)


def _write_seen(build: Path, folder: Path) -> None:
    root = _urdf_without("collision")
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:  # leave out sensor markers and dummies
                link.remove(visual)
                continue
            source = package_root() / mesh.attrib["filename"].removeprefix("package://")
            target = build / f"{source.stem}.obj"
            if not target.exists():
                target.write_text(_thinned_obj(source))
            mesh.set("filename", str(folder / target.name))
            for material in visual.findall("material"):
                visual.remove(material)
            material = ET.SubElement(visual, "material", name=source.stem)
            ET.SubElement(material, "color", rgba=" ".join(map(str, _colour(source.stem))))
    ET.ElementTree(root).write(build / "baxter.urdf", encoding="utf-8", xml_declaration=True)


def _thinned_obj(source: Path) -> str:
    """Convert a COLLADA file to one OBJ in the link's frame, with vertices clustered on a grid."""
    cell = COARSE_CELL if source.stem in ("PEDESTAL", "base_link") else CELL
    mesh = trimesh.load_scene(source).to_mesh()
    thin = thinned(np.asarray(mesh.vertices), np.asarray(mesh.faces), cell)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in thin.vertices]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in thin.vertex_normals]
    lines += ["f " + " ".join(f"{k + 1}//{k + 1}" for k in face) for face in thin.faces]
    return "\n".join(lines) + "\n"


def _colour(stem: str) -> tuple[float, ...]:
    if stem in ("PEDESTAL", "base_link", "S0", "E0", "W0", "W2") or "finger" in stem or "tip" in stem:
        return DARK
    return RED if stem in ("S1", "E1", "W1", "H1") else GREY
