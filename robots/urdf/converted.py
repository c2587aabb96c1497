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

import numpy as np
import platformdirs
import trimesh
from numpy.typing import NDArray
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from foldcell.robots.errors import StorageError
from foldcell.robots.ports import Array
from foldcell.robots.urdf.description import RGB, RobotDescription
from foldcell.robots.urdf.elements import mesh_path, stripped

FORMAT = 2
"""Version of the output. Increase it when the output changes, so that old caches are not used."""
URDF = "robot.urdf"
"""Name of a converted URDF in its cache folder."""
SEEN_CELL, VIEWER_CELL = 0.006, 0.0035
"""Grid sizes of the vertex clustering [m]: two or three pixels in the cell's camera, and less than one in a view
of the whole robot."""
GREY = (165, 168, 173)
CREASE = np.radians(35.0)
"""Smallest angle at which an edge is shaded as sharp [rad]."""


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
            (build / name).write_text(_thinned_obj(source, cell), encoding="utf-8")
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
            return _plastic(choose(source.stem, _given_colour(part)) if choose else colour)

        if not (build / name).exists():
            (build / name).write_bytes(_glb(source, VIEWER_CELL, material))
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


def _thinned_obj(source: Path, cell: float) -> str:
    """Convert a mesh file to one OBJ in the link's frame, with vertices clustered on a grid of `cell` [m]."""
    mesh = trimesh.load_scene(source).to_mesh()
    thin = _thinned(np.asarray(mesh.vertices), np.asarray(mesh.faces), cell)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in thin.vertices]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in thin.vertex_normals]
    lines += ["f " + " ".join(f"{k + 1}//{k + 1}" for k in face) for face in thin.faces]
    return "\n".join(lines) + "\n"


def _glb(path: Path, cell: float, material: Callable[[trimesh.Trimesh], PBRMaterial]) -> bytes:
    """Convert a mesh file to GLB in the link's frame [m], with vertices clustered on a grid of `cell` [m].
    material: of each part of the file."""
    scene = trimesh.load_scene(path)
    out = trimesh.Scene()
    for number, part in enumerate(scene.dump(concatenate=False)):
        if not isinstance(part, trimesh.Trimesh):
            continue
        thin = _thinned(np.asarray(part.vertices, dtype=np.float64), np.asarray(part.faces), cell)
        shaded = trimesh.graph.smooth_shade(thin, angle=CREASE)
        shaded.visual = TextureVisuals(material=material(part))  # type: ignore[no-untyped-call]
        out.add_geometry(shaded, geom_name=f"{path.stem}_{number}")
    return bytes(out.export(file_type="glb", include_normals=True))  # type: ignore[no-untyped-call]


def _thinned(vertices: Array, faces: NDArray, cell: float) -> trimesh.Trimesh:
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


def _given_colour(part: trimesh.Trimesh) -> RGB:
    """Return the colour (sRGB) that a mesh file gives to one of its parts; grey if it gives none."""
    given = getattr(getattr(part.visual, "material", None), "baseColorFactor", None)
    r, g, b = (int(x) for x in ((90, 90, 90) if given is None else given)[:3])
    return r, g, b


def _plastic(colour: RGB) -> PBRMaterial:
    """Return a dull material of a colour (sRGB, 0 to 255)."""
    linear = (np.array(colour) / 255.0) ** 2.2  # glTF's colour factors are linear
    return PBRMaterial(baseColorFactor=[*linear, 1.0], metallicFactor=0.0, roughnessFactor=0.8)  # type: ignore[no-untyped-call]
