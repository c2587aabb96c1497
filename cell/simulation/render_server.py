"""The renderer's own process: a PyBullet world that only exists to be looked at.

PyBullet's TinyRenderer leaks and may crash; here it can do both without taking the cell along. The garment
is a puppet: a soft body without physics whose vertices are set before each picture. One step of a
microsecond is needed after that, or the camera shows the old shape. Run by `cell.simulation.camera`:

    python -m cell.simulation.render_server FD
"""

from __future__ import annotations

import sys
import tempfile
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np
import pybullet as pb
from numpy.typing import NDArray

from skills.vocabulary import Array, Table

__all__ = ["Picture", "Scene", "Shot", "main"]

FAR, NEAR = 4.0, 0.25  # of the view [m]
STEP = 1e-6  # [s]
HIDDEN = -5.0  # where the puppet waits until the garment is laid, below the floor [m]
FLOOR = -0.924  # of the base frame [m]
FLOOR_RGB = (112, 114, 118)


@dataclass(frozen=True, eq=False)
class Scene:
    """What is in the picture. Textures: (h, w, 3) RGB. garment: vertices (n, 3), texture coordinates (n, 2)
    and triangles (m, 3) of its mesh. light: where it comes from; ambient, diffuse: its coefficients."""

    urdf: str
    table: Table
    table_texture: NDArray[np.uint8]
    garment_uv: Array
    garment_triangles: NDArray[np.int32]
    garment_texture: NDArray[np.uint8]
    width: int
    height: int
    focal: tuple[float, float]
    light: tuple[float, float, float]
    ambient: float
    diffuse: float


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture's state. joints: name -> position; vertices: (n, 3) in the base frame, None while no garment
    lies there; T_base_camera: (4, 4), OpenCV axes."""

    joints: dict[str, float]
    vertices: Array | None
    T_base_camera: Array


@dataclass(frozen=True, eq=False)
class Picture:
    """rgb: (h, w, 3) uint8; depth: (h, w) float32 along the optical axis, NaN where nothing was hit [m]."""

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]


class _Stage:
    """The scene, loaded."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self._scene = scene
        self._client = pb.connect(pb.DIRECT)
        pb.resetSimulation(pb.RESET_USE_DEFORMABLE_WORLD, physicsClientId=self._client)
        pb.setTimeStep(STEP, physicsClientId=self._client)
        pb.setGravity(0, 0, 0, physicsClientId=self._client)
        self._puppet = self._load_puppet(folder)
        self._load_table(folder)
        self._robot = pb.loadURDF(
            scene.urdf, useFixedBase=True, flags=pb.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self._client
        )
        n = pb.getNumJoints(self._robot, physicsClientId=self._client)
        infos = [pb.getJointInfo(self._robot, i, physicsClientId=self._client) for i in range(n)]
        self._joints = {info[1].decode(): info[0] for info in infos}
        for link in range(-1, n):  # thinned meshes are not watertight
            pb.changeVisualShape(
                self._robot, link, flags=pb.VISUAL_SHAPE_DOUBLE_SIDED, physicsClientId=self._client
            )

    def _texture(self, path: Path, image: NDArray[np.uint8]) -> int:
        cv2.imwrite(str(path), image[..., ::-1])
        return int(pb.loadTexture(str(path), physicsClientId=self._client))

    def _load_puppet(self, folder: Path) -> int:
        scene = self._scene
        n = len(scene.garment_uv)
        flat = np.column_stack((scene.garment_uv, np.full(n, HIDDEN)))
        path = folder / "garment.obj"
        path.write_text(_obj(flat, scene.garment_uv, scene.garment_triangles))
        puppet = pb.loadSoftBody(
            str(path), useMassSpring=0, useFaceContact=0, useSelfCollision=0, collisionMargin=1e-4,
            physicsClientId=self._client,
        )  # fmt: skip
        pb.changeVisualShape(
            puppet, -1, rgbaColor=[1, 1, 1, 1], flags=pb.VISUAL_SHAPE_DOUBLE_SIDED,
            textureUniqueId=self._texture(folder / "fabric.png", scene.garment_texture),
            physicsClientId=self._client,
        )  # fmt: skip
        return int(puppet)

    def _load_table(self, folder: Path) -> None:
        t = self._scene.table
        (x0, x1), (y0, y1) = t.x, t.y
        floor = np.full((8, 8, 3), FLOOR_RGB, np.uint8)
        self._load_sheet(folder / "floor", ((-2.0, 4.0), (-3.0, 3.0)), FLOOR, floor)
        self._load_sheet(folder / "table", ((x0, x1), (y0, y1)), t.height, self._scene.table_texture)

    def _load_sheet(
        self,
        path: Path,
        extent: tuple[tuple[float, float], tuple[float, float]],
        z: float,
        image: NDArray[np.uint8],
    ) -> None:
        (x0, x1), (y0, y1) = extent
        corners = np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])
        uv = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
        path.with_suffix(".obj").write_text(_obj(corners, uv, np.array([(0, 1, 2), (0, 2, 3)], np.int32)))
        shape = pb.createVisualShape(
            pb.GEOM_MESH, fileName=str(path.with_suffix(".obj")), physicsClientId=self._client
        )
        body = pb.createMultiBody(0, -1, shape, physicsClientId=self._client)
        texture = self._texture(path.with_suffix(".png"), image)
        pb.changeVisualShape(
            body, -1, rgbaColor=[1, 1, 1, 1], textureUniqueId=texture, physicsClientId=self._client
        )

    def picture(self, shot: Shot) -> Picture:
        scene = self._scene
        for name, position in shot.joints.items():
            pb.resetJointState(self._robot, self._joints[name], position, 0.0, physicsClientId=self._client)
        vertices = shot.vertices
        if vertices is None:
            vertices = np.column_stack((scene.garment_uv, np.full(len(scene.garment_uv), HIDDEN)))
        pb.resetMeshData(self._puppet, vertices.tolist(), physicsClientId=self._client)
        pb.stepSimulation(physicsClientId=self._client)
        _, _, rgba, buffer, _ = pb.getCameraImage(  # the segmentation is thrown away: nobody may see it
            scene.width, scene.height, _view(shot.T_base_camera), self._projection(), renderer=pb.ER_TINY_RENDERER,
            shadow=1, lightDirection=scene.light, lightColor=(1.0, 1.0, 1.0), lightAmbientCoeff=scene.ambient,
            lightDiffuseCoeff=scene.diffuse, lightSpecularCoeff=0.0, physicsClientId=self._client,
        )  # fmt: skip
        shape = (scene.height, scene.width)
        rgb = np.asarray(rgba, np.uint8).reshape(*shape, 4)[..., :3].copy()
        z = np.asarray(buffer, np.float64).reshape(shape)
        depth = FAR * NEAR / (FAR - (FAR - NEAR) * z)
        depth[z >= 1.0] = np.nan
        return Picture(rgb, depth.astype(np.float32))

    def _projection(self) -> tuple[float, ...]:
        """TinyRenderer samples a pixel at its lower left corner: shifted by half a pixel, whole pixel
        coordinates are the pixels' centres, as everywhere else."""
        scene = self._scene
        x, y = NEAR / scene.focal[0], NEAR / scene.focal[1]
        width, height = 0.5 * scene.width, 0.5 * scene.height
        return tuple(
            pb.computeProjectionMatrix(
                (0.5 - width) * x, (0.5 + width) * x, (0.5 - height) * y, (0.5 + height) * y, NEAR, FAR
            )
        )


def _view(T_base_camera: Array) -> tuple[float, ...]:
    R, eye = T_base_camera[:3, :3], T_base_camera[:3, 3]
    return tuple(pb.computeViewMatrix(eye.tolist(), (eye + R[:, 2]).tolist(), (-R[:, 1]).tolist()))


def _obj(vertices: Array, uv: Array, triangles: NDArray[np.int32]) -> str:
    """An OBJ whose texture coordinates are numbered like its vertices: PyBullet keeps that order."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in triangle) for triangle in triangles]
    return "\n".join(lines) + "\n"


def main(descriptor: int) -> None:
    """Serve pictures over the connection until it closes: a Scene first, then Shots."""
    with Connection(descriptor) as connection, tempfile.TemporaryDirectory(prefix="foldcell-view-") as folder:
        stage: _Stage | None = None
        while True:
            try:
                message = connection.recv()
            except (EOFError, OSError):
                return
            try:
                if isinstance(message, Scene):
                    stage = _Stage(message, Path(folder))
                elif stage is not None:
                    connection.send(stage.picture(message))
            except Exception:  # the other side turns it into a camera fault
                connection.send(traceback.format_exc())


if __name__ == "__main__":
    from cell.simulation.render_server import main as serve  # so that classes unpickle under one name

    serve(int(sys.argv[1]))
