"""SIFT keypoints of the visible part (Sec. 3.2) with RootSIFT descriptors."""

from __future__ import annotations

import cv2
import numpy as np

from fewview.completion.kinds import ScanView, keypoint_features, no_correspondences
from fewview.config import FeatureConfig
from fewview.types import (
    CompletedScan,
    Correspondences,
    FeatureSet,
    FloatArray,
    Representation,
    Scales,
)

MAX_RATIO = 0.9
DESCRIPTOR_SCALE = 0.5
SCALES = Scales(0.05, 0.30, 0.30, 0.02)


class Sift:
    """SIFT keypoints; rotation invariant, so images need no turning."""

    name = "sift"
    representation = Representation.KEYPOINTS

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        grey = cv2.cvtColor(view.frame.colour, cv2.COLOR_RGB2GRAY)
        found, raw = cv2.SIFT_create(config.max_sift).detectAndCompute(grey, None)
        pixels = np.array([k.pt for k in found], dtype=np.float32).reshape(-1, 2)
        raw = np.zeros((0, 128), np.float32) if raw is None else raw
        root = np.sqrt(raw / np.maximum(raw.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)
        certain = np.ones(len(pixels), dtype=np.float32)
        return keypoint_features(self, view, pixels, root, certain, config, len(pixels))

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        a, b = source.features[self.name], target.features[self.name]
        if len(a) < 2 or len(b) < 2:
            return no_correspondences(self, SCALES)
        similarity = a.descriptors @ b.descriptors.T
        best = similarity.argmax(axis=1)
        rows = np.arange(len(a))
        mutual = similarity.argmax(axis=0)[best] == rows
        distance = _second_ratio(similarity)
        keep = np.flatnonzero(mutual & (distance < MAX_RATIO))
        squared = 2.0 - 2.0 * similarity[keep, best[keep]]
        weight = np.exp(-squared / (2.0 * DESCRIPTOR_SCALE**2)).astype(np.float32)
        return Correspondences(self.name, np.stack([keep, best[keep]], axis=1), weight, SCALES)


def _second_ratio(similarity: FloatArray) -> FloatArray:
    """Lowe's ratio: distance to the best over distance to the second best match."""
    top = -np.partition(-similarity, 1, axis=1)[:, :2]
    distance = np.sqrt(np.maximum(2.0 - 2.0 * top, 1e-9))
    return np.asarray(distance[:, 0] / distance[:, 1])
