"""The object as a block whose top gives way under the tip: the depth is measured, the shape is drawn."""

import numpy as np
import rerun as rr

from palpate.views import colors
from robot_io.types import FloatArray, IntArray

HALF_WIDTH_M = 0.09
THICKNESS_M = 0.05
GRID = 33  # vertices along each edge of the top
CROWDING = 1.7  # >1 puts more vertices near the middle, where the top bends
DIMPLE_RADIUS_M = 0.018
RESOLUTION_M = 5e-5  # smaller changes of depth are not drawn


class Block:
    """A block below a point on its top.

    Args:
        top_center_world_m: shape (3,), the touched point of the unloaded surface [m].
        press_direction_world: shape (3,), unit vector into the block.
    """

    def __init__(self, top_center_world_m: FloatArray, press_direction_world: FloatArray) -> None:
        self._center = top_center_world_m
        self._down = press_direction_world / np.linalg.norm(press_direction_world)
        sideways = np.eye(3)[np.argmin(np.abs(self._down))]
        self._u = np.cross(self._down, sideways)
        self._u /= np.linalg.norm(self._u)
        self._v = np.cross(self._down, self._u)
        self._flat = self._flat_top()

    def sides(self) -> rr.Mesh3D:
        """The four walls."""
        corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        upper = [self._center + HALF_WIDTH_M * (a * self._u + b * self._v) for a, b in corners]
        lower = [corner + THICKNESS_M * self._down for corner in upper]
        vertices: list[FloatArray] = []
        normals: list[FloatArray] = []
        triangles: list[tuple[int, int, int]] = []
        for i in range(4):
            j = (i + 1) % 4
            base = len(vertices)
            vertices += [upper[i], upper[j], lower[j], lower[i]]
            outward = (upper[i] + upper[j]) / 2 - self._center
            normals += [outward / np.linalg.norm(outward)] * 4
            triangles += [(base, base + 1, base + 2), (base, base + 2, base + 3)]
        return rr.Mesh3D(
            vertex_positions=vertices,
            vertex_normals=normals,
            triangle_indices=triangles,
            vertex_colors=[colors.OBJECT_SIDE] * len(vertices),
        )

    def top(self) -> rr.Mesh3D:
        """The unloaded top."""
        return rr.Mesh3D(
            vertex_positions=self._flat,
            vertex_normals=np.tile(-self._down, (len(self._flat), 1)),
            triangle_indices=_grid_triangles(),
            vertex_colors=[colors.OBJECT_TOP] * len(self._flat),
        )

    def rows_that_differ(self, rows: IntArray, depth_m: FloatArray) -> IntArray:
        """Those of `rows` at which the top looks different from the row before, and the first."""
        steps = np.round(np.maximum(depth_m[rows], 0.0) / RESOLUTION_M)
        return rows[np.r_[True, np.diff(steps) != 0]]

    def pressed(self, tips_world_m: FloatArray, depth_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vertices and normals of the top, each shape (m, GRID**2, 3), with the tip at m places.

        The top follows d / (1 + (r / a)^2)^(3/2): flat far away, and d deep under the tip.
        """
        offset = self._flat[None] - tips_world_m[:, None]
        along_u, along_v = offset @ self._u, offset @ self._v
        depth = np.maximum(depth_m, 0.0)[:, None]
        inside = 1.0 + (along_u**2 + along_v**2) / DIMPLE_RADIUS_M**2
        sink = depth * inside**-1.5
        vertices = self._flat[None] + sink[..., None] * self._down
        slope = -3.0 * depth * inside**-2.5 / DIMPLE_RADIUS_M**2
        normals = -self._down + slope[..., None] * (
            along_u[..., None] * self._u + along_v[..., None] * self._v
        )
        return vertices, normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    def _flat_top(self) -> FloatArray:
        even = np.linspace(-1.0, 1.0, GRID)
        crowded = HALF_WIDTH_M * np.sign(even) * np.abs(even) ** CROWDING
        a, b = np.meshgrid(crowded, crowded, indexing="ij")
        flat: FloatArray = self._center + a.reshape(-1, 1) * self._u + b.reshape(-1, 1) * self._v
        return flat


def _grid_triangles() -> list[tuple[int, int, int]]:
    corners = [i * GRID + j for i in range(GRID - 1) for j in range(GRID - 1)]
    upper = [(c, c + 1, c + GRID + 1) for c in corners]
    return upper + [(c, c + GRID + 1, c + GRID) for c in corners]
