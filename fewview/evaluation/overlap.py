"""How much two scans share under ground truth, and the classes results are split by."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from fewview.geometry import se3
from fewview.types import Array

NEIGHBOUR_M = 0.05
"""A point is shared when the other scan has one within this distance."""
THIN_M = 0.03
"""Voxel to which scans are thinned before counting: small against `NEIGHBOUR_M`, and it makes
the share one of surface area instead of pixels."""
CLASSES = (
    (0.01, "< 1 %"),
    (0.1, "1-10 %"),
    (0.3, "10-30 %"),
    (0.5, "30-50 %"),
    (np.inf, ">= 50 %"),
)
"""Upper bounds (exclusive) and names of the overlap classes."""


def thin(points: Array, voxel_m: float = THIN_M) -> Array:
    """(n, 3) points to the (m, 3) centroids of the occupied voxels, in a fixed order."""
    if not len(points):
        return points.reshape(0, 3)
    cells = np.floor(points / voxel_m).astype(np.int64)
    cells -= cells.min(axis=0)
    span = cells.max(axis=0) + 1
    keys = np.ravel_multi_index(tuple(cells.T), tuple(span))
    _, index, count = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(index, weights=points[:, axis]) for axis in range(3)]
    return np.stack(sums, axis=-1) / count[:, None]


def overlap(
    source: Array, target: Array, target_T_source: Array, distance_m: float = NEIGHBOUR_M
) -> float:
    """Share 0..1 of the points of the smaller scan that have a neighbour in the other.

    Args:
        source: (n, 3) points in the source frame, metres.
        target: (m, 3) points in the target frame, metres.
        target_T_source: their true relative pose.
        distance_m: what counts as a neighbour.
    """
    moved = se3.transform(target_T_source, source)
    fewer, more = (moved, target) if len(moved) <= len(target) else (target, moved)
    return shared(fewer, KDTree(more), distance_m)


def shared(points: Array, tree: KDTree, distance_m: float = NEIGHBOUR_M) -> float:
    """Share 0..1 of (n, 3) ``points`` with a neighbour in ``tree``, both in one frame."""
    if not len(points) or tree.n == 0:
        return 0.0
    low, high = tree.mins - distance_m, tree.maxes + distance_m
    near = points[np.all((points >= low) & (points <= high), axis=1)]
    distance, _ = tree.query(near, distance_upper_bound=distance_m)
    return float(np.isfinite(distance).sum() / len(points))


def overlap_matrix(clouds: list[Array], world_T_scan: Array) -> Array:
    """Symmetric (n, n) overlaps of scans under ground truth, ones on the diagonal.

    Args:
        clouds: (m_i, 3) thinned points of each scan in its own frame, metres.
        world_T_scan: (n, 4, 4) true poses.
    """
    world = [se3.transform(pose, cloud) for pose, cloud in zip(world_T_scan, clouds, strict=True)]
    trees = [KDTree(points) for points in world]
    matrix = np.eye(len(world))
    for i in range(len(world)):
        for j in range(i + 1, len(world)):
            fewer, more = (i, j) if len(world[i]) <= len(world[j]) else (j, i)
            matrix[i, j] = matrix[j, i] = shared(world[fewer], trees[more])
    return matrix


def overlap_class(value: float) -> str:
    """The name of the class that an overlap 0..1 falls into."""
    return next(name for bound, name in CLASSES if value < bound)
