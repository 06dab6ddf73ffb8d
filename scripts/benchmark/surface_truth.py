"""The true surface behind the points of a scan, which the labels of relations are read off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from fewview.geometry import se3
from fewview.types import Array, ColouredMesh, CompletedScan, IntArray


@dataclass(frozen=True)
class Oriented:
    """Points (n, 3) with unit normals (n, 3) towards the camera, in a scan's frame."""

    points: Array
    normals: Array

    @staticmethod
    def of(scan: CompletedScan) -> Oriented:
        """The scan's surface as it was measured."""
        return Oriented(scan.surface.points, scan.surface.normals)

    def at(self, index: IntArray) -> Oriented:
        """Some of the points."""
        return Oriented(self.points[index], self.normals[index])


class TrueMesh:
    """A scene's true mesh, asked for what a scan's points really lie on."""

    def __init__(self, mesh: ColouredMesh) -> None:
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(mesh.vertices.astype(np.float32)),
            o3d.core.Tensor(mesh.faces.astype(np.uint32)),
        )

    def behind(self, scan: CompletedScan, world_T_scan: Array) -> Oriented:
        """The mesh's nearest point, with its face's normal, to each point of a scan's surface.

        Args:
            scan: the scan.
            world_T_scan: (4, 4) its true pose in the mesh's frame.
        """
        world = se3.transform(world_T_scan, scan.surface.points)
        found = self._scene.compute_closest_points(o3d.core.Tensor(world.astype(np.float32)))
        scan_T_world = se3.inverse(world_T_scan)
        points = se3.transform(scan_T_world, found["points"].numpy().astype(np.float64))
        normals = se3.rotate(scan_T_world, found["primitive_normals"].numpy().astype(np.float64))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        away = np.einsum("ni,ni->n", normals, points) > 0.0
        return Oriented(points, np.where(away[:, None], -normals, normals))
