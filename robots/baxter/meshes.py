"""Convert Baxter's visual meshes for a viewer: from COLLADA to binary glTF, cached on disk.

The wheel's DAE files mix axes and materials, which viewers interpret differently (Rerun misplaces the meshes
without an error). They also have ten times as many triangles as a picture of the cell needs. Each mesh is
therefore loaded once with its scene transforms applied, simplified, coloured and written as GLB. The written URDF
has only visuals, which refer to the GLB files.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial

from robots.baxter.camera_mount import MOUNT
from robots.baxter.gripper import GRIPPER
from robots.baxter.model import FLOOR, JOINT_NAMES, baxter_urdf_path
from robots.example_data import package_root
from robots.model_cache import URDF, cached_urdf
from robots.urdf.meshes import CREASE, glb, plastic
from robots.visual import RobotVisual

__all__ = ["baxter_visual", "convert", "visual_glb_urdf"]

FORMAT = 5
"""Version of the output. Increase it when the output changes, so that old caches are not used."""
CELL = 0.0035
"""Grid size of the vertex clustering [m]. This is less than a pixel when the whole robot is in view."""
RED, DARK, BLACK, GREY = (176, 32, 36), (88, 91, 97), (58, 60, 65), (165, 168, 173)
"""Colours of Baxter's plastics (sRGB). The colours in the files would look nearly black in a viewer."""


def baxter_visual() -> RobotVisual:
    """Return Baxter's visual model. Raises StorageError if its meshes cannot be cached."""
    return RobotVisual(
        urdf=visual_glb_urdf(),
        joint_names=JOINT_NAMES,
        head_joint=MOUNT.head_joint,
        finger_joints=GRIPPER.finger_joints,
        floor=FLOOR,
    )


def visual_glb_urdf() -> Path:
    """Return the path of a cached URDF of Baxter whose visuals are GLB files (absolute paths).

    Raises StorageError if the cache cannot be written.
    """
    return cached_urdf(
        baxter_urdf_path().read_bytes(), "baxter-visual", f"{FORMAT} {CELL} {CREASE}", write_visuals
    )


def write_visuals(folder: Path, final: Path) -> None:
    """Write the GLB files and the URDF into `folder`. The URDF names their later paths in `final`."""
    tree = ET.parse(baxter_urdf_path())
    root = tree.getroot()
    for link in root.iter("link"):
        for unwanted in [*link.findall("collision"), *link.findall("inertial")]:
            link.remove(unwanted)
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:  # leave out sensor markers and dummies
                link.remove(visual)
                continue
            path = package_root() / mesh.attrib["filename"].removeprefix("package://")
            name = f"{path.stem}.glb"
            if not (folder / name).exists():
                (folder / name).write_bytes(convert(path))
            mesh.set("filename", str(final / name))
            for material in visual.findall("material"):
                visual.remove(material)  # the GLB contains its own material
    for tag in ("gazebo", "transmission"):
        for unwanted in root.findall(tag):
            root.remove(unwanted)
    tree.write(folder / URDF, encoding="utf-8", xml_declaration=True)


def convert(path: Path) -> bytes:
    """Convert one COLLADA file to GLB in the link's frame [m], simplified and coloured."""
    return glb(path, CELL, lambda part: material(part, path.stem))


def material(part: trimesh.Trimesh, stem: str) -> PBRMaterial:
    """Return one of Baxter's plastics, chosen by the colour that the file gives to `part`."""
    given = getattr(getattr(part.visual, "material", None), "baseColorFactor", None)
    rgb = np.array((90, 90, 90) if given is None else given, dtype=int)[:3]
    if rgb[0] > 2 * rgb[1] + 20:
        colour = RED
    elif stem in ("PEDESTAL", "base_link") or 10 < rgb[0] < 100:
        colour = DARK
    else:
        colour = BLACK if rgb[0] <= 10 else GREY
    return plastic(colour)
