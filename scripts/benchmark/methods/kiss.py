"""KISS-Matcher: fast and robust registration (Lim et al., ICRA 2025)."""

from __future__ import annotations

import os
from functools import cache

import kiss_matcher
import numpy as np
import open3d as o3d

from benchmark.methods.clouds import VOXEL_M, Coarse, CoarseToFine, View, cloud_of
from fewview.geometry import se3
from fewview.types import Array, Frame


class Kiss(CoarseToFine):
    """The authors' matcher with its defaults for 5 cm voxels; it thins its input itself."""

    def features(self, frame: Frame, cloud: o3d.geometry.PointCloud) -> Array:
        """(n, 3) points, twice as dense as the matcher's voxels."""
        return np.asarray(cloud_of(frame, 0.5 * VOXEL_M).points)

    def register(self, source: View, target: View) -> Coarse | None:
        """Faster-PFH, k-core pruning and graduated non-convexity; None when it says invalid."""
        _hold_to_one_thread()
        matcher = kiss_matcher.KISSMatcher(VOXEL_M)
        solution = matcher.estimate(source.features, target.features)
        if not solution.valid:
            return None
        pose = se3.pose(np.asarray(solution.rotation), np.asarray(solution.translation).ravel())
        return pose, int(matcher.get_num_final_inliers())


@cache
def _hold_to_one_thread() -> None:
    """Let the library's thread pool start while one core is visible, so that it stays at one
    thread: with more, sums add up in another order every time. It has no setting for that."""
    cores = os.sched_getaffinity(0)
    points = np.random.default_rng(0).random((200, 3))
    os.sched_setaffinity(0, {min(cores)})
    try:
        kiss_matcher.KISSMatcher(VOXEL_M).estimate(points, points)
    finally:
        os.sched_setaffinity(0, cores)
