"""Learned keypoints: XFeat (Potje et al., CVPR 2024) matched by LighterGlue, lifted by depth."""

from __future__ import annotations

import open3d as o3d

from benchmark.methods import keypoints
from benchmark.methods.clouds import Coarse, CoarseToFine, View
from fewview.types import Frame


class XFeat(CoarseToFine):
    """1024 keypoints, LighterGlue, RANSAC over three-point Kabsch fits at 5 cm.

    Images are taken as they are, without turning them upright.
    """

    def features(self, frame: Frame, cloud: o3d.geometry.PointCloud) -> keypoints.Keypoints:
        """Keypoints with depth."""
        return keypoints.xfeat(frame)

    def register(self, source: View, target: View) -> Coarse | None:
        """Pose with the most matches within 5 cm, refitted to them."""
        return keypoints.pose_of(keypoints.lighterglue(source.features, target.features))
