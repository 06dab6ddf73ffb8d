"""Geometric relations between features of two scans: co-planar, parallel, perpendicular (Sec. 3.3).

A predictor looks at both scans under each candidate pose and gives every sampled feature pair a
probability per relation. `PatchRelations` takes the detected planar patches as features; a learned
predictor offers the same interface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, CompletedScan

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


class PatchRelations:
    """Relations read off the detected planar patches and the candidate pose."""

    def predict(
        self, source: CompletedScan, target: CompletedScan, target_T_source: Array
    ) -> Relations:
        a, b = source.patches, target.patches
        i, j = (g.ravel() for g in np.meshgrid(np.arange(len(a)), np.arange(len(b)), indexing="ij"))
        p = np.array([x.centre for x in a]).reshape(-1, 3)[i]
        q = np.array([x.centre for x in b]).reshape(-1, 3)[j]
        n = np.array([x.normal for x in a]).reshape(-1, 3)[i]
        m = np.array([x.normal for x in b]).reshape(-1, 3)[j]
        count_a = np.array([x.count for x in a], dtype=np.float64)[i]
        count_b = np.array([x.count for x in b], dtype=np.float64)[j]
        turned = se3.rotate(target_T_source, n)
        gap = se3.transform(target_T_source, p) - q
        cosine = (turned * m).sum(axis=-1)
        offset = 0.5 * (np.abs((gap * m).sum(axis=-1)) + np.abs((gap * turned).sum(axis=-1)))
        aligned = _bell(np.arccos(np.clip(cosine, -1.0, 1.0)))
        alike = _bell(np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)))
        coplanar = aligned * np.exp(-0.5 * (offset / OFFSET_SCALE_M) ** 2)
        return Relations(
            p,
            q,
            n,
            m,
            np.minimum(count_a, count_b),
            coplanar,
            alike * (1.0 - coplanar),
            _bell(np.arcsin(np.clip(np.abs(cosine), 0.0, 1.0))),
        )


def _bell(angle: Array) -> Array:
    return np.asarray(np.exp(-0.5 * (angle / ANGLE_SCALE) ** 2))
