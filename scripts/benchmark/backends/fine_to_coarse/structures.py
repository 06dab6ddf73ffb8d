"""The structural model: frames' planes clustered into structures, and how these stand together.

After Halber and Funkhouser 2017; tolerances are defaults of the authors' program, `fetregister`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from benchmark.backends.fine_to_coarse.views import View
from fewview.geometry import se3
from fewview.types import Array, IntArray

MAX_CENTROID_DISTANCE_M = 256.0
MAX_PLANE_DISTANCE_M = 0.15
"""Half of what the program's clusters allow: at 0.3 m a cupboard and the wall behind it become one
plane, and on generated validation rooms true motions are pulled apart half as far again."""
MAX_NORMAL_ANGLE = np.pi / 8.0
MIN_AFFINITY = 1e-6
RELATION_SIGMA = np.radians(7.5)
MIN_RELATION_SCORE = 0.1


@dataclass(frozen=True)
class Planes:
    """The planes of all frames, or clusters of them, under the current poses.

    Attributes:
        centres: (p, 3) in the world.
        normals: (p, 3) unit, towards the cameras.
        counts: (p,) points on each.
        first: (p,) arc length of the trajectory, metres, at the earliest frame that sees it.
        last: (p,) likewise at the latest.
    """

    centres: Array
    normals: Array
    counts: Array
    first: Array
    last: Array

    def __getitem__(self, rows: IntArray) -> Planes:
        """Some of them."""
        return Planes(*(values[rows] for values in vars(self).values()))


@dataclass(frozen=True)
class Relation:
    """Two structures that are parallel (cosine 1), antiparallel (-1) or perpendicular (0)."""

    a: int
    b: int
    cosine: int
    score: float


def planes_of(views: Sequence[View], poses: Array, arc: Array) -> Planes:
    """Every frame's planes in the world, frame by frame; arc (n,) metres."""
    where = np.repeat(arc, [len(view.planes) for view in views])
    centres = [se3.transform(p, v.members.mean(axis=1)) for v, p in zip(views, poses, strict=True)]
    normals = [se3.rotate(p, v.planes) for v, p in zip(views, poses, strict=True)]
    counts = np.concatenate([view.counts for view in views]).astype(np.float64)
    return Planes(np.concatenate(centres), np.concatenate(normals), counts, where, where)


def cluster(planes: Planes, window_m: float) -> tuple[Planes, IntArray]:
    """Merge the most affine two planes again and again, within windows of the trajectory.

    Args:
        planes: of all frames.
        window_m: the planes of a cluster are seen within this length of the trajectory.

    Returns:
        structures of two planes or more, and (p,) each plane's structure, -1 for none.
    """
    values = Planes(*(array.copy() for array in vars(planes).values()))
    owner = np.arange(len(planes.counts))
    affinity = np.array([_affinities(values, int(i), window_m) for i in owner])
    affinity = affinity.reshape(len(owner), len(owner))
    while affinity.size and affinity.max() > MIN_AFFINITY:
        keep, gone = sorted(np.unravel_index(affinity.argmax(), affinity.shape))
        _merge(values, int(keep), int(gone))
        owner[owner == gone] = keep
        affinity[gone] = affinity[:, gone] = 0.0
        fresh = _affinities(values, int(keep), window_m)
        affinity[keep] = affinity[:, keep] = np.where(owner == np.arange(len(owner)), fresh, 0.0)
    return _structures(values, owner)


def relations(structures: Planes, window_m: float) -> list[Relation]:
    """Parallel, antiparallel and perpendicular structures within two windows of each other."""
    found: list[Relation] = []
    for a, b in combinations(range(len(structures.counts)), 2):
        span = max(structures.last[a], structures.last[b]) - min(
            structures.first[a], structures.first[b]
        )
        if span >= 2.0 * window_m + 0.1:
            continue
        angle = np.arccos(np.clip(structures.normals[a] @ structures.normals[b], -1.0, 1.0))
        for cosine, ideal in ((1, 0.0), (0, 0.5 * np.pi), (-1, np.pi)):
            score = float(np.exp(-0.5 * ((angle - ideal) / RELATION_SIGMA) ** 2))
            if score > MIN_RELATION_SCORE:
                found.append(Relation(a, b, cosine, score))
    return found


def _affinities(planes: Planes, i: int, window_m: float) -> Array:
    """(p,) affinity of plane i to all, 0 to itself: a product of one factor a tolerance."""
    offset = planes.centres - planes.centres[i]
    cosine = np.clip(planes.normals @ planes.normals[i], -1.0, 1.0)
    factors = (
        1.0 - np.linalg.norm(offset, axis=1) / MAX_CENTROID_DISTANCE_M,
        1.0 - np.abs(offset @ planes.normals[i]) / MAX_PLANE_DISTANCE_M,
        1.0 - np.abs(np.einsum("pi,pi->p", offset, planes.normals)) / MAX_PLANE_DISTANCE_M,
        1.0 - np.arccos(cosine) / MAX_NORMAL_ANGLE,
    )
    span = np.maximum(planes.last, planes.last[i]) - np.minimum(planes.first, planes.first[i])
    affinity = np.prod(np.maximum(factors, 0.0), axis=0) * (span < window_m)
    affinity[i] = 0.0
    return np.asarray(affinity)


def _merge(planes: Planes, keep: int, gone: int) -> None:
    rows = [keep, gone]
    weights = planes.counts[rows] / planes.counts[rows].sum()
    normal = weights @ planes.normals[rows]
    planes.centres[keep] = weights @ planes.centres[rows]
    planes.normals[keep] = normal / np.linalg.norm(normal)
    planes.counts[keep] = planes.counts[rows].sum()
    planes.first[keep] = planes.first[rows].min()
    planes.last[keep] = planes.last[rows].max()


def _structures(planes: Planes, owner: IntArray) -> tuple[Planes, IntArray]:
    representatives, children = np.unique(owner, return_counts=True)
    shared = representatives[children > 1]
    index = np.full(len(owner), -1, dtype=np.int64)
    index[shared] = np.arange(len(shared))
    return planes[shared], index[owner]
