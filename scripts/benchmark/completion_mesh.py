"""What a true mesh says of the room around a camera: its ring, its map and its planes."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from benchmark.rendering import upright
from fewview.completion.layout.grid import (
    CELL_M,
    CELLS,
    FREE,
    FURNITURE,
    HALF_M,
    UNKNOWN,
    WALL,
)
from fewview.completion.panorama.ring import ring_rays
from fewview.completion.patches import find_patches
from fewview.evaluation.mesh import sample_surface
from fewview.geometry import se3
from fewview.training.point_batches import CEILING, FLOOR
from fewview.training.point_batches import WALL as WALL_PLANE
from fewview.types import Array, BoolArray, ColouredMesh, FloatArray, Surface

SAMPLES_PER_M2 = 1600
"""Of the surface, about ten around the middle of a cell."""
MIDDLE_M = 0.04
"""A cell is what lies within this of its middle: maps of generated rooms are sampled there."""
UPRIGHT, FLAT = 0.3, 0.9
"""Largest vertical part of a wall's normal, smallest of the floor's."""
WALL_THICK_M = 0.15
"""Walls in a map reach so far behind their surface, as in generated rooms."""
INSIDE_M = 0.06
"""Furniture is found so far behind its surface, so that a bumpy wall is none."""
TALL_M = (1.5, 2.3)
"""A wall is upright over most of this range of heights; furniture rarely is."""
TALL_BIN_M, TALL_SHARE = 0.1, 0.5
FLOOR_M, STANDING_M = 0.1, (0.12, 2.0)
"""The floor is within the first; what is in the second stands on it, metres above it."""
PATCH_SAMPLES, PATCHES = 6000, 40
"""Of the surface and of its planes in the search for structural ones."""
MIN_WALL_M2, MIN_LEVEL_M2 = 1.0, 2.0
HIGH_SHARE = 0.7
"""A structural wall reaches this share of the height of the ceiling."""
SAME_COS, SAME_M = float(np.cos(np.radians(8.0))), 0.15
"""Pieces of surface on one plane."""


class MeshRoom:
    """The true surface of a room, triangles with their front inside."""

    def __init__(self, mesh: ColouredMesh, up: Array) -> None:
        """Take a mesh whose world has about the given (3,) upward direction."""
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            o3d.core.Tensor(mesh.vertices.astype(np.float32)),
            o3d.core.Tensor(mesh.faces.astype(np.uint32)),
        )
        self._rng = np.random.default_rng(0)
        a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
        area = float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        count = int(SAMPLES_PER_M2 * area)
        points = sample_surface(mesh.vertices, mesh.faces, count, self._rng)
        found = self._scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
        normals = found["primitive_normals"].numpy().astype(np.float64)
        turn = _z_up(upright(normals, up))
        floor = _floor_height(points @ turn[2], normals @ turn[2])
        self._upright_T_world = se3.pose(turn, np.array([0.0, 0.0, -floor]))
        self._points = se3.transform(self._upright_T_world, points)
        self._normals = se3.rotate(self._upright_T_world, normals)
        self._planes, self._kinds = self._structure(area)

    def ring(self, level_T_world: Array, size: int) -> tuple[FloatArray, FloatArray]:
        """What a camera sees all around.

        Args:
            level_T_world: (4, 4) into the level frame of the ring.
            size: S of the ring.

        Returns:
            depth (S, 4 S), 0 where the mesh has a hole or shows its back, and normals
            (S, 4 S, 3) in the level frame, 0 there.
        """
        world_T_level = se3.inverse(level_T_world)
        rays = ring_rays(size).astype(np.float64)
        origins = np.broadcast_to(world_T_level[:3, 3], rays.shape)
        beams = np.concatenate([origins, rays @ world_T_level[:3, :3].T], axis=-1)
        hit = self._scene.cast_rays(o3d.core.Tensor(beams.astype(np.float32)))
        normals = hit["primitive_normals"].numpy() @ level_T_world[:3, :3].T.astype(np.float32)
        depth = hit["t_hit"].numpy()
        front = np.isfinite(depth) & ((normals * rays).sum(axis=-1) < 0)
        shown = np.where(front, depth, 0).astype(np.float32)
        return shown, (normals * front[..., None]).astype(np.float32)

    def upright(self, level_T_world: Array) -> Array:
        """(4, 4) the same frame stood upright: z truly up, x in the same direction from above."""
        turn = self._upright_T_world[:3, :3] @ level_T_world[:3, :3].T
        azimuth = np.arctan2(turn[1, 0], turn[0, 0])
        back = se3.rotation_exp(np.array([0.0, 0.0, -azimuth])) @ self._upright_T_world[:3, :3]
        eye = se3.inverse(level_T_world)[:3, 3]
        return se3.pose(back, -back @ eye)

    def ground(self, grid_T_world: Array) -> tuple[NDArray[np.uint8], BoolArray]:
        """The map on the grid of an upright frame: walls, furniture and free floor.

        A wall is upright over most of `TALL_M`, doors among them; furniture is what else there is
        within `STANDING_M` of the floor; the floor is free where nothing is above it.

        Returns:
            (G, G) classes, and where the mesh says anything.
        """
        grid_T_upright = grid_T_world @ se3.inverse(self._upright_T_world)
        height, tall = self._points[:, 2], np.abs(self._normals[:, 2]) < UPRIGHT
        places = se3.transform(grid_T_upright, self._points)[:, :2]
        normals = se3.rotate(grid_T_upright, self._normals)[:, :2]
        wall = self._walls(places, normals, tall)
        level = (np.abs(height) < FLOOR_M) & (self._normals[:, 2] > FLAT)
        standing = (height > STANDING_M[0]) & (height < STANDING_M[1])
        inside = places[standing] - INSIDE_M * normals[standing]
        floor, stands = _cells_with(places[level]), _cells_with(inside)
        out = np.where(wall, WALL, np.where(stands, FURNITURE, np.where(floor, FREE, UNKNOWN)))
        return out.astype(np.uint8), np.asarray(out != UNKNOWN)

    def planes_in(self, level_T_world: Array) -> tuple[Array, NDArray[np.uint8]]:
        """Structural planes (P, 4) in a level frame, normals into the room, and kinds (P,)."""
        level_T_upright = level_T_world @ se3.inverse(self._upright_T_world)
        normals = se3.rotate(level_T_upright, self._planes[:, :3])
        offsets = self._planes[:, 3] + normals @ level_T_upright[:3, 3]
        return np.column_stack([normals, offsets]), self._kinds

    def _walls(self, places: Array, normals: Array, tall: BoolArray) -> BoolArray:
        """(G, G) cells behind upright surface over most of `TALL_M`."""
        height = self._points[:, 2]
        chosen = tall & (height > TALL_M[0]) & (height < TALL_M[1])
        bins = round((TALL_M[1] - TALL_M[0]) / TALL_BIN_M)
        number = ((height[chosen] - TALL_M[0]) / TALL_BIN_M).astype(int).clip(0, bins - 1)
        shown = np.zeros((bins, CELLS, CELLS), bool)
        for depth in np.arange(0.5 * MIDDLE_M, WALL_THICK_M, MIDDLE_M):
            behind = places[chosen] - depth * normals[chosen]
            for b in range(bins):
                shown[b] |= _cells_with(behind[number == b])
        return np.asarray(shown.mean(axis=0) >= TALL_SHARE)

    def _structure(self, area: float) -> tuple[Array, NDArray[np.uint8]]:
        """Planes (P, 4) of walls, floor and ceiling in the upright frame, and their kinds."""
        some = self._rng.permutation(len(self._points))[:PATCH_SAMPLES]
        points, normals = self._points[some], self._normals[some]
        middle = points.mean(axis=0)
        blank = np.zeros((len(some), 3), np.float32), np.full(len(some), -1, np.int64)
        surface, patches = find_patches(
            Surface(points - middle, normals, *blank), PATCHES, self._rng
        )
        each_m2 = area / len(some)
        highest = float(np.percentile(points[:, 2], 99.0))
        planes: list[Array] = []
        kinds: list[int] = []
        for number, patch in enumerate(patches):
            mine = points[surface.labels == number, 2]
            kind = _kind(patch.normal[2], mine, highest, each_m2)
            plane = np.append(patch.normal, patch.normal @ (patch.centre + middle))
            same = [p[:3] @ plane[:3] > SAME_COS and abs(p[3] - plane[3]) < SAME_M for p in planes]
            if kind and not any(same):
                planes.append(plane)
                kinds.append(kind)
        return np.array(planes).reshape(-1, 4), np.array(kinds, np.uint8)


def _z_up(up: Array) -> Array:
    """(3, 3) some rotation that takes ``up`` to z."""
    other = np.eye(3)[int(np.abs(up).argmin())]
    x = np.cross(other, up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _floor_height(height: Array, up: Array) -> float:
    """The lowest of the heights at which much surface faces up."""
    facing = height[up > FLAT]
    counts, edges = np.histogram(
        facing, bins=np.arange(height.min() - 0.1, height.max() + 0.1, 0.05)
    )
    low = edges[np.flatnonzero(counts > 0.35 * counts.max())[0]]
    return float(np.median(facing[np.abs(facing - low - 0.025) < 0.075]))


def _kind(up: float, heights: Array, highest: float, each_m2: float) -> int:
    """`PlaneKind` of a patch with normal's vertical part ``up`` and samples at ``heights``."""
    area = each_m2 * len(heights)
    if abs(up) < UPRIGHT:
        high = np.percentile(heights, 95.0) > HIGH_SHARE * highest
        return WALL_PLANE if high and area > MIN_WALL_M2 else 0
    if area < MIN_LEVEL_M2 or abs(up) < FLAT:
        return 0
    middle = float(np.median(heights))
    if up > 0:
        return FLOOR if abs(middle) < FLOOR_M else 0
    return CEILING if middle > HIGH_SHARE * highest else 0


def _cells_with(places: Array) -> BoolArray:
    """(G, G) cells of the layout grid that have one of (n, 2) places within `MIDDLE_M`."""
    along = (HALF_M - places) / CELL_M - 0.5
    cells = np.rint(along).astype(np.int64)
    near = (np.abs(along - cells) * CELL_M < MIDDLE_M).all(axis=1)
    cells = cells[near & ((cells >= 0) & (cells < CELLS)).all(axis=1)]
    out = np.zeros((CELLS, CELLS), bool)
    out[cells[:, 0], cells[:, 1]] = True
    return out
