"""The renderer's own process: a PyBullet world that only exists to be looked at.

PyBullet's TinyRenderer leaks and may crash; here it can do both without taking the cell along. The garment
is a puppet: a soft body without physics whose vertices are set before each picture. One step of a
microsecond is needed after that, or the camera shows the old shape. Run by `cell.simulation.camera.camera`:

    python -m cell.simulation.camera.render_server FD
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
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from robots.baxter.suppress_output import suppress_output
from skills.vocabulary import Array, Table

with suppress_output():  # it prints when it was built
    import pybullet as pb

__all__ = ["Picture", "Scene", "Shot", "main"]

FAR, NEAR = 4.0, 0.25  # of the view [m]
STEP = 1e-6  # [s]
HIDDEN = -5.0  # where the puppet waits until the garment is laid, below the floor [m]
FLOOR = -0.924  # of the base frame [m]
FLOOR_RGB = (112, 114, 118)
FINE = 2
"""Samples a pixel, along each side, of a picture with the board: its corners are found to a tenth of a pixel."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What is in the picture. Textures: (h, w, 3) RGB. garment: vertices (n, 3), texture coordinates (n, 2)
    and triangles (m, 3) of its mesh. focal, centre: of the camera [px]. light: where it comes from; ambient,
    diffuse: its coefficients."""

    urdf: str
    table: Table
    table_texture: NDArray[np.uint8]
    garment_uv: Array
    garment_triangles: NDArray[np.int32]
    garment_texture: NDArray[np.uint8]
    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    light: tuple[float, float, float]
    ambient: float
    diffuse: float
    board: tuple[NDArray[np.uint8], tuple[float, float]] | None = None
    """The calibration board's picture (h, w, 3), and its width and height [m]."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture's state. joints: name -> position; vertices: (n, 3) in the base frame, None while no garment
    lies there; T_base_camera: (4, 4), OpenCV axes; T_base_board: (4, 4), None while there is no board."""

    joints: dict[str, float]
    vertices: Array | None
    T_base_camera: Array
    T_base_board: Array | None = None


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
        self._board = self._load_board(folder)
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
        scattered = HIDDEN - 1e-3 * np.modf(0.618034 * np.arange(n))[0]
        start = np.column_stack((scene.garment_uv, scattered))
        path = folder / "garment.obj"
        path.write_text(_obj(start, scene.garment_uv, leading(scene.garment_triangles, n), upright=True))
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

    def _load_board(self, folder: Path) -> int | None:
        """A card about its own middle, its front towards -z, x and y along the picture's rows and columns."""
        if self._scene.board is None:
            return None
        image, (w, h) = self._scene.board
        corners = np.array([(-w, h, 0.0), (w, h, 0.0), (w, -h, 0.0), (-w, -h, 0.0)]) / 2
        uv = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
        return self._load_quad(folder / "board", corners, uv, image)

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
        self._load_quad(path, corners, uv, image)

    def _load_quad(self, path: Path, corners: Array, uv: Array, image: NDArray[np.uint8]) -> int:
        path.with_suffix(".obj").write_text(_obj(corners, uv, np.array([(0, 1, 2), (0, 2, 3)], np.int32)))
        shape = pb.createVisualShape(
            pb.GEOM_MESH, fileName=str(path.with_suffix(".obj")), physicsClientId=self._client
        )
        body = pb.createMultiBody(0, -1, shape, physicsClientId=self._client)
        texture = self._texture(path.with_suffix(".png"), image)
        pb.changeVisualShape(
            body, -1, rgbaColor=[1, 1, 1, 1], textureUniqueId=texture, physicsClientId=self._client
        )
        return int(body)

    def _place_board(self, T: Array | None) -> None:
        if self._board is None:
            return
        if T is None:
            T = np.eye(4)
            T[2, 3] = HIDDEN
        turn = pb.getQuaternionFromAxisAngle(*_axis_angle(T[:3, :3]))
        pb.resetBasePositionAndOrientation(self._board, T[:3, 3].tolist(), turn, physicsClientId=self._client)

    def picture(self, shot: Shot) -> Picture:
        scene = self._scene
        for name, position in shot.joints.items():
            pb.resetJointState(self._robot, self._joints[name], position, 0.0, physicsClientId=self._client)
        vertices = shot.vertices
        if vertices is None:
            vertices = np.column_stack((scene.garment_uv, np.full(len(scene.garment_uv), HIDDEN)))
        self._place_board(shot.T_base_board)
        pb.resetMeshData(self._puppet, vertices.tolist(), physicsClientId=self._client)
        pb.stepSimulation(physicsClientId=self._client)
        n = 1 if shot.T_base_board is None else FINE
        shape = (n * scene.height, n * scene.width)
        _, _, rgba, buffer, _ = pb.getCameraImage(  # the segmentation is thrown away: nobody may see it
            shape[1], shape[0], _view(shot.T_base_camera), self._projection(n), renderer=pb.ER_TINY_RENDERER,
            shadow=1, lightDirection=scene.light, lightColor=(1.0, 1.0, 1.0), lightAmbientCoeff=scene.ambient,
            lightDiffuseCoeff=scene.diffuse, lightSpecularCoeff=0.0, physicsClientId=self._client,
        )  # fmt: skip
        rgb = np.asarray(rgba, np.uint8).reshape(*shape, 4)[..., :3].copy()
        if n > 1:
            rgb = np.asarray(cv2.resize(rgb, (scene.width, scene.height), interpolation=cv2.INTER_AREA), np.uint8)
        z = np.asarray(buffer, np.float64).reshape(shape)[n // 2 :: n, n // 2 :: n]
        depth = FAR * NEAR / (FAR - (FAR - NEAR) * z)
        depth[z >= 1.0] = np.nan
        return Picture(rgb, depth.astype(np.float32))

    def _projection(self, n: int) -> tuple[float, ...]:
        """TinyRenderer samples a pixel at its lower left corner: shifted by half a pixel, whole pixel
        coordinates are the pixels' centres, as everywhere else. n: samples a pixel, along each side."""
        scene = self._scene
        x, y = NEAR / scene.focal[0], NEAR / scene.focal[1]
        shift = 0.5 - 0.5 / n  # the samples of a pixel lie about its centre
        left, bottom = -scene.centre[0] - shift, scene.centre[1] + 1.0 - scene.height - shift
        right, top = left + scene.width, bottom + scene.height
        return tuple(pb.computeProjectionMatrix(left * x, right * x, bottom * y, top * y, NEAR, FAR))


def leading(triangles: NDArray[np.int32], n: int) -> NDArray[np.int32]:
    """The triangles (m, 3), each turned about so that every one of the n vertices comes first in one of them.

    PyBullet ties what it draws to the face in which a vertex lies when the mesh is loaded. Rounding may deny a
    vertex its own faces, except one that begins with it; then another sheet's face that happens to lie over it
    would carry it away. (For the same reason no two faces may lie in one plane then.)
    """
    m = np.arange(len(triangles))
    touches = csr_matrix((np.ones(3 * len(m)), (triangles.T.ravel(), np.tile(m, 3))), shape=(n, len(m)))
    face = maximum_bipartite_matching(touches, perm_type="column")
    vertex = np.flatnonzero(face >= 0)
    first = np.zeros(len(m), np.intp)
    first[face[vertex]] = np.argmax(triangles[face[vertex]] == vertex[:, None], axis=1)
    turned: NDArray[np.int32] = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    return turned


def _axis_angle(R: Array) -> tuple[list[float], float]:
    w = cv2.Rodrigues(R)[0].reshape(3)
    angle = float(np.linalg.norm(w))
    return (w / angle if angle > 1e-12 else np.array([0.0, 0.0, 1.0])).tolist(), angle


def _view(T_base_camera: Array) -> tuple[float, ...]:
    R, eye = T_base_camera[:3, :3], T_base_camera[:3, 3]
    return tuple(pb.computeViewMatrix(eye.tolist(), (eye + R[:, 2]).tolist(), (-R[:, 1]).tolist()))


def _obj(vertices: Array, uv: Array, triangles: NDArray[np.int32], upright: bool = False) -> str:
    """An OBJ whose texture coordinates are numbered like its vertices: PyBullet keeps that order.

    upright: lit everywhere as if it lay flat. PyBullet keeps a soft body's normals as they were loaded.
    """
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    lines += ["vn 0 0 1"] if upright else []
    normal = "/1" if upright else ""
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}{normal}" for k in triangle) for triangle in triangles]
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
    from cell.simulation.camera.render_server import main as serve  # so that classes unpickle under one name

    serve(int(sys.argv[1]))
