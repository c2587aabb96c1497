"""The render process: a PyBullet world that is used for pictures only.

PyBullet's TinyRenderer leaks memory and may crash. In a separate process this does not affect the cell. The
garment is a body without physics that is made anew for each picture. A soft body could change its shape, but
PyBullet takes up to half a minute to load one. `foldcell.cell.simulation.camera.camera` starts the process with

    python -m foldcell.cell.simulation.camera.render_server FD
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

from foldcell.robots.bullet import pb
from foldcell.skills.vocabulary import Array, Table

FAR, NEAR = 4.0, 0.25  # clipping planes [m]
HIDDEN = -5.0  # height of the hidden board, below the floor [m]
FLOOR_RGB = (112, 114, 118)
FINE = 2
"""Samples along each side of a pixel in pictures with the board. One sample would not be enough, because the
board's corners are located to a tenth of a pixel."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The fixed content of the pictures. urdf: the robot. floor: its height in the base frame [m]. Textures:
    (h, w, 3) RGB. garment_uv, garment_triangles: texture coordinates (n, 2) and triangles (m, 3) of the garment's
    mesh. width, height, focal, centre: properties of the camera [px]. light: direction to the light; ambient,
    diffuse: coefficients of the light."""

    urdf: str
    floor: float
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
    """Picture (h, w, 3) of the calibration board, and its width and height [m]."""


@dataclass(frozen=True, eq=False)
class Shot:
    """The state of the world for one picture. joints: name -> position; vertices: (n, 3) in the base frame, None
    without a garment; T_base_camera: (4, 4), OpenCV axes; T_base_board: (4, 4), None without a board."""

    joints: dict[str, float]
    vertices: Array | None
    T_base_camera: Array
    T_base_board: Array | None = None

    def same_as(self, other: Shot) -> bool:
        """Whether the other shot has the same picture, because all numbers are equal."""
        arrays = ((s.vertices, s.T_base_camera, s.T_base_board) for s in (self, other))
        return self.joints == other.joints and all(map(np.array_equal, *arrays))


@dataclass(frozen=True, eq=False)
class Picture:
    """rgb: (h, w, 3) uint8; depth: (h, w) float32 along the optical axis [m], NaN where nothing was hit."""

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]


class _Stage:
    """The scene, loaded into PyBullet."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self._scene = scene
        self._client = pb.connect(pb.DIRECT)
        self._garment: int | None = None
        self._fabric = self._texture(folder / "fabric.png", scene.garment_texture)
        self._uv = np.round(scene.garment_uv, 6).tolist()
        self._both_sides = (
            np.stack((scene.garment_triangles, scene.garment_triangles[:, ::-1]), 1).ravel().tolist()
        )
        self._board = self._load_board(folder)
        self._robot = pb.loadURDF(
            scene.urdf, useFixedBase=True, flags=pb.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self._client
        )
        n = pb.getNumJoints(self._robot, physicsClientId=self._client)
        infos = [pb.getJointInfo(self._robot, i, physicsClientId=self._client) for i in range(n)]
        self._joints = {info[1].decode(): info[0] for info in infos}
        for link in range(-1, n):  # draw both sides: decimated meshes are not watertight
            pb.changeVisualShape(
                self._robot, link, flags=pb.VISUAL_SHAPE_DOUBLE_SIDED, physicsClientId=self._client
            )
        # after the robot, the floor last: what is drawn later is not shaded where something nearer hides it
        self._load_table(folder)

    def _texture(self, path: Path, image: NDArray[np.uint8]) -> int:
        cv2.imwrite(str(path), image[..., ::-1])
        return int(pb.loadTexture(str(path), physicsClientId=self._client))

    def _show_garment(self, vertices: Array | None) -> None:
        """Replace the garment's body. PyBullet draws one side of a triangle, so each is there twice. vertices:
        (n, 3) in the base frame; None: no garment."""
        if self._garment is not None:
            pb.removeBody(self._garment, physicsClientId=self._client)
            self._garment = None
        if vertices is None:
            return
        shape = pb.createVisualShape(
            pb.GEOM_MESH, vertices=vertices.tolist(), indices=self._both_sides, uvs=self._uv,
            normals=[(0.0, 0.0, 1.0)] * len(vertices), physicsClientId=self._client,
        )  # fmt: skip
        self._garment = int(pb.createMultiBody(0, -1, shape, physicsClientId=self._client))
        pb.changeVisualShape(
            self._garment, -1, rgbaColor=[1, 1, 1, 1], textureUniqueId=self._fabric, physicsClientId=self._client
        )

    def _load_table(self, folder: Path) -> None:
        table, floor = self._scene.table, np.full((8, 8, 3), FLOOR_RGB, np.uint8)
        for name, (x0, x1), (y0, y1), z, image in (
            ("table", table.x, table.y, table.height, self._scene.table_texture),
            ("floor", (-2.0, 4.0), (-3.0, 3.0), self._scene.floor, floor),
        ):
            self._load_quad(folder / name, np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]), image)

    def _load_board(self, folder: Path) -> int | None:
        """Load the board as a card centred at the origin. Its front faces -z; x and y run along the picture's rows
        and columns."""
        if self._scene.board is None:
            return None
        image, (w, h) = self._scene.board
        corners = np.array([(-w, h, 0.0), (w, h, 0.0), (w, -h, 0.0), (-w, -h, 0.0)]) / 2
        return self._load_quad(folder / "board", corners, image)

    def _load_quad(self, path: Path, corners: Array, image: NDArray[np.uint8]) -> int:
        """Load a sheet with a picture on it. corners: (4, 3), those of the picture from (0, 0) on."""
        path.with_suffix(".obj").write_text(_obj(corners))
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
        self._show_garment(shot.vertices)
        self._place_board(shot.T_base_board)
        n = 1 if shot.T_base_board is None else FINE
        shape = (n * scene.height, n * scene.width)
        _, _, rgba, buffer, _ = pb.getCameraImage(  # discard the segmentation: no skill may use it
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
        """Return the projection matrix, shifted by half a pixel. The shift is needed because TinyRenderer samples
        a pixel at its lower left corner, but everywhere else integer coordinates mean pixel centres. n: samples
        along each side of a pixel."""
        scene = self._scene
        x, y = NEAR / scene.focal[0], NEAR / scene.focal[1]
        shift = 0.5 - 0.5 / n  # the samples of a pixel are symmetric about its centre
        left, bottom = -scene.centre[0] - shift, scene.centre[1] + 1.0 - scene.height - shift
        right, top = left + scene.width, bottom + scene.height
        return tuple(pb.computeProjectionMatrix(left * x, right * x, bottom * y, top * y, NEAR, FAR))


def _axis_angle(R: Array) -> tuple[list[float], float]:
    w = cv2.Rodrigues(R)[0].reshape(3)
    angle = float(np.linalg.norm(w))
    return (w / angle if angle > 1e-12 else np.array([0.0, 0.0, 1.0])).tolist(), angle


def _view(T_base_camera: Array) -> tuple[float, ...]:
    R, eye = T_base_camera[:3, :3], T_base_camera[:3, 3]
    return tuple(pb.computeViewMatrix(eye.tolist(), (eye + R[:, 2]).tolist(), (-R[:, 1]).tolist()))


def _obj(corners: Array) -> str:
    """Return an OBJ file of a quadrangle (4, 3) whose corners are those of its texture."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
    lines += [f"vt {u} {v}" for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return "\n".join([*lines, "f 1/1 2/2 3/3", "f 1/1 3/3 4/4"]) + "\n"


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
            except Exception:  # the client reports it as a camera fault
                connection.send(traceback.format_exc())


if __name__ == "__main__":
    from foldcell.cell.simulation.camera.render_server import (
        main as serve,  # so that pickled classes have one module name
    )

    serve(int(sys.argv[1]))
