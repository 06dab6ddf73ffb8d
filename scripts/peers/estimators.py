"""Pair estimators behind one signature: prepare each frame once, then match two of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import kiss_matcher
import numpy as np
import open3d as o3d

from fewview.types import Array, Frame
from peers import keypoints
from peers.clouds import VOXEL_M, cloud_of, fpfh, registration

Coarse = tuple[Array, int]
"""target_T_source and the number of inliers behind it."""


@dataclass(frozen=True)
class View:
    """A frame prepared for one estimator: its thinned cloud and the estimator's features."""

    cloud: o3d.geometry.PointCloud
    features: Any


@dataclass(frozen=True)
class Estimator:
    """``features`` of a frame and its cloud; ``match`` returns None where it finds no pose."""

    features: Callable[[Frame, o3d.geometry.PointCloud], Any]
    match: Callable[[View, View], Coarse | None]

    def prepare(self, frame: Frame) -> View:
        """Do everything that concerns one frame alone."""
        cloud = cloud_of(frame)
        return View(cloud, self.features(frame, cloud))


def _ransac(source: View, target: View) -> Coarse | None:
    distance = 1.5 * VOXEL_M
    result = registration.registration_ransac_based_on_feature_matching(
        source.cloud,
        target.cloud,
        source.features,
        target.features,
        True,
        distance,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(distance),
        ],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )
    return _coarse(result)


def _fgr(source: View, target: View) -> Coarse | None:
    option = registration.FastGlobalRegistrationOption(
        use_absolute_scale=True, maximum_correspondence_distance=1.4 * VOXEL_M
    )
    result = registration.registration_fgr_based_on_feature_matching(
        source.cloud, target.cloud, source.features, target.features, option
    )
    return _coarse(result)


def _coarse(result: o3d.pipelines.registration.RegistrationResult) -> Coarse | None:
    inliers = len(result.correspondence_set)
    return (np.array(result.transformation), inliers) if inliers >= 3 else None


def _kiss(source: View, target: View) -> Coarse | None:
    matcher = kiss_matcher.KISSMatcher(VOXEL_M)
    solution = matcher.estimate(source.features, target.features)
    if not solution.valid:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = solution.rotation, solution.translation
    return pose, int(matcher.get_num_final_inliers())


def _kiss_points(frame: Frame, cloud: o3d.geometry.PointCloud) -> Array:
    return np.asarray(cloud_of(frame, 0.5 * VOXEL_M).points)


def _fpfh_of(frame: Frame, cloud: o3d.geometry.PointCloud) -> o3d.pipelines.registration.Feature:
    return fpfh(cloud)


def _xfeat_of(frame: Frame, cloud: o3d.geometry.PointCloud) -> keypoints.Keypoints:
    return keypoints.xfeat(frame)


def _xfeat(source: View, target: View) -> Coarse | None:
    return keypoints.pose_of(keypoints.lighterglue(source.features, target.features))


ESTIMATORS = {
    "xfeat": Estimator(_xfeat_of, _xfeat),
    "ransac": Estimator(_fpfh_of, _ransac),
    "fgr": Estimator(_fpfh_of, _fgr),
    "kiss": Estimator(_kiss_points, _kiss),
}
