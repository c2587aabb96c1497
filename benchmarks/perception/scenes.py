"""Draws labelled scenes: a shipped garment on the table, seen through the simulated camera.

The true key points are given in the frame in which perception reports them: the table frame according to the
executive's calibration (the bracket's drawing, corrected by the picture of the empty table). The deviation of this
frame from the true table frame is the camera's error. Each scene states this error separately.
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
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.camera import nominal_calibration
from foldcell.cell.simulation.camera.camera import SimulatedCamera
from foldcell.cell.simulation.camera.render_server import Picture, Scene, Shot, _Stage
from foldcell.cell.simulation.garment.fabric import garment_uv, table_texture
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.settings import DEFAULT_TABLE
from foldcell.robots.baxter.robot import FLOOR, MOUNT
from foldcell.robots.bullet import pb
from foldcell.robots.depth_averaging import EXPOSURES
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.rectification.camera_refinement import refine_calibration
from foldcell.skills.vocabulary import CameraCalibration, Table

TABLE: Table = DEFAULT_TABLE
SURFACES = ("bare_table", "laminate", "felt")
INTRINSICS = MOUNT.intrinsics
NOBODY = (
    '<robot name="nobody"><link name="base"><inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>'
)
"""A robot without visible parts. Parked arms would not be visible in the part of the picture that shows the table,
and perception uses only this part."""


@dataclass(frozen=True, eq=False)
class LabelledScene:
    """A scene with its true key points. frame, reference: pictures with the garment and of the empty table.
    calibration: the one that the executive has.

    keypoints: name -> (2,) [m], in the table frame of this calibration. camera_error: median distance of these
    points from their true places in the true table frame [m]. facts: appearance of the fabric, surface, colour
    difference, shade.
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
    """One scene with its renderer. `shoot` takes pictures with the camera at its true pose."""

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
                urdf=str(urdf), floor=FLOOR, table=TABLE, table_texture=table,
                garment_uv=uv, garment_triangles=triangles,
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
        """Take a picture of the garment with vertices (n, 3), table frame, or of the empty table if None."""
        self._vertices, self._time = vertices, self._time + 1.0
        return self._camera.capture(EXPOSURES)

    def picture(self, shot: Shot) -> Picture:
        """Return the renderer's picture in this scene's light. The simulated camera calls it."""
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
    """Draw a scene with a garment as laid before the first fold. Name, seed and laying determine the scene."""
    garment = load_garment(garment_name)
    piece = _visible(garment, seed, laying)
    uv = garment_uv(piece.mesh.rest, piece.mesh.layer)
    with open_studio(uv, piece.mesh.triangles, seed) as studio:
        reference = studio.shoot(None)
        frame = studio.shoot(piece.vertices)
        drawn = nominal_calibration(MOUNT, TABLE)
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
    """Draw a piece that lies within the picture and on the table, and whose legs do not cross."""
    for attempt in range(50):
        with suppress(ConfigurationError):
            piece = draw_piece(garment, np.random.default_rng([seed, attempt]), laying)
            if _in_view(piece):
                return piece
    raise RuntimeError(f"no pose of {garment} is in view")


def _in_view(piece: Piece, margin: float = 12.0) -> bool:
    x = piece.vertices
    T = np.linalg.inv(nominal_calibration(MOUNT, TABLE).T_table_camera)
    uv = _project(x, T)
    inside = (uv > margin).all() and (uv < np.array([INTRINSICS.width, INTRINSICS.height]) - margin).all()
    low, high = np.array([TABLE.x[0], TABLE.y[0]]) + 0.02, np.array([TABLE.x[1], TABLE.y[1]]) - 0.02
    return bool(inside and (x[:, :2] > low).all() and (x[:, :2] < high).all())


def _project(x: Array, T_camera_table: Array) -> Array:
    k = INTRINSICS
    c = x @ T_camera_table[:3, :3].T + T_camera_table[:3, 3]
    return c[..., :2] / c[..., 2:] * (k.fx, k.fy) + (k.cx, k.cy)


def _where_seen(point: Array, T_table_camera: Array, held: CameraCalibration) -> Array:
    """Compute the place (2,) [m] at which a true point (3,) [m] appears if the picture is evaluated with the
    calibration `held` and the point's true height."""
    u, v = _project(point, np.linalg.inv(T_table_camera))
    k, T = held.intrinsics, held.T_table_camera
    ray = T[:3, :3] @ np.array([(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0])
    return np.asarray(T[:2, 3] + ray[:2] * (point[2] - T[2, 3]) / ray[2])


def _mounted(position: float, angle: float, rng: np.random.Generator) -> Array:
    """Draw the true pose (4, 4) of the camera in the base frame: the nominal pose with a mounting error."""
    T = np.array(MOUNT.T_base_camera(0.0))
    turn, _ = cv2.Rodrigues(rng.standard_normal(3) * angle)
    T[:3, :3] = T[:3, :3] @ turn
    T[:3, 3] += rng.standard_normal(3) * position
    return T
