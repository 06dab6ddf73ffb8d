"""Following rays to the first surface, by whatever is at hand to do it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fewview.types import Array, BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    import open3d as o3d

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
"""Of a quadrilateral; triangle 2 q + i is the i-th of quadrilateral q."""


@dataclass(frozen=True, eq=False)
class Met:
    """What rays meet first.

    Attributes:
        depth: (n,) float32 in lengths of the rays' directions, infinite where nothing is met.
        triangle: (n,) its number, 0 where nothing is met.
        weights: (n, 2) float32 barycentric, of the triangle's second and third corner.
    """

    depth: FloatArray
    triangle: IntArray
    weights: FloatArray


class Caster(Protocol):
    """Something that follows rays among the quadrilaterals of a room."""

    def cast(self, beams: FloatArray) -> Met:
        """The first hits of rays (n, 6), origins and directions."""

    def blocked(self, beams: FloatArray) -> BoolArray:
        """(n,) whether something is between 0 and 1 lengths along rays (n, 6)."""


class Embree:
    """Open3D's ray caster on one thread."""

    def __init__(self, corners: Array) -> None:
        self._corners = corners

    @cached_property
    def scene(self) -> o3d.t.geometry.RaycastingScene:
        """Two triangles per quadrilateral."""
        import open3d as o3d

        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        faces = (4 * np.arange(len(self._corners))[:, None, None] + TRIANGLES).reshape(-1, 3)
        vertices = self._corners.reshape(-1, 3).astype(np.float32)
        scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces.astype(np.uint32)))
        return scene

    def cast(self, beams: FloatArray) -> Met:
        """The first hits of rays (n, 6), origins and directions."""
        import open3d as o3d

        found = self.scene.cast_rays(o3d.core.Tensor(beams))
        depth = found["t_hit"].numpy()
        triangle = np.where(np.isfinite(depth), found["primitive_ids"].numpy(), 0)
        return Met(depth, triangle.astype(np.int64), found["primitive_uvs"].numpy())

    def blocked(self, beams: FloatArray) -> BoolArray:
        """(n,) whether something is between 0 and 1 lengths along rays (n, 6)."""
        import open3d as o3d

        hidden = self.scene.test_occlusions(o3d.core.Tensor(beams), tnear=0.0, tfar=1.0)
        return np.asarray(hidden.numpy())
