"""Coloured TSDF fusion of posed scans (Curless and Levoy 1996) in Open3D's sparse voxel blocks.

Tuned for few views: a surface seen once is kept, so nothing relies on other views to outvote
noise. Pixels at depth edges never enter the volume, and of the extracted surface only what some
scan measured face-on stays: the skirts that a volume grows behind silhouettes do not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fewview.config import FusionConfig
from fewview.geometry import se3
from fewview.geometry.camera import backproject, depth_edges, project
from fewview.types import Array, BoolArray, ColouredMesh, FloatArray, Frame, IntArray

_BLOCK = 8
_TRUNCATION_VOXELS = 4.0  # at most half a block, see _touched_blocks
_BYTES_PER_VOXEL = 36  # distance, weight, colour in float32; four int32 during extraction
_VOXEL_RANGE_M = (0.004, 0.05)
_MIN_COSINE = 0.2
_MIN_PIECE_M2 = 0.01
_MIN_PIECE_SHARE = 0.01
_MIN_PIECE_PIXELS = 400
_PINHOLE_WINDOW = 5
_PINHOLE_VALID = 18  # of the 24 neighbours: no pixel of a hole of 3 x 3 or more has as many
_PINHOLE_SPREAD = 0.05


@dataclass(frozen=True)
class _View:
    """A scan ready for integration; `depth` is 0 where a pixel is not trusted."""

    frame: Frame
    depth: FloatArray
    world_T_scan: Array


def fuse(frames: Iterable[tuple[Frame, Array]], config: FusionConfig) -> ColouredMesh:
    """Fuse scans into one mesh in the frame of their poses; the same input gives the same bytes.

    The voxel follows the depth data (`data_voxel`) unless ``config.voxel_m`` is given, and grows
    until the volume fits into ``config.max_memory_mb``.

    Args:
        frames: pixels and ``world_T_scan`` (4, 4) of each scan; read once, in order.
        config: see `FusionConfig`.

    Returns:
        The mesh, its faces counter-clockwise seen from free space; empty when no depth is usable.

    Raises:
        ValueError: there are no frames.
    """
    views = [_View(f, trusted_depth(f, config.max_depth_m), pose) for f, pose in frames]
    if not views:
        raise ValueError("fuse needs at least one frame")
    views = [view for view in views if view.depth.any()]
    if not views:
        return _mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint8))
    voxel, blocks = _allocate(views, config)
    mesh = _canonical(_integrate(views, blocks, voxel))
    seen = _measured(mesh, views, _TRUNCATION_VOXELS * voxel)
    mesh = _keep(mesh, seen[mesh.faces].sum(axis=1) >= 2)
    return _without_floaters(mesh, views, _TRUNCATION_VOXELS * voxel)


def trusted_depth(frame: Frame, max_depth_m: float) -> FloatArray:
    """Depth (H, W) in metres, 0 where invalid, beyond ``max_depth_m`` or beside a depth edge.

    Pinholes of a few pixels in a smooth surface are filled: a voxel is wider than they are, so
    each would leave a much larger hole in the mesh.
    """
    valid = np.isfinite(frame.depth) & (frame.depth > 0.0)
    depth = _without_pinholes(np.where(valid, frame.depth, np.float32(0.0)))
    depth = np.where(depth <= max_depth_m, depth, np.float32(0.0))
    return np.where(depth_edges(depth), np.float32(0.0), depth)


def _without_pinholes(depth: FloatArray) -> FloatArray:
    """Depth (H, W) with the mean of the neighbours where most are valid and they all agree."""
    valid, size = depth > 0.0, (_PINHOLE_WINDOW, _PINHOLE_WINDOW)
    count, total = (
        cv2.boxFilter(image, -1, size, normalize=False, borderType=cv2.BORDER_REFLECT_101)
        for image in (valid.astype(np.float32), depth)
    )
    nearest = cv2.erode(np.where(valid, depth, np.float32(np.inf)), np.ones(size))
    farthest = cv2.dilate(depth, np.ones(size))
    pinhole = ~valid & (count >= _PINHOLE_VALID)
    pinhole &= farthest - nearest <= _PINHOLE_SPREAD * nearest
    return np.where(pinhole, total / np.maximum(count, 1.0), depth).astype(np.float32)


def data_voxel(depths: FloatArray, focal_px: float) -> float:
    """Voxel edge in metres that depths (n,) in metres support.

    Four pixels wide at the median depth, and at least two standard deviations of structured
    light's axial noise there (Nguyen, Izadi and Lovell 2012, without the angular term).
    """
    z = float(np.median(depths))
    noise = 0.0012 + 0.0019 * (z - 0.4) ** 2
    return float(np.clip(max(4.0 * z / focal_px, 2.0 * noise), *_VOXEL_RANGE_M))


def _allocate(views: list[_View], config: FusionConfig) -> tuple[float, list[IntArray]]:
    """The voxel edge and, per view, the (n, 3) blocks that its surface touches."""
    focal = float(np.mean([view.frame.intrinsics.fx for view in views]))
    depths = np.concatenate([view.depth[view.depth > 0.0][::64] for view in views])
    voxel = config.voxel_m or data_voxel(depths, focal)
    while True:
        blocks = [_touched_blocks(view, voxel) for view in views]
        size = len(_unique_rows(np.concatenate(blocks))) * _BLOCK**3 * _BYTES_PER_VOXEL
        excess = size / (config.max_memory_mb * 2**20)
        if excess <= 1.0:
            return voxel, blocks
        voxel *= max(1.05, float(np.sqrt(excess)))


def _touched_blocks(view: _View, voxel: float) -> IntArray:
    """Unique (n, 3) integer coordinates of the blocks within the truncation of a view's surface.

    A cube of twice the truncation is no wider than a block, so its corners find all its blocks.
    """
    edge, reach = _BLOCK * voxel, _TRUNCATION_VOXELS * voxel
    step = max(1, int(edge * view.frame.intrinsics.fx / (4.0 * float(view.depth.max()))))
    points = backproject(view.depth, view.frame.intrinsics)[view.depth > 0.0][::step]
    world = se3.transform(view.world_T_scan, points.astype(np.float64))
    low = np.floor((world - reach) / edge).astype(np.int64)
    high = np.floor((world + reach) / edge).astype(np.int64)
    cubes = _unique_rows(np.hstack([low, high - low]))
    corners = np.indices((2, 2, 2)).reshape(3, 8).T
    return _unique_rows((cubes[:, None, :3] + cubes[:, None, 3:] * corners).reshape(-1, 3))


def _unique_rows(rows: IntArray) -> IntArray:
    """Sorted distinct rows (n, d); through flat keys, far faster than `numpy.unique` on rows."""
    low = rows.min(axis=0)
    shape = tuple(int(n) for n in rows.max(axis=0) - low + 1)
    flat = np.unique(np.ravel_multi_index(tuple((rows - low).T), shape))
    return np.asarray(np.stack(np.unravel_index(flat, shape), axis=-1) + low)


def _integrate(views: list[_View], blocks: list[IntArray], voxel: float) -> ColouredMesh:
    """Average the views' signed distances and colours and extract the zero level."""
    o3c, image = o3d.core, o3d.t.geometry.Image
    capacity = len(_unique_rows(np.concatenate(blocks)))
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (o3c.float32,) * 3, ((1), (1), (3)), voxel, _BLOCK, capacity
    )
    for view, touched in zip(views, blocks, strict=True):
        volume.integrate(
            o3c.Tensor(touched.astype(np.int32)),
            image(o3c.Tensor(view.depth)),
            image(o3c.Tensor(view.frame.colour.astype(np.float32))),
            o3c.Tensor(view.frame.intrinsics.matrix),
            o3c.Tensor(se3.inverse(view.world_T_scan)),
            depth_scale=1.0,
            depth_max=float(view.depth.max()) + 1.0,
            trunc_voxel_multiplier=_TRUNCATION_VOXELS,
        )
    surface = volume.extract_triangle_mesh(weight_threshold=0.0)
    colours = np.rint(surface.vertex.colors.numpy()).clip(0, 255).astype(np.uint8)
    return _mesh(surface.vertex.positions.numpy(), surface.triangle.indices.numpy(), colours)


def _mesh(
    vertices: FloatArray | Array, faces: IntArray, colours: NDArray[np.uint8]
) -> ColouredMesh:
    return ColouredMesh(vertices.astype(np.float64), faces.astype(np.int64), colours)


def _canonical(mesh: ColouredMesh) -> ColouredMesh:
    """Weld equal vertices and sort: Open3D's threads number vertices and faces as they come."""
    order = np.lexsort(np.concatenate([mesh.colours.T, mesh.vertices.T[::-1]]))
    vertices = mesh.vertices[order]
    first = np.ones(len(order), dtype=bool)
    first[1:] = (vertices[1:] != vertices[:-1]).any(axis=1)
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(first) - 1
    faces = number[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    turn = (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3
    faces = np.take_along_axis(faces, turn, axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    return ColouredMesh(vertices[first], faces, mesh.colours[order][first])


def _measured(mesh: ColouredMesh, views: list[_View], tolerance_m: float) -> BoolArray:
    """Vertices (n,) that some view measured within the tolerance and not at a grazing angle."""
    normals = _smooth_normals(mesh)
    seen = np.zeros(len(mesh.vertices), dtype=bool)
    for view in views:
        left = np.flatnonzero(~seen)
        points, agrees = _compare(mesh.vertices[left], view, tolerance_m)
        turned = se3.rotate(se3.inverse(view.world_T_scan), normals[left])
        towards = -np.einsum("ni,ni->n", turned, points)
        seen[left] = agrees & (towards > _MIN_COSINE * np.linalg.norm(points, axis=1))
    return seen


def _compare(world: Array, view: _View, tolerance_m: float) -> tuple[Array, BoolArray]:
    """World points (n, 3) in a view's frame, and which (n,) lie on what the view measured."""
    points = se3.transform(se3.inverse(view.world_T_scan), world)
    pixels, inside = project(points, view.frame.intrinsics)
    u, v = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(np.int64).T
    return points, inside & (np.abs(view.depth[v, u] - points[:, 2]) < tolerance_m)


def _smooth_normals(mesh: ColouredMesh) -> Array:
    """Unit vertex normals (n, 3), area-weighted and averaged twice over the neighbours."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    weighted = np.cross(b - a, c - a)
    corner = coo_array(
        (np.ones(mesh.faces.size), (mesh.faces.ravel(), np.arange(mesh.faces.size) // 3)),
        shape=(len(mesh.vertices), len(mesh.faces)),
    ).tocsr()
    normals = _unit(corner @ weighted)
    for _ in range(2):
        normals = _unit(corner @ (corner.T @ normals))
    return normals


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-12))


def _without_floaters(mesh: ColouredMesh, views: list[_View], tolerance_m: float) -> ColouredMesh:
    """Drop connected pieces small in area (in small scenes, in share of it) and in pixels.

    Near the camera even a small piece is measured by many pixels and no accident.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    normals = 0.5 * np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    links = (np.ones(2 * len(mesh.faces)), (mesh.faces[:, :2].ravel(), mesh.faces[:, 1:].ravel()))
    graph = coo_array(links, shape=(len(mesh.vertices), len(mesh.vertices)))
    piece = connected_components(graph, directed=False)[1][mesh.faces[:, 0]]
    size = np.bincount(piece, weights=area)
    smallest = min(_MIN_PIECE_M2, _MIN_PIECE_SHARE * float(area.sum()))
    small = np.flatnonzero(size[piece] < smallest)
    pixels = _pixels(((a + b + c) / 3.0)[small], normals[small], views, tolerance_m)
    measured = np.bincount(piece[small], weights=pixels, minlength=len(size))
    return _keep(mesh, (size >= smallest)[piece] | (measured >= _MIN_PIECE_PIXELS)[piece])


def _pixels(centres: Array, normals: Array, views: list[_View], tolerance_m: float) -> Array:
    """How many pixels of all views fall on each face (n,), from its size in the images.

    Args:
        centres: (n, 3) of the faces, world.
        normals: (n, 3) as long as the faces are large, world.
        views: the scans; a face counts where it lies on what a view measured.
        tolerance_m: along the optical axis.
    """
    pixels = np.zeros(len(centres))
    for view in views:
        points, agrees = _compare(centres, view, tolerance_m)
        turned = se3.rotate(se3.inverse(view.world_T_scan), normals)
        facing = np.abs(np.einsum("ni,ni->n", turned, points))
        focal = view.frame.intrinsics.fx * view.frame.intrinsics.fy
        pixels += np.where(agrees, focal * facing / np.maximum(points[:, 2], 1e-3) ** 3, 0.0)
    return pixels


def _keep(mesh: ColouredMesh, chosen: BoolArray) -> ColouredMesh:
    """The mesh with only the chosen faces (m,) and the vertices they use."""
    faces = mesh.faces[chosen]
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[faces] = True
    number = np.cumsum(used) - 1
    return ColouredMesh(mesh.vertices[used], number[faces], mesh.colours[used])
