"""RobustGR: Fast Global Registration on FPFH matches (Zhou, Park and Koltun, ECCV 2016)."""

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


class FGR(CoarseToFine):
    """Open3D's implementation on 5 cm voxels, correspondences within 1.4 voxels, metric scale.

    The paper's row RobustGR is the registration alone (``icp=False``).
    """

    def features(
        self, frame: Frame, cloud: o3d.geometry.PointCloud
    ) -> o3d.pipelines.registration.Feature:
        """FPFH of the thinned cloud."""
        return fpfh(cloud)

    def register(self, source: View, target: View) -> Coarse | None:
        """Line-process registration over the mutual FPFH matches."""
        option = registration.FastGlobalRegistrationOption(
            use_absolute_scale=True, maximum_correspondence_distance=1.4 * VOXEL_M
        )
        result = registration.registration_fgr_based_on_feature_matching(
            source.cloud, target.cloud, source.features, target.features, option
        )
        return coarse_of(result)
