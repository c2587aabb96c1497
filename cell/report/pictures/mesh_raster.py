"""A raster of textured triangles with a depth buffer, for pictures that a person sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.compiled import cached

EDGE = 1e-5
"""A pixel belongs to a triangle if no weight of a corner is below minus this: no gap is left between triangles."""


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture that is drawn on. rgb: (h, w, 3); nearest: (h, w) the inverse depth of what is drawn so far
    [1/m]."""

    rgb: NDArray[np.uint8]
    nearest: NDArray[np.float32]

    def copy(self) -> Canvas:
        return Canvas(self.rgb.copy(), self.nearest.copy())


@dataclass(frozen=True, eq=False)
class Mesh:
    """Bodies as one mesh. vertices, normals: (n, 3), each in the frame of its body; body: (n,) its number;
    triangles: (m, 3); texels: (n, 2) column and row in the texture (h, w, 3) RGB."""

    vertices: Array
    normals: Array
    body: NDArray[np.int32]
    triangles: NDArray[np.int32]
    texels: Array
    texture: NDArray[np.uint8]


@dataclass(frozen=True)
class Lens:
    """The pinhole camera [px], the nearest depth that it draws [m], and the coefficients of the light."""

    focal: tuple[float, float]
    centre: tuple[float, float]
    nearest: float
    ambient: float
    diffuse: float


def draw_mesh(canvas: Canvas, mesh: Mesh, poses: Array, lens: Lens, light: Array) -> None:
    """Draw the bodies where nothing on the canvas is nearer.

    poses: (k, 4, 4) of the bodies in the camera's frame. light: (3,) unit vector to the light, in the camera's
    frame; both sides of a surface are lit alike. Triangles with a corner that is too near are left out.
    """
    _draw(
        mesh.vertices, mesh.normals, mesh.body, mesh.triangles, mesh.texels, mesh.texture,
        np.ascontiguousarray(poses, np.float64), np.asarray(light, np.float64),
        lens.focal[0], lens.focal[1], lens.centre[0], lens.centre[1], lens.nearest, lens.ambient, lens.diffuse,
        canvas.rgb, canvas.nearest,
    )  # fmt: skip


@cached()
def _raster(p, w, triangles, shade, texels, texture, rgb, nearest):  # type: ignore[no-untyped-def]
    """Fill the triangles. p: (n, 2) column and row of the vertices, pixel centres at integers; w: (n,) inverse
    depth, 0 for a vertex that is too near; shade: (n,) brightness, 0 to 1."""
    height, width = nearest.shape
    for m in range(triangles.shape[0]):
        i, j, k = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        if w[i] <= 0.0 or w[j] <= 0.0 or w[k] <= 0.0:
            continue
        x0, y0, x1, y1, x2, y2 = p[i, 0], p[i, 1], p[j, 0], p[j, 1], p[k, 0], p[k, 1]
        left, right = max(0, int(np.ceil(min(x0, x1, x2)))), min(width - 1, int(np.floor(max(x0, x1, x2))))
        top, bottom = max(0, int(np.ceil(min(y0, y1, y2)))), min(height - 1, int(np.floor(max(y0, y1, y2))))
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if left > right or top > bottom or abs(area) < 1e-6:
            continue
        # the weights of the second and the third corner are linear in column and row
        b_x, b_y, c_x, c_y = (y2 - y0) / area, (x0 - x2) / area, (y0 - y1) / area, (x1 - x0) / area
        for row in range(top, bottom + 1):
            # the part of the row within the triangle: no weight is negative there
            b_0, c_0 = (row - y0) * b_y - x0 * b_x, (row - y0) * c_y - x0 * c_x
            low, high = float(left), float(right)
            for start, slope in ((b_0, b_x), (c_0, c_x), (1.0 - b_0 - c_0, -b_x - c_x)):
                if slope > 0.0:
                    low = max(low, -(start + EDGE) / slope)
                elif slope < 0.0:
                    high = min(high, -(start + EDGE) / slope)
                elif start < -EDGE:
                    high = -1.0
            for column in range(int(np.ceil(low)), int(np.floor(high)) + 1):
                b, c = b_0 + column * b_x, c_0 + column * c_x
                a = 1.0 - b - c
                near = a * w[i] + b * w[j] + c * w[k]
                if near <= nearest[row, column]:
                    continue
                nearest[row, column] = near
                light = a * shade[i] + b * shade[j] + c * shade[k]
                texel_column = int(a * texels[i, 0] + b * texels[j, 0] + c * texels[k, 0])
                texel_row = int(a * texels[i, 1] + b * texels[j, 1] + c * texels[k, 1])
                for channel in range(3):
                    rgb[row, column, channel] = np.uint8(light * texture[texel_row, texel_column, channel])


@cached()
def _draw(  # type: ignore[no-untyped-def]
    vertices, normals, body, triangles, texels, texture, poses, light, fx, fy, cx, cy, near_limit, ambient,
    diffuse, rgb, nearest,
):  # fmt: skip
    """Draw all in one call: after each call, a drawing thread waits while another computes in Python."""
    n = len(vertices)
    p, w, shade = np.empty((n, 2), np.float32), np.zeros(n, np.float32), np.empty(n, np.float32)
    for i in range(n):
        T = poses[body[i]]
        z = T[2, 0] * vertices[i, 0] + T[2, 1] * vertices[i, 1] + T[2, 2] * vertices[i, 2] + T[2, 3]
        if z <= near_limit:
            continue
        x = T[0, 0] * vertices[i, 0] + T[0, 1] * vertices[i, 1] + T[0, 2] * vertices[i, 2] + T[0, 3]
        y = T[1, 0] * vertices[i, 0] + T[1, 1] * vertices[i, 1] + T[1, 2] * vertices[i, 2] + T[1, 3]
        p[i, 0], p[i, 1], w[i] = fx * x / z + cx, fy * y / z + cy, 1.0 / z
        lit = 0.0
        for axis in range(3):
            lit += light[axis] * (
                T[axis, 0] * normals[i, 0] + T[axis, 1] * normals[i, 1] + T[axis, 2] * normals[i, 2]
            )
        shade[i] = min(ambient + diffuse * abs(lit), 1.0)
    _raster(p, w, triangles, shade, texels, texture, rgb, nearest)
