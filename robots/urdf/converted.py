"""The URDF of a robot for PyBullet's physics, for the renderer and for the viewer, cached on disk.

PyBullet does not support `package://`. It loads every mesh that the file names and renders every triangle. The
body for motion therefore has no visuals, and the body for rendering has only simplified OBJ meshes. Meshes are
copied or converted, because a cache may outlive the installation.
"""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from robots.bullet.body import BodyDescription, BulletBody
from robots.model_cache import URDF, cached_urdf
from robots.ports import Side
from robots.urdf.description import RobotDescription
from robots.urdf.elements import mesh_path, neighbours, stripped
from robots.urdf.meshes import CREASE, glb, plastic, thinned_obj

__all__ = ["load_body", "moving_urdf", "seen_urdf", "viewer_urdf"]

FORMAT = 1
"""Version of the output. Increase it when the output changes, so that old caches are not used."""
SEEN_CELL, VIEWER_CELL = 0.006, 0.0035
"""Grid sizes of the vertex clustering [m]: two or three pixels in the cell's camera, and less than one in a view
of the whole robot."""
GREY = (165, 168, 173)


def moving_urdf(description: RobotDescription) -> Path:
    """Return the URDF with collision shapes and inertias, without visuals. Raises StorageError if the cache is not
    writable."""

    def copied(source: Path, build: Path) -> str:
        name = f"{source.parent.name}-{source.name}"
        shutil.copyfile(source, build / name)
        return name

    return _converted(description, "moving", "visual", copied)


def seen_urdf(description: RobotDescription) -> Path:
    """Return the URDF with simplified visuals, without collision shapes. Raises StorageError if the cache is not
    writable."""

    def thin(source: Path, build: Path) -> str:
        name = f"{source.stem}.obj"
        if not (build / name).exists():
            (build / name).write_text(thinned_obj(source, SEEN_CELL), encoding="utf-8")
        return name

    return _converted(description, "seen", "collision", thin)


def viewer_urdf(description: RobotDescription) -> Path:
    """Return the URDF whose visuals are GLB files, without collision shapes and inertias. Raises StorageError if
    the cache is not writable."""

    def coloured(source: Path, build: Path) -> str:
        name, colour = f"{source.stem}.glb", description.colours.get(source.stem, GREY)
        if not (build / name).exists():
            (build / name).write_bytes(glb(source, VIEWER_CELL, lambda _: plastic(colour)))
        return name

    return _converted(description, "viewer", "collision", coloured)


def load_body(description: RobotDescription, client: int) -> BulletBody:
    """Load the robot into the PyBullet world `client`. Raises StorageError if its files cannot be cached."""
    return BulletBody(
        client,
        BodyDescription(
            urdf=moving_urdf(description),
            joint_names=description.joint_names,
            head_joint=description.camera.head_joint,
            gripper=description.gripper,
            tool_links=description.tool_links,
            disabled_pairs=neighbours(description.urdf()) | description.disabled_pairs(),
            fingers=[link for side in Side for link in description.fingers[side]],
            efforts=(*description.efforts, *description.efforts),
        ),
    )


def _converted(
    description: RobotDescription, use: str, without: str, convert: Callable[[Path, Path], str]
) -> Path:
    """Return the cached URDF for a use. convert(source, build): writes the mesh for this use and returns its
    name."""
    text = description.urdf()

    def write(build: Path, folder: Path) -> None:
        root = stripped(text, without)
        for element in root.iter():
            mesh = element.find("geometry/mesh")
            if mesh is None:
                continue
            source = mesh_path(mesh.attrib["filename"], description.meshes())
            mesh.set("filename", str(folder / convert(source, build)))
            if use == "viewer":
                for material in element.findall("material"):
                    element.remove(material)  # the GLB contains its own material
            elif use == "seen":
                _paint(element, source.stem, description.colours.get(source.stem, GREY))
        ET.ElementTree(root).write(build / URDF, encoding="utf-8", xml_declaration=True)

    made_with = f"{FORMAT} {SEEN_CELL} {VIEWER_CELL} {CREASE} {sorted(description.colours.items())}"
    return cached_urdf(text.encode(), f"{description.name}-{use}", made_with, write)


def _paint(visual: ET.Element, name: str, colour: tuple[int, int, int]) -> None:
    for material in visual.findall("material"):
        visual.remove(material)
    rgba = " ".join(
        f"{(c / 255.0) ** 1.6:.3f}" for c in colour
    )  # the renderer shows colours brighter than a viewer
    ET.SubElement(ET.SubElement(visual, "material", name=name), "color", rgba=f"{rgba} 1")
