"""Open3D clouds of frames, FPFH, and the two-stage ICP that every pair estimator ends with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from fewview.geometry import camera
from fewview.types import Array, Frame

registration = o3d.pipelines.registration

VOXEL_M = 0.05
MAX_DEPTH_M = 6.0
ICP_DISTANCES_M = (0.10, 0.05)


@dataclass(frozen=True)
class Edge:
    """A refined relative pose.

    Attributes:
        target_T_source: (4, 4).
        support: inliers behind the coarse pose.
        overlap: share of the smaller cloud that found a neighbour.
        information: (6, 6) as Open3D's pose graph wants it.
    """

    target_T_source: Array
    support: int
    overlap: float
    information: Array


def cloud_of(frame: Frame, voxel_m: float = VOXEL_M) -> o3d.geometry.PointCloud:
    """Thinned points of a frame with normals towards the camera."""
    points = camera.backproject(frame.depth, frame.intrinsics)
    kept = points[(frame.depth > 0) & (frame.depth < MAX_DEPTH_M)]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(kept.astype(np.float64)))
    cloud = cloud.voxel_down_sample(voxel_m)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2.0 * voxel_m, 30))
    cloud.orient_normals_towards_camera_location()
    return cloud


def fpfh(cloud: o3d.geometry.PointCloud) -> o3d.pipelines.registration.Feature:
    """FPFH descriptors with Open3D's customary radius of five voxels."""
    search = o3d.geometry.KDTreeSearchParamHybrid(5.0 * VOXEL_M, 100)
    return registration.compute_fpfh_feature(cloud, search)


def refine(
    source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, coarse: Array, support: int
) -> Edge | None:
    """Two-stage point-to-plane ICP; None when the clouds do not touch afterwards."""
    pose = coarse
    for distance in ICP_DISTANCES_M:
        estimation = registration.TransformationEstimationPointToPlane()
        result = registration.registration_icp(source, target, distance, pose, estimation)
        pose = result.transformation
    information = registration.get_information_matrix_from_point_clouds(
        source, target, ICP_DISTANCES_M[-1], pose
    )
    overlap = information[5, 5] / min(len(source.points), len(target.points))
    if overlap <= 0.0:
        return None
    return Edge(np.array(pose), support, float(overlap), np.array(information))
