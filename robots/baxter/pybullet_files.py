"""Baxter's URDF for PyBullet, cached on disk in two versions: one for motion, one for rendering.

PyBullet does not support `package://`. It loads every mesh that the file names and renders every triangle. The
body for motion therefore has no visuals, and the body for rendering has only simplified OBJ meshes.
"""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

from robots.baxter.model import baxter_srdf_path, baxter_urdf_path
from robots.example_data import package_root
from robots.model_cache import URDF, cached_urdf
from robots.urdf.elements import stripped
from robots.urdf.meshes import thinned_obj

__all__ = ["moving_urdf", "seen_urdf", "srdf_disabled_pairs"]

FORMAT = 7
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
    return cached_urdf(baxter_urdf_path().read_bytes(), "baxter-bullet-moving", MADE_WITH, _write_moving)


def seen_urdf() -> Path:
    """Return the URDF with simplified visuals, without collision shapes. Raises StorageError if the cache is not
    writable."""
    return cached_urdf(baxter_urdf_path().read_bytes(), "baxter-bullet-seen", MADE_WITH, _write_seen)


def srdf_disabled_pairs() -> frozenset[frozenset[str]]:
    """Return the pairs of links that the SRDF excludes from collision checks."""
    root = ET.parse(baxter_srdf_path()).getroot()
    return frozenset(
        frozenset((pair.attrib["link1"], pair.attrib["link2"])) for pair in root.iter("disable_collisions")
    )


def _write_moving(build: Path, folder: Path) -> None:
    root = stripped(baxter_urdf_path().read_text(encoding="utf-8"), "visual")
    for mesh in root.iter("mesh"):
        # copied, because the cache may outlive the installation
        source = package_root() / mesh.attrib["filename"].removeprefix("package://")
        shutil.copyfile(source, build / source.name)
        mesh.set("filename", str(folder / source.name))
    ET.ElementTree(root).write(build / URDF, encoding="utf-8", xml_declaration=True)


def _write_seen(build: Path, folder: Path) -> None:
    root = stripped(baxter_urdf_path().read_text(encoding="utf-8"), "collision")
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:  # leave out sensor markers and dummies
                link.remove(visual)
                continue
            source = package_root() / mesh.attrib["filename"].removeprefix("package://")
            target = build / f"{source.stem}.obj"
            if not target.exists():
                cell = COARSE_CELL if source.stem in ("PEDESTAL", "base_link") else CELL
                target.write_text(thinned_obj(source, cell))
            mesh.set("filename", str(folder / target.name))
            for material in visual.findall("material"):
                visual.remove(material)
            material = ET.SubElement(visual, "material", name=source.stem)
            ET.SubElement(material, "color", rgba=" ".join(map(str, _colour(source.stem))))
    ET.ElementTree(root).write(build / URDF, encoding="utf-8", xml_declaration=True)


def _colour(stem: str) -> tuple[float, ...]:
    if stem in ("PEDESTAL", "base_link", "S0", "E0", "W0", "W2") or "finger" in stem or "tip" in stem:
        return DARK
    return RED if stem in ("S1", "E1", "W1", "H1") else GREY
