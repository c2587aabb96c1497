"""Draws the simulated cell for a person, in a tenth of the time that the render process needs.

The picture has the same camera, robot, garment, table and textures as the pictures that the cell itself gets
(cell/simulation/camera/render_server.py), but no shadows. The table and the floor are drawn once, because they do
not move.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

from cell.report.pictures.cloth_raster import vertex_normals
from cell.simulation.camera.mesh_raster import Canvas, Lens, Mesh, draw_mesh
from cell.simulation.camera.render_server import FLOOR_RGB, NEAR, Picture, Scene, Shot
from skills.vocabulary import Array

__all__ = ["DisplayDrawing"]

SAME_POSE = 1e-4
"""Table and floor are drawn again if an element of the camera's pose (4, 4) has changed by more than this."""


class DisplayDrawing:
    """Draws the shots of one scene. The robot is loaded for the first picture. Use it on one thread at a time."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._robot: _Robot | None = None
        self._bare: tuple[Array, Canvas] | None = None
        height, width = scene.garment_texture.shape[:2]
        # copies, because numba compiles once more for arrays that are read-only
        self._triangles, self._texture = np.array(scene.garment_triangles), np.array(scene.garment_texture)
        self._texels = (scene.garment_uv * [1.0, -1.0] + [0.0, 1.0]) * [width - 1, height - 1]
        self._light = np.asarray(scene.light) / np.linalg.norm(scene.light)
        self._lens = Lens(scene.focal, scene.centre, NEAR, scene.ambient, scene.diffuse)

    def picture(self, shot: Shot) -> Picture:
        """Draw a shot. The calibration board is not drawn."""
        self._robot = self._robot or _Robot(self._scene.urdf)
        canvas = self._table(shot.T_base_camera).copy()
        T_camera_base = np.asarray(np.linalg.inv(shot.T_base_camera), np.float64)
        light = T_camera_base[:3, :3] @ self._light
        if shot.vertices is not None:
            draw_mesh(canvas, self._garment(shot.vertices), T_camera_base[None], self._lens, light)
        draw_mesh(canvas, self._robot.mesh, T_camera_base @ self._robot.poses(shot.joints), self._lens, light)
        return Picture(canvas.rgb, np.float32(1.0) / canvas.nearest)

    def _garment(self, vertices: Array) -> Mesh:
        normals, body = vertex_normals(vertices, self._triangles), np.zeros(len(vertices), np.int32)
        return Mesh(np.array(vertices), normals, body, self._triangles, self._texels, self._texture)

    def _table(self, T_base_camera: Array) -> Canvas:
        if self._bare is None or np.abs(self._bare[0] - T_base_camera).max() > SAME_POSE:
            self._bare = T_base_camera, self._draw_table(T_base_camera)
        return self._bare[1]

    def _draw_table(self, T_base_camera: Array) -> Canvas:
        """Draw the table and the floor: each pixel shows the point that its ray meets first."""
        scene, table, eye = self._scene, self._scene.table, T_base_camera[:3, 3]
        v, u = np.mgrid[0 : scene.height, 0 : scene.width]
        pixels = np.stack([u, v], axis=-1)
        rays = np.concatenate([(pixels - scene.centre) / scene.focal, np.ones((*u.shape, 1))], axis=-1)
        rays = rays @ T_base_camera[:3, :3].T
        down = np.minimum(rays[..., 2], -1e-3)  # a ray above the horizon ends far away on the floor
        depth = (table.height - eye[2]) / down
        low, high = np.transpose([table.x, table.y])
        share = (eye[:2] + depth[..., None] * rays[..., :2] - low) / (high - low)
        on_table = np.all((share >= 0.0) & (share <= 1.0), axis=-1) & (depth > 0.0)
        height, width = scene.table_texture.shape[:2]
        texels = np.clip((share * [1.0, -1.0] + [0.0, 1.0]) * [width, height], 0, [width - 1, height - 1]).astype(
            int
        )
        light = min(scene.ambient + scene.diffuse * self._light[2], 1.0)
        rgb = np.where(on_table[..., None], scene.table_texture[texels[..., 1], texels[..., 0]], FLOOR_RGB) * light
        return Canvas(
            rgb.astype(np.uint8),
            (1.0 / np.where(on_table, depth, (scene.floor - eye[2]) / down)).astype(np.float32),
        )


class _Robot:
    """The robot's visible links, from its URDF. mesh: each link is a body with one colour."""

    def __init__(self, urdf: str) -> None:
        self._model = pin.buildModelFromUrdf(urdf)
        self._data = self._model.createData()
        self._visuals = list(pin.buildGeomFromUrdf(self._model, urdf, pin.GeometryType.VISUAL).geometryObjects)
        self.mesh = _merged(self._visuals)

    def poses(self, joints: dict[str, float]) -> Array:
        """Return the poses (k, 4, 4) of the links in the base frame. joints: name -> position."""
        q = pin.neutral(self._model)
        for name, value in joints.items():
            joint = self._model.joints[self._model.getJointId(name)]
            # a joint without limits has its cosine and sine
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        pin.forwardKinematics(self._model, self._data, q)
        return np.array([(self._data.oMi[v.parentJoint] * v.placement).homogeneous for v in self._visuals])


def _merged(visuals: Sequence[pin.GeometryObject]) -> Mesh:
    meshes = [_mesh(visual.geometry, np.asarray(visual.meshScale)) for visual in visuals]
    counts = [len(vertices) for vertices, _ in meshes]
    body = np.repeat(np.arange(len(meshes), dtype=np.int32), counts)
    starts = np.cumsum([0, *counts[:-1]])
    colours = np.array([visual.meshColor[:3] for visual in visuals])
    return Mesh(
        np.vstack([vertices for vertices, _ in meshes]),
        np.vstack([vertex_normals(*mesh) for mesh in meshes]),
        body,
        np.vstack([triangles + start for (_, triangles), start in zip(meshes, starts, strict=True)]).astype(
            np.int32
        ),
        np.column_stack([body, np.zeros(len(body))]),  # one texel for each body
        np.rint(255.0 * colours[None]).astype(np.uint8),
    )


def _mesh(shape: coal.CollisionGeometry, scale: Array) -> tuple[Array, NDArray[np.int32]]:
    """Return the vertices (n, 3) and triangles (m, 3) of a shape in a URDF."""
    if isinstance(shape, coal.BVHModelBase):
        corners = [shape.tri_indices(k) for k in range(shape.num_tris)]
        return np.array(shape.vertices()) * scale, np.array([(c[0], c[1], c[2]) for c in corners], np.int32)
    if isinstance(shape, coal.Box):
        solid = trimesh.creation.box(2.0 * np.array(shape.halfSide))
    elif isinstance(shape, coal.Cylinder):
        solid = trimesh.creation.cylinder(shape.radius, 2.0 * shape.halfLength)
    else:
        solid = trimesh.creation.icosphere(radius=shape.radius)
    solid.unmerge_vertices()  # its edges are sharp
    return np.array(solid.vertices), np.array(solid.faces, np.int32)
