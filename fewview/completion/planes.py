"""Planar patches as features: position and normal from PCA, a descriptor of how the patch looks."""

from __future__ import annotations

import numpy as np

from fewview.completion.kinds import ScanView
from fewview.config import FeatureConfig
from fewview.types import (
    Array,
    CompletedScan,
    Correspondences,
    FeatureSet,
    FloatArray,
    IntArray,
    PlanarPatch,
    Representation,
    Scales,
)

DESCRIPTOR_SCALE = 0.6
PRIOR_SIMILARITY = 0.5
LAB_SCALE = 40.0
SCALES = Scales(0.30, 0.15, 0.50, 0.50, fixed_point=False)


class Planes:
    """Floor, ceiling, wall and furniture faces; matched when they face alike and look alike."""

    name = "planes"
    representation = Representation.PLANES

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        count = len(view.patches)
        up = view.levelling.level_R_scan[2]
        colours = _mean_colours(view)
        rows = [_descriptor(p, up, c) for p, c in zip(view.patches, colours, strict=True)]
        return FeatureSet(
            self.name,
            self.representation,
            np.array([p.centre for p in view.patches]).reshape(count, 3),
            np.array([p.normal for p in view.patches]).reshape(count, 3),
            np.array(rows, dtype=np.float32).reshape(count, 5),
            np.ones(count, dtype=bool),
            np.ones(count, dtype=np.float32),
        )

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        a, b = source.features[self.name].descriptors, target.features[self.name].descriptors
        squared = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
        similarity = PRIOR_SIMILARITY * np.exp(-squared / (2.0 * DESCRIPTOR_SCALE**2))
        indices: IntArray = np.argwhere(similarity > 0.05).astype(np.int64).reshape(-1, 2)
        weight: FloatArray = similarity[indices[:, 0], indices[:, 1]].astype(np.float32)
        return Correspondences(self.name, indices, weight, SCALES)


def _mean_colours(view: ScanView) -> Array:
    """(patches, 3) mean Lab colour of each patch's surface points."""
    lab, labels = view.surface.colours.astype(np.float64), view.surface.labels
    return np.array([lab[labels == i].mean(axis=0) for i in range(len(view.patches))])


def _descriptor(patch: PlanarPatch, up: Array, lab: Array) -> list[float]:
    """How far it faces up or down (floor 1, wall 0, ceiling -1), its colour and its length."""
    facing = 2.0 * float(patch.normal @ up)
    return [facing, *(lab / LAB_SCALE), 0.3 * float(np.log(patch.extent[0] + 0.1))]
