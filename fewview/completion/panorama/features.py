"""Places on the completed 360-image as features: edges and things rather than bare walls."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from fewview.completion import room_matches
from fewview.completion.kinds import ScanView, no_features
from fewview.completion.panorama.network import CLASSES
from fewview.completion.panorama.ring import ring_points
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.types import (
    CompletedPanorama,
    CompletedScan,
    Correspondences,
    FeatureSet,
    FloatArray,
    Representation,
    Scales,
)

STEP = 4
MAX_FEATURES = 320
MAX_CORRESPONDENCES = 600
SHELL = [CLASSES.index(name) for name in ("wall", "floor", "ceiling")]
SCALES = Scales(0.115, 1.20, 0.56, 0.10, fixed_point=False)
"""Learned in phase two (docs/training.md), as those of the other completed kinds."""


class Panorama:
    """A regular selection of the ring's pixels, the most distinctive of them."""

    name = "panorama"
    representation = Representation.PANORAMA

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        panorama = view.room.panorama
        if panorama is None:
            return no_features(self)
        at = chosen_pixels(panorama)
        scan_T_level = se3.inverse(panorama.level_T_scan)
        return FeatureSet(
            self.name,
            self.representation,
            se3.transform(scan_T_level, ring_points(panorama.depth)[at].astype(np.float64)),
            se3.rotate(scan_T_level, panorama.normals[at].astype(np.float64)),
            room_matches.described(panorama.descriptors[at], panorama.semantics[at]),
            panorama.observed[at],
            panorama.confidence[at].astype(np.float32),
        )

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        return room_matches.correspond(self, source, target, SCALES, MAX_CORRESPONDENCES)


def chosen_pixels(panorama: CompletedPanorama) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of `MAX_FEATURES` pixels, distinctive and sure ones of every `STEP`-th."""
    score = distinctiveness(panorama) * np.sqrt(panorama.confidence)
    score = score[STEP // 2 :: STEP, STEP // 2 :: STEP]
    best = np.sort(np.argsort(-score, axis=None, kind="stable")[:MAX_FEATURES])
    rows, columns = np.unravel_index(best, score.shape)
    return STEP // 2 + STEP * rows, STEP // 2 + STEP * columns


def distinctiveness(panorama: CompletedPanorama) -> FloatArray:
    """(S, 4 S) how far from bare a pixel's surroundings are: things, doors and windows, and edges,
    where normals and classes differ; 0 inside a wall."""
    bare = panorama.semantics[..., SHELL].sum(axis=-1)
    marks = np.concatenate([panorama.normals, panorama.semantics], axis=-1)
    size = (STEP + 1, STEP + 1, 1)
    mean = ndimage.uniform_filter(marks, size, mode=("nearest", "wrap", "nearest"))
    spread = ndimage.uniform_filter(marks**2, size, mode=("nearest", "wrap", "nearest")) - mean**2
    return np.asarray(1.0 - bare + spread.sum(axis=-1), dtype=np.float32)
