"""Draws the robot, its table and the floor as a camera sees them, without shadows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

from foldcell.cell.report.pictures.mesh_raster import Canvas, Lens, Mesh, draw_mesh
from foldcell.robots.ports import Array
from foldcell.skills.fold_figures.drawn_mesh import vertex_normals
from foldcell.skills.vocabulary import Table


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Table and floor. texture: (h, w, 3) RGB of the table; floor: its height in the base frame [m]; floor_rgb:
    its colour; size: height and width of the picture [px]; light: (3,) unit vector to the light, in the base
    frame."""

    table: Table
    texture: NDArray[np.uint8]
    floor: float
    floor_rgb: tuple[int, int, int]
    size: tuple[int, int]
    lens: Lens
    light: Array

    def draw(self, T_base_camera: Array) -> Canvas:
        """Draw them: each pixel shows the point that its ray meets first."""
        table, eye, lens = self.table, T_base_camera[:3, 3], self.lens
        v, u = np.mgrid[0 : self.size[0], 0 : self.size[1]]
        pixels = np.stack([u, v], axis=-1)
        rays = np.concatenate([(pixels - lens.centre) / lens.focal, np.ones((*u.shape, 1))], axis=-1)
        rays = rays @ T_base_camera[:3, :3].T
        down = np.minimum(rays[..., 2], -1e-3)  # a ray above the horizon ends far away on the floor
        depth = (table.height - eye[2]) / down
        low, high = np.transpose([table.x, table.y])
        share = (eye[:2] + depth[..., None] * rays[..., :2] - low) / (high - low)
        on_table = np.all((share >= 0.0) & (share <= 1.0), axis=-1) & (depth > 0.0)
        height, width = self.texture.shape[:2]
        texels = np.clip((share * [1.0, -1.0] + [0.0, 1.0]) * [width, height], 0, [width - 1, height - 1]).astype(
            int
        )
        light = min(lens.ambient + lens.diffuse * self.light[2], 1.0)
        rgb = np.where(on_table[..., None], self.texture[texels[..., 1], texels[..., 0]], self.floor_rgb) * light
        return Canvas(
            rgb.astype(np.uint8),
            (1.0 / np.where(on_table, depth, (self.floor - eye[2]) / down)).astype(np.float32),
        )


class RobotMesh:
    """The robot's visible links, from its URDF: each link is a body with one colour."""

    def __init__(self, urdf: str) -> None:
        self._model = pin.buildModelFromUrdf(urdf)
        self._visuals = list(pin.buildGeomFromUrdf(self._model, urdf, pin.GeometryType.VISUAL).geometryObjects)
        self._mesh = _merged(self._visuals)

    def draw(
        self, canvas: Canvas, T_camera_base: Array, joints: Mapping[str, float], lens: Lens, light: Array
    ) -> None:
        """Draw the robot on the canvas. joints: name -> position. light: as for `draw_mesh`."""
        draw_mesh(canvas, self._mesh, T_camera_base @ self._poses(joints), lens, light)

    def _poses(self, joints: Mapping[str, float]) -> Array:
        """Return the poses (k, 4, 4) of the links in the base frame."""
        q, data = pin.neutral(self._model), self._model.createData()
        for name, value in joints.items():
            joint = self._model.joints[self._model.getJointId(name)]
            # a joint without limits has its cosine and sine
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        pin.forwardKinematics(self._model, data, q)
        return np.array([(data.oMi[v.parentJoint] * v.placement).homogeneous for v in self._visuals])


@lru_cache(maxsize=2)
def robot_mesh(urdf: str) -> RobotMesh:
    """Return the mesh of a URDF, loaded once. It may be drawn on several threads."""
    return RobotMesh(urdf)


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
