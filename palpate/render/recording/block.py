"""The object as a block whose top gives way under the tip: the depth is measured, the shape is drawn."""

import numpy as np
import rerun as rr

from robot_io.types import FloatArray, IntArray

_TOP, _SIDE = (226, 168, 124), (168, 116, 84)
_HALF_WIDTH_M, _THICKNESS_M = 0.09, 0.05
_GRID = 33  # vertices along each edge of the top
_CROWDING = 1.7  # > 1 puts more vertices near the middle, where the top bends
_RADIUS_M = 0.018  # of the dimple
_RESOLUTION_M = 5e-5  # smaller changes of depth are not drawn


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
        even = np.linspace(-1.0, 1.0, _GRID)
        crowded = _HALF_WIDTH_M * np.sign(even) * np.abs(even) ** _CROWDING
        a, b = np.meshgrid(crowded, crowded, indexing="ij")
        self._flat: FloatArray = self._center + a.reshape(-1, 1) * self._u + b.reshape(-1, 1) * self._v

    def sides(self) -> rr.Mesh3D:
        """The four walls, each a quad of its own, so that its normal is its own."""
        signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        upper = np.array([self._center + _HALF_WIDTH_M * (a * self._u + b * self._v) for a, b in signs])
        lower, after = upper + _THICKNESS_M * self._down, np.roll(np.arange(4), -1)
        vertices = np.stack([upper, upper[after], lower[after], lower], axis=1).reshape(-1, 3)
        outward = (upper + upper[after]) / 2 - self._center
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        triangles = [(4 * i, 4 * i + j, 4 * i + j + 1) for i in range(4) for j in (1, 2)]
        return _mesh(vertices, np.repeat(outward, 4, axis=0), triangles, _SIDE)

    def top(self) -> rr.Mesh3D:
        """The unloaded top."""
        corners = [i * _GRID + j for i in range(_GRID - 1) for j in range(_GRID - 1)]
        triangles = [(c, c + 1, c + _GRID + 1) for c in corners]
        triangles += [(c, c + _GRID + 1, c + _GRID) for c in corners]
        return _mesh(self._flat, np.tile(-self._down, (len(self._flat), 1)), triangles, _TOP)

    def rows_that_differ(self, rows: IntArray, depth_m: FloatArray) -> IntArray:
        """Those of `rows` at which the top looks different from the row before, and the first."""
        steps = np.round(np.maximum(depth_m[rows], 0.0) / _RESOLUTION_M)
        return rows[np.r_[True, np.diff(steps) != 0]]

    def pressed(self, tips_world_m: FloatArray, depth_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vertices and normals of the top, each shape (m, vertices, 3), with the tip at m places.

        The top follows d / (1 + (r / a)^2)^(3/2): flat far away, and d deep under the tip.
        """
        offset = self._flat[None] - tips_world_m[:, None]
        along_u, along_v = offset @ self._u, offset @ self._v
        depth = np.maximum(depth_m, 0.0)[:, None]
        inside = 1.0 + (along_u**2 + along_v**2) / _RADIUS_M**2
        vertices = self._flat[None] + (depth * inside**-1.5)[..., None] * self._down
        slope = (-3.0 * depth * inside**-2.5 / _RADIUS_M**2)[..., None]
        normals = -self._down + slope * (along_u[..., None] * self._u + along_v[..., None] * self._v)
        return vertices, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _mesh(
    vertices: FloatArray,
    normals: FloatArray,
    triangles: list[tuple[int, int, int]],
    color: tuple[int, int, int],
) -> rr.Mesh3D:
    colors = [color] * len(vertices)
    return rr.Mesh3D(
        vertex_positions=vertices, vertex_normals=normals, triangle_indices=triangles, vertex_colors=colors
    )
