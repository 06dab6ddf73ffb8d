"""Correspondences between the completed rooms of two levelled scans.

Levelling leaves a yaw and a shift unknown: features of one place have the same height over the
floor and the same inclination in both scans. What is left is for their descriptors to say.
"""

from __future__ import annotations

import numpy as np

from fewview.completion.kinds import FeatureKind, no_correspondences
from fewview.types import (
    Array,
    BoolArray,
    CompletedScan,
    Correspondences,
    FeatureSet,
    FloatArray,
    Scales,
)

DESCRIPTOR_SCALE = 0.45
SEMANTIC_WEIGHT = 0.5
HEIGHT_M = 0.3
HEIGHT_WITHOUT_FLOOR_M = 0.5
INCLINATION = 0.35
BEST = 6


def described(descriptors: FloatArray, probabilities: FloatArray) -> FloatArray:
    """Descriptors (n, d + c) whose distance holds how alike two features are and are called.

    The second part of the squared distance is Hellinger's between the class probabilities.

    Args:
        descriptors: (n, d) unit.
        probabilities: (n, c) of the classes.
    """
    semantic = SEMANTIC_WEIGHT * np.sqrt(probabilities)
    return np.concatenate([descriptors, semantic], axis=1).astype(np.float32)


def correspond(
    kind: FeatureKind, source: CompletedScan, target: CompletedScan, scales: Scales, limit: int
) -> Correspondences:
    """The `BEST` matches of each feature that levelling allows, at most ``limit``.

    The similarity s_c is that of the descriptors times the mean confidence of both features. At
    least one of the two is predicted: what both scans saw is for the observed kinds to match, and
    between scans of different places it would outweigh all that is right.
    """
    a, b = source.features[kind.name], target.features[kind.name]
    if not (len(a) and len(b)):
        return no_correspondences(kind, scales)
    squared = _squared_distance(a.descriptors, b.descriptors)
    similarity = np.exp(-squared / (2.0 * DESCRIPTOR_SCALE**2))
    similarity *= np.sqrt(a.confidence[:, None] * b.confidence[None])
    similarity *= ~(a.observed[:, None] & b.observed[None])
    similarity *= _alike_when_levelled(source, target, a, b)
    kept = np.argwhere(_among_best(similarity, 0) & _among_best(similarity, 1))
    weight = similarity[kept[:, 0], kept[:, 1]].astype(np.float32)
    order = np.argsort(-weight, kind="stable")[:limit]
    return Correspondences(kind.name, kept[order].astype(np.int64), weight[order], scales)


def floor_height(scan: CompletedScan) -> float | None:
    """Height of the floor in the scan's level frame, camera at 0, seen or else predicted."""
    if scan.levelling.floor_z is not None:
        return scan.levelling.floor_z
    if scan.room.layout is not None:
        return scan.room.layout.floor_z
    if scan.room.planes is not None:
        return float(scan.room.planes.planes[0].centre[2])
    return None


def _squared_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    squared = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None] - 2.0 * (a @ b.T)
    return np.asarray(np.maximum(squared, 0.0))


def _alike_when_levelled(
    source: CompletedScan, target: CompletedScan, a: FeatureSet, b: FeatureSet
) -> BoolArray:
    """(n, m) which features stand at one height and, where normals are known, lean alike."""
    (height_a, lean_a), (height_b, lean_b) = _levelled(source, a), _levelled(target, b)
    floors = floor_height(source), floor_height(target)
    if floors[0] is None or floors[1] is None:
        tolerance = HEIGHT_WITHOUT_FLOOR_M
    else:
        tolerance, height_a, height_b = HEIGHT_M, height_a - floors[0], height_b - floors[1]
    alike = np.abs(height_a[:, None] - height_b[None]) < tolerance
    return np.asarray(alike & ~(np.abs(lean_a[:, None] - lean_b[None]) > INCLINATION))


def _levelled(scan: CompletedScan, features: FeatureSet) -> tuple[Array, Array]:
    """(n,) heights over the camera, and (n,) cosines of normals with up, NaN where unknown."""
    up = scan.levelling.level_R_scan[2]
    known = features.normals.any(axis=1)
    return features.positions @ up, np.where(known, features.normals @ up, np.nan)


def _among_best(similarity: FloatArray, axis: int) -> BoolArray:
    """Which entries are positive and among the `BEST` along an axis."""
    place = max(0, similarity.shape[axis] - BEST)
    bar = np.partition(similarity, place, axis=axis).take([place], axis=axis)
    return np.asarray((similarity >= bar) & (similarity > 0.0))
