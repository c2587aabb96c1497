"""Cache of converted models of robots in the user's cache folder, and mesh simplification for them."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import platformdirs
import trimesh
from numpy.typing import NDArray

from robots.errors import StorageError
from robots.ports import Array

__all__ = ["URDF", "cached_urdf", "thinned"]

URDF = "robot.urdf"
"""Name of a converted URDF in its cache folder."""


def cached_urdf(source: bytes, name: str, made_with: str, write: Callable[[Path, Path], None]) -> Path:
    """Return the path of `robot.urdf` in the cache folder `name`. `write` creates it if it is missing.

    source: content of the robot's URDF. made_with: text that identifies the parameters of the conversion. Each
    source and text has a separate folder. write(build, folder): writes `robot.urdf` and its meshes into `build`,
    with paths that refer to `folder`. Raises StorageError if the cache cannot be written.
    """
    digest = hashlib.sha256(source + made_with.encode()).hexdigest()[:12]
    folder = Path(platformdirs.user_cache_dir("foldcell")) / f"{name}-{digest}"
    urdf = folder / URDF
    if urdf.is_file():
        return urdf
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        build = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=folder.parent))
        try:
            write(build, folder)
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
