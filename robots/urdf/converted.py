"""The URDF of a robot for PyBullet's physics, for the renderer and for the viewer, cached on disk.

PyBullet does not support `package://`. It loads every mesh that the file names and renders every triangle. The
body for motion therefore has no visuals, and the body for rendering has only simplified OBJ meshes. Meshes are
copied or converted, because a cache may outlive the installation.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import platformdirs
import trimesh
from trimesh.visual.material import PBRMaterial

from foldcell.robots.errors import StorageError
from foldcell.robots.urdf.description import RobotDescription
from foldcell.robots.urdf.elements import mesh_path, stripped
from foldcell.robots.urdf.meshes import CREASE, given_colour, glb, plastic, thinned_obj

__all__ = ["moving_urdf", "seen_urdf", "viewer_urdf"]

FORMAT = 2
"""Version of the output. Increase it when the output changes, so that old caches are not used."""
URDF = "robot.urdf"
"""Name of a converted URDF in its cache folder."""
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

    return _converted(description, "moving", ("visual",), copied, lambda _, stem: None)


def seen_urdf(description: RobotDescription) -> Path:
    """Return the URDF with simplified visuals, without collision shapes. Raises StorageError if the cache is not
    writable."""

    def thin(source: Path, build: Path) -> str:
        name = f"{source.stem}.obj"
        if not (build / name).exists():
            cell = description.rendered_grid.get(source.stem, SEEN_CELL)
            (build / name).write_text(thinned_obj(source, cell), encoding="utf-8")
        return name

    def paint(visual: ET.Element, stem: str) -> None:
        _without_material(visual)
        rgb = (description.rendered_colour or _brightened)(stem)
        material = ET.SubElement(visual, "material", name=stem)
        ET.SubElement(material, "color", rgba=" ".join(map(str, (*rgb, 1.0))))

    def _brightened(stem: str) -> tuple[float, ...]:
        """Return a mesh's colour, darkened, because the renderer shows colours brighter than a viewer."""
        return tuple(round((c / 255.0) ** 1.6, 3) for c in description.colours.get(stem, GREY))

    return _converted(description, "seen", ("collision",), thin, paint)


def viewer_urdf(description: RobotDescription) -> Path:
    """Return the URDF whose visuals are GLB files, without collision shapes and inertias. The GLB files contain
    their materials. Viewers interpret other formats differently; Rerun misplaces the meshes of COLLADA files
    without an error. Raises StorageError if the cache is not writable."""

    def coloured(source: Path, build: Path) -> str:
        name, colour = f"{source.stem}.glb", description.colours.get(source.stem, GREY)

        def material(part: trimesh.Trimesh) -> PBRMaterial:
            choose = description.part_colour
            return plastic(choose(source.stem, given_colour(part)) if choose else colour)

        if not (build / name).exists():
            (build / name).write_bytes(glb(source, VIEWER_CELL, material))
        return name

    def unpaint(visual: ET.Element, stem: str) -> None:
        _without_material(visual)

    return _converted(description, "viewer", ("collision", "inertial"), coloured, unpaint)


def _without_material(visual: ET.Element) -> None:
    for material in visual.findall("material"):
        visual.remove(material)


def _converted(
    description: RobotDescription,
    use: str,
    without: tuple[str, ...],
    convert: Callable[[Path, Path], str],
    paint: Callable[[ET.Element, str], None],
) -> Path:
    """Return the path of the cached URDF for a use, without the elements `without` of its links. It is created if
    it is missing. convert(source, build): writes the mesh for this use into the folder `build` and returns its
    name. paint(element, stem): changes the materials of an element with the mesh `stem`."""
    text = description.urdf()
    figures = f"{FORMAT} {SEEN_CELL} {VIEWER_CELL} {CREASE} {sorted(description.colours.items())}"
    made_with = f"{figures} {sorted(description.rendered_grid.items())}"
    digest = hashlib.sha256(text.encode() + made_with.encode()).hexdigest()[:12]
    folder = Path(platformdirs.user_cache_dir("foldcell")) / f"{description.name}-{use}-{digest}"
    urdf = folder / URDF
    if urdf.is_file():
        return urdf
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        build = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            root = stripped(text, *without)
            for element in root.iter():
                mesh = element.find("geometry/mesh")
                if mesh is not None:
                    source = mesh_path(mesh.attrib["filename"], description.meshes())
                    mesh.set("filename", str(folder / convert(source, build)))
                    paint(element, source.stem)
            ET.ElementTree(root).write(build / URDF, encoding="utf-8", xml_declaration=True)
            _publish(build, urdf)
        finally:
            shutil.rmtree(build, ignore_errors=True)
    except OSError as error:
        raise StorageError(
            f"the robot's model cannot be cached in {folder.parent}: {error.strerror}",
            "make the folder writable, or set XDG_CACHE_HOME to a writable folder",
            path=str(folder),
        ) from error
    return urdf


def _publish(build: Path, urdf: Path) -> None:
    """Rename the finished folder of `urdf` atomically. If another process was faster, use its folder."""
    build.chmod(0o755)
    try:
        os.rename(build, urdf.parent)
    except OSError:
        if not urdf.is_file():
            raise
