"""How much two scans share under ground truth, and the classes results are split by."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from fewview.geometry import se3
from fewview.types import Array

Json = dict[str, Any]
NEIGHBOUR_M = 0.05
"""A point is shared when the other scan has one within this distance."""
THIN_M = 0.01
"""Voxel to which a scan is thinned before others look for neighbours in it."""
SAMPLES = 5000
"""Points of a scan, evenly spread over its pixels, that stand for all: at most 0.7 % deviation."""
CLASSES = (
    (0.01, "< 1 %"),
    (0.1, "1-10 %"),
    (0.3, "10-30 %"),
    (0.5, "30-50 %"),
    (np.inf, ">= 50 %"),
)
"""Upper bounds (exclusive) and names of the overlap classes."""


def thin(points: Array, voxel_m: float) -> Array:
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


def overlap_matrix(clouds: Iterable[Array], world_T_scan: Array) -> Array:
    """Symmetric (n, n) overlaps of scans under ground truth, ones on the diagonal.

    As `overlap`, but fast: `SAMPLES` points of the scan with fewer points look for a neighbour
    in the other one thinned to `THIN_M`.

    Args:
        clouds: (m_i, 3) points of each scan in its own frame, metres; taken one at a time.
        world_T_scan: (n, 4, 4) true poses.
    """
    counts, samples, trees = [], [], []
    for pose, cloud in zip(world_T_scan, clouds, strict=True):
        world = se3.transform(pose, cloud)
        counts.append(len(world))
        samples.append(world[:: max(1, len(world) // SAMPLES)])
        trees.append(KDTree(thin(world, THIN_M)))
    matrix = np.eye(len(trees))
    for i in range(len(trees)):
        for j in range(i + 1, len(trees)):
            fewer, more = (i, j) if counts[i] <= counts[j] else (j, i)
            matrix[i, j] = matrix[j, i] = shared(samples[fewer], trees[more])
    return matrix


def overlap_class(value: float) -> str:
    """The name of the class that an overlap 0..1 falls into."""
    return next(name for bound, name in CLASSES if value < bound)


def by_class(rows: Sequence[Json]) -> dict[str, list[Json]]:
    """Rows by the class of their ``overlap``, lowest first; classes without rows are left out."""
    members = {
        name: [row for row in rows if overlap_class(row["overlap"]) == name] for _, name in CLASSES
    }
    return {name: found for name, found in members.items() if found}
