"""Closest points between the frames of a window, and which of them are rejected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.backends.fine_to_coarse.views import View
from fewview.geometry import se3
from fewview.types import Array, IntArray

DISTANCE_M = (0.2, 0.5)
ANGLE = (0.35, 0.5)
"""Rejection of closest points, for frames beside each other and half a window apart."""
ANGLE_PENALTY = 0.36
MAX_Z_SCORE = 6.0
OUTLIER_ROUNDS = 8


@dataclass(frozen=True)
class PointPairs:
    """Points of frames and their closest points in other frames, each in its frame.

    Attributes:
        frames: (n,) whose points asked.
        points: (n, 3) metres.
        other_frames: (n,) that answered.
        other_points: (n, 3) metres.
        other_normals: (n, 3) unit.
        distances: (n,) metres.
        affinity: (n,) 0..1.
    """

    frames: IntArray
    points: Array
    other_frames: IntArray
    other_points: Array
    other_normals: Array
    distances: Array
    affinity: Array


_NO_INDEX, _NO_POINT, _NO_VALUE = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0)
_NONE = PointPairs(_NO_INDEX, _NO_POINT, _NO_INDEX, _NO_POINT, _NO_POINT, _NO_VALUE, _NO_VALUE)


def closest_points(views: Sequence[View], poses: Array, arc: Array, window_m: float) -> PointPairs:
    """Points of every frame and their closest in each frame of the window around it.

    A pair of frames may be further apart, in metres and in angle, the further it is apart along
    the trajectory; as windows grow the same pair is judged more strictly.

    Args:
        views: of the frames.
        poses: (n, 4, 4) current world_T_scan.
        arc: (n,) metres along the trajectory.
        window_m: length of the window.
    """
    found = []
    for i in range(len(views)):
        share = np.abs(arc - arc[i]) / (0.5 * window_m)
        others = [int(j) for j in np.flatnonzero(share < 1.0) if j != i]
        around = [_asked(views, poses, i, j, float(np.sqrt(share[j]))) for j in others]
        found.append(_without_outliers(_joined(around)))
    return _joined(found)


def _asked(views: Sequence[View], poses: Array, i: int, j: int, share: float) -> PointPairs:
    """Where frame j answers frame i; share 0..1 goes from the strict limits to the lenient."""
    distance, angle = (low + share * (high - low) for low, high in (DISTANCE_M, ANGLE))
    view, other = views[i], views[j]
    j_T_i = se3.inverse(poses[j]) @ poses[i]
    points = se3.transform(j_T_i, view.points[view.queries])
    gaps, nearest = other.tree.query(points, distance_upper_bound=distance)
    met = np.flatnonzero(np.isfinite(gaps))
    met = met[other.inner[nearest[met]]]
    nearest, queries = nearest[met], view.queries[met]
    normals = se3.rotate(j_T_i, view.normals[queries])
    cosine = np.einsum("ni,ni->n", normals, other.normals[nearest])
    turned = np.arccos(np.clip(cosine, -1.0, 1.0)) / angle
    keep = turned < 1.0
    queries, nearest = queries[keep], nearest[keep]
    return PointPairs(
        np.full(len(queries), i),
        view.points[queries],
        np.full(len(queries), j),
        other.points[nearest],
        other.normals[nearest],
        gaps[met][keep],
        1.0 - ANGLE_PENALTY * turned[keep],
    )


def _without_outliers(pairs: PointPairs) -> PointPairs:
    """Drop what is further than mean and `MAX_Z_SCORE` deviations, until nothing is."""
    kept = np.arange(len(pairs.distances))
    for _ in range(OUTLIER_ROUNDS):
        distances = pairs.distances[kept]
        if not len(kept):
            break
        kept = kept[distances <= distances.mean() + MAX_Z_SCORE * distances.std()]
    return PointPairs(*(values[kept] for values in vars(pairs).values()))


def _joined(parts: Sequence[PointPairs]) -> PointPairs:
    columns = zip(*(vars(part).values() for part in (_NONE, *parts)), strict=True)
    return PointPairs(*(np.concatenate(column) for column in columns))
