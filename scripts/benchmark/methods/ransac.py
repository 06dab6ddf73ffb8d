"""RANSAC over FPFH matches (Rusu et al., ICRA 2009), the pair step of Choi et al., CVPR 2015."""

from __future__ import annotations

import open3d as o3d

from benchmark.methods.clouds import (
    VOXEL_M,
    Coarse,
    CoarseToFine,
    View,
    coarse_of,
    fpfh,
    registration,
)
from fewview.types import Frame

DISTANCE_M = 1.5 * VOXEL_M
ITERATIONS = 100_000
CONFIDENCE = 0.999
EDGE_RATIO = 0.9


class Ransac(CoarseToFine):
    """Open3D's implementation with the settings of its global registration tutorial.

    5 cm voxels, mutual matches, three-point samples whose edges agree to 90 %, inliers within
    1.5 voxels, 100 000 iterations.
    """

    def features(
        self, frame: Frame, cloud: o3d.geometry.PointCloud
    ) -> o3d.pipelines.registration.Feature:
        """FPFH of the thinned cloud."""
        return fpfh(cloud)

    def register(self, source: View, target: View) -> Coarse | None:
        """Best three-point sample of the mutual FPFH matches."""
        result = registration.registration_ransac_based_on_feature_matching(
            source.cloud,
            target.cloud,
            source.features,
            target.features,
            True,
            DISTANCE_M,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(EDGE_RATIO),
                registration.CorrespondenceCheckerBasedOnDistance(DISTANCE_M),
            ],
            registration.RANSACConvergenceCriteria(ITERATIONS, CONFIDENCE),
        )
        return coarse_of(result)
