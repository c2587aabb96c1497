"""Draws the simulated cell for a person, in a tenth of the time that the render process needs.

The picture has the same camera, robot, garment, table and textures as the pictures that the cell itself gets
(cell/simulation/camera/render_server.py), but no shadows. The table and the floor are drawn once, because they do
not move.
"""

from __future__ import annotations

import numpy as np

from foldcell.cell.report.pictures.bare_cell import Surroundings, robot_mesh
from foldcell.cell.report.pictures.mesh_raster import Canvas, Lens, Mesh, draw_mesh
from foldcell.cell.simulation.camera.render_server import FLOOR_RGB, NEAR, Picture, Scene, Shot
from foldcell.skills.fold_figures.drawn_mesh import vertex_normals
from foldcell.skills.vocabulary import Array

SAME_POSE = 1e-4
"""Table and floor are drawn again if an element of the camera's pose (4, 4) has changed by more than this."""


class DisplayDrawing:
    """Draws the shots of one scene. The robot is loaded for the first picture. Use it on one thread at a time."""

    def __init__(self, scene: Scene) -> None:
        self._urdf = scene.urdf
        self._bare: tuple[Array, Canvas] | None = None
        height, width = scene.garment_texture.shape[:2]
        # copies, because numba compiles once more for arrays that are read-only
        self._triangles, self._texture = np.array(scene.garment_triangles), np.array(scene.garment_texture)
        self._texels = (scene.garment_uv * [1.0, -1.0] + [0.0, 1.0]) * [width - 1, height - 1]
        light = np.asarray(scene.light) / np.linalg.norm(scene.light)
        lens = Lens(scene.focal, scene.centre, NEAR, scene.ambient, scene.diffuse)
        size = scene.height, scene.width
        self._surroundings = Surroundings(
            scene.table, scene.table_texture, scene.floor, FLOOR_RGB, size, lens, light
        )

    def picture(self, shot: Shot) -> Picture:
        """Draw a shot. The calibration board is not drawn."""
        canvas, lens = self._table(shot.T_base_camera).copy(), self._surroundings.lens
        T_camera_base = np.asarray(np.linalg.inv(shot.T_base_camera), np.float64)
        light = T_camera_base[:3, :3] @ self._surroundings.light
        if shot.vertices is not None:
            draw_mesh(canvas, self._garment(shot.vertices), T_camera_base[None], lens, light)
        robot_mesh(self._urdf).draw(canvas, T_camera_base, shot.joints, lens, light)
        return Picture(canvas.rgb, np.float32(1.0) / canvas.nearest)

    def _garment(self, vertices: Array) -> Mesh:
        normals, body = vertex_normals(vertices, self._triangles), np.zeros(len(vertices), np.int32)
        return Mesh(np.array(vertices), normals, body, self._triangles, self._texels, self._texture)

    def _table(self, T_base_camera: Array) -> Canvas:
        if self._bare is None or np.abs(self._bare[0] - T_base_camera).max() > SAME_POSE:
            self._bare = T_base_camera, self._surroundings.draw(T_base_camera)
        return self._bare[1]
