"""Geometric relations between features of two scans: co-planar, parallel, perpendicular (Sec. 3.3).

A predictor looks at both scans under each candidate pose and gives every pair of features a
probability per relation. The features are the detected planar patches, whose normals are far less
noisy than those of single points. `PatchRelations` reads relations off the pose itself;
`learned_relations` asks the relation network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, CompletedScan, IntArray

ANGLE_SCALE = np.radians(12.0)
OFFSET_SCALE_M = 0.15


@dataclass(frozen=True)
class Relations:
    """Sampled feature pairs of two scans with relation probabilities under K candidate poses.

    Attributes:
        source, target: (m, 3) positions; source_normals, target_normals: (m, 3).
        weight: (m,) how many surface points a pair stands for.
        coplanar, parallel, perpendicular: (K, m) probabilities in 0..1.
    """

    source: Array
    target: Array
    source_normals: Array
    target_normals: Array
    weight: Array
    coplanar: Array
    parallel: Array
    perpendicular: Array


class RelationPredictor(Protocol):
    """Anything that classifies feature pairs of two scans under candidate poses."""

    def predict(
        self, source: CompletedScan, target: CompletedScan, target_T_source: Array
    ) -> Relations:
        """Relations under (K, 4, 4) candidate poses."""


@dataclass(frozen=True)
class PatchPairs:
    """All pairs of a planar patch of one scan and one of another, m in all.

    Attributes:
        source, target: (m,) indices of the patches.
        points, target_points: (m, 3) their centres; normals, target_normals: (m, 3).
        weight: (m,) points of the smaller patch.
    """

    source: IntArray
    target: IntArray
    points: Array
    target_points: Array
    normals: Array
    target_normals: Array
    weight: Array

    @staticmethod
    def of(source: CompletedScan, target: CompletedScan) -> PatchPairs:
        """Those of two scans."""
        sides = [
            (
                np.array([patch.centre for patch in scan.patches]).reshape(-1, 3),
                np.array([patch.normal for patch in scan.patches]).reshape(-1, 3),
                np.array([patch.count for patch in scan.patches], dtype=np.float64),
            )
            for scan in (source, target)
        ]
        (p, n, count), (q, m, other_count) = sides
        i, j = (g.ravel() for g in np.indices((len(p), len(q))))
        return PatchPairs(i, j, p[i], q[j], n[i], m[j], np.minimum(count[i], other_count[j]))

    def related(self, coplanar: Array, parallel: Array, perpendicular: Array) -> Relations:
        """With probabilities (K, m) of their relations."""
        return Relations(
            self.points,
            self.target_points,
            self.normals,
            self.target_normals,
            self.weight,
            coplanar,
            parallel,
            perpendicular,
        )


class PatchRelations:
    """Relations read off the detected planar patches and the candidate pose."""

    def predict(
        self, source: CompletedScan, target: CompletedScan, target_T_source: Array
    ) -> Relations:
        pairs = PatchPairs.of(source, target)
        turned = se3.rotate(target_T_source, pairs.normals)
        gap = se3.transform(target_T_source, pairs.points) - pairs.target_points
        cosine = (turned * pairs.target_normals).sum(axis=-1)
        offsets = [(gap * normals).sum(axis=-1) for normals in (pairs.target_normals, turned)]
        offset = 0.5 * np.abs(offsets).sum(axis=0)
        aligned = _bell(np.arccos(np.clip(cosine, -1.0, 1.0)))
        alike = _bell(np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)))
        coplanar = aligned * np.exp(-0.5 * (offset / OFFSET_SCALE_M) ** 2)
        across = _bell(np.arcsin(np.clip(np.abs(cosine), 0.0, 1.0)))
        return pairs.related(coplanar, alike * (1.0 - coplanar), across)


def _bell(angle: Array) -> Array:
    return np.asarray(np.exp(-0.5 * (angle / ANGLE_SCALE) ** 2))
