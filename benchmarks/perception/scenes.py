"""Labelled scenes: a shipped garment on the table, seen through the simulated camera, drawn from a seed.

The truth is stated in the frame that perception works in, the rectified table frame of the calibration that
the executive holds (the bracket's drawing, corrected by the picture of the empty table). How far that frame is
from the table's own is the camera's error, and stands beside it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from benchmarks.perception.fabrics import Light, draw_fabric
from benchmarks.perception.pieces import Laying, Piece, draw_piece
from cell.config.garments.garment_file import load_garment
from cell.hardware.camera import nominal_calibration
from cell.simulation.camera.camera import SimulatedCamera
from cell.simulation.camera.render_server import Picture, Scene, Shot, _Stage
from cell.simulation.garment.fabric import garment_uv, table_texture
from cell.simulation.noise import load_noise
from cell.simulation.settings import DEFAULT_TABLE
from robots.baxter.camera_mount import INTRINSICS, T_base_camera
from robots.baxter.pybullet_body import pb
from robots.depth_averaging import EXPOSURES
from robots.errors import ConfigurationError
from robots.ports import Array, CameraFrame
from skills.garments.garment import Garment
from skills.perception.rectification.camera_refinement import refine_calibration
from skills.vocabulary import CameraCalibration, Table

__all__ = ["TABLE", "LabelledScene", "Studio", "draw_scene", "open_studio"]

TABLE: Table = DEFAULT_TABLE
SURFACES = ("bare_table", "laminate", "felt")
NOBODY = (
    '<robot name="nobody"><link name="base"><inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>'
)
"""The arms are parked outside the table's picture, which is all that perception looks at: they are not drawn."""


@dataclass(frozen=True, eq=False)
class LabelledScene:
    """frame, reference: pictures with the garment and of the empty table. calibration: the executive's.

    keypoints: name -> (2,) [m], in that calibration's table frame. camera_error: median distance of the same
    points from where they are on the real table [m]. facts: look of the fabric, surface, colour difference.
    """

    garment: str
    category: str
    seed: int
    frame: CameraFrame
    reference: CameraFrame
    calibration: CameraCalibration
    keypoints: Mapping[str, Array]
    camera_error: float
    facts: Mapping[str, float | str] = field(default_factory=dict)


class Studio:
    """One scene before the renderer: `shoot` takes pictures of it with the camera as it is really mounted."""

    def __init__(self, uv: Array, triangles: Array, seed: int, folder: Path) -> None:
        rng = np.random.default_rng([seed, 7])
        self._noise = load_noise().camera
        self.surface = str(rng.choice(SURFACES, p=(0.6, 0.2, 0.2)))
        table = table_texture(rng, self.surface)
        fabric, self.look, self.colour_difference = draw_fabric(rng, self.surface, table)
        swing = self._noise.light_swing
        urdf = folder / "nobody.urdf"
        urdf.write_text(NOBODY)
        self._stage = _Stage(
            Scene(
                urdf=str(urdf), table=TABLE, table_texture=table, garment_uv=uv, garment_triangles=triangles,
                garment_texture=fabric, width=INTRINSICS.width, height=INTRINSICS.height,
                focal=(INTRINSICS.fx, INTRINSICS.fy), centre=(INTRINSICS.cx, INTRINSICS.cy),
                light=(*(float(a) for a in rng.uniform(-swing, swing, 2)), 2.5),
                ambient=float(rng.uniform(0.52, 0.62)), diffuse=float(rng.uniform(0.32, 0.42)),
            ),
            folder,
        )  # fmt: skip
        self.light = Light.draw(rng)
        self.T_base_camera = _mounted(self._noise.pose_position, self._noise.pose_angle, rng)
        self._vertices: Array | None = None
        self._time = 0.0
        self._camera = SimulatedCamera(
            self, INTRINSICS, self._noise, int(rng.integers(2**31)), self._shot, lambda: self._time
        )

    def close(self) -> None:
        pb.disconnect(physicsClientId=self._stage._client)

    def shoot(self, vertices: Array | None) -> CameraFrame:
        """A picture of the garment's vertices (n, 3), table frame; None: of the empty table."""
        self._vertices, self._time = vertices, self._time + 1.0
        return self._camera.capture(EXPOSURES)

    def picture(self, shot: Shot) -> Picture:
        """For the camera: what the renderer gives, in this scene's light."""
        plain = self._stage.picture(shot)
        return Picture(self.light.on(plain.rgb, shaded=shot.vertices is not None), plain.depth)

    def _shot(self) -> Shot:
        above = None if self._vertices is None else self._vertices + np.array([0.0, 0.0, TABLE.height])
        return Shot({}, above, self.T_base_camera)

    @property
    def T_table_camera(self) -> Array:
        return np.linalg.inv(TABLE.T_base_table) @ self.T_base_camera


@contextmanager
def open_studio(uv: Array, triangles: Array, seed: int) -> Iterator[Studio]:
    with tempfile.TemporaryDirectory(prefix="foldcell-scene-") as folder:
        studio = Studio(uv, triangles, seed, Path(folder))
        try:
            yield studio
        finally:
            studio.close()


def draw_scene(garment_name: str, seed: int, laying: Laying | None = None) -> LabelledScene:
    """A garment as it is laid before the first fold. Everything is a function of name, seed and laying."""
    garment = load_garment(garment_name)
    piece = _visible(garment, seed, laying)
    uv = garment_uv(piece.mesh.rest, piece.mesh.layer)
    with open_studio(uv, piece.mesh.triangles, seed) as studio:
        reference = studio.shoot(None)
        frame = studio.shoot(piece.vertices)
        drawn = nominal_calibration(TABLE)
        refined = refine_calibration(reference, drawn, TABLE)
        held = refined.value or drawn
        seen = {name: _where_seen(p, studio.T_table_camera, held) for name, p in piece.keypoints.items()}
        errors = [float(np.linalg.norm(seen[name] - p[:2])) for name, p in piece.keypoints.items()]
        return LabelledScene(
            garment_name, garment.category, seed, frame, reference, held, seen, float(np.median(errors)),
            {"look": studio.look, "surface": studio.surface, "colour_difference": studio.colour_difference,
             "shade": studio.light.shade},
        )  # fmt: skip


def _visible(garment: Garment, seed: int, laying: Laying | None) -> Piece:
    """A piece that lies in the picture and on the table, and whose legs do not cross."""
    for attempt in range(50):
        with suppress(ConfigurationError):
            piece = draw_piece(garment, np.random.default_rng([seed, attempt]), laying)
            if _in_view(piece):
                return piece
    raise RuntimeError(f"no pose of {garment} is in view")


def _in_view(piece: Piece, margin: float = 12.0) -> bool:
    x = piece.vertices
    T = np.linalg.inv(nominal_calibration(TABLE).T_table_camera)
    uv = _project(x, T)
    inside = (uv > margin).all() and (uv < np.array([INTRINSICS.width, INTRINSICS.height]) - margin).all()
    low, high = np.array([TABLE.x[0], TABLE.y[0]]) + 0.02, np.array([TABLE.x[1], TABLE.y[1]]) - 0.02
    return bool(inside and (x[:, :2] > low).all() and (x[:, :2] < high).all())


def _project(x: Array, T_camera_table: Array) -> Array:
    k = INTRINSICS
    c = x @ T_camera_table[:3, :3].T + T_camera_table[:3, 3]
    return c[..., :2] / c[..., 2:] * (k.fx, k.fy) + (k.cx, k.cy)


def _where_seen(point: Array, T_table_camera: Array, held: CameraCalibration) -> Array:
    """(2,) where the held calibration says that a point (3,) lies, if it is told the point's height."""
    u, v = _project(point, np.linalg.inv(T_table_camera))
    k, T = held.intrinsics, held.T_table_camera
    ray = T[:3, :3] @ np.array([(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0])
    return np.asarray(T[:2, 3] + ray[:2] * (point[2] - T[2, 3]) / ray[2])


def _mounted(position: float, angle: float, rng: np.random.Generator) -> Array:
    """(4, 4) the camera in the base frame, as somebody really screwed it on."""
    T = np.array(T_base_camera(0.0))
    turn, _ = cv2.Rodrigues(rng.standard_normal(3) * angle)
    T[:3, :3] = T[:3, :3] @ turn
    T[:3, 3] += rng.standard_normal(3) * position
    return T
