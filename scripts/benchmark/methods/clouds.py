"""Open3D clouds of frames, FPFH, and the two-stage ICP that most pair methods end with."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d

from benchmark.methods.interface import Answer, Candidate, PairMethod
from fewview.geometry import camera
from fewview.types import Array, Frame

registration = o3d.pipelines.registration
o3d.utility.set_max_threads(1)  # else RANSAC draws, and sums add up, in the order of the threads
o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)

VOXEL_M = 0.05
MAX_DEPTH_M = 6.0
ICP_DISTANCES_M = (0.10, 0.05)
MIN_POINTS = 30
"""A scan with fewer thinned points is answered with nothing."""

Coarse = tuple[Array, int]
"""target_T_source and the number of inliers behind it."""


@dataclass(frozen=True)
class View:
    """A frame prepared for one method: its thinned cloud and the method's features."""

    cloud: o3d.geometry.PointCloud
    features: Any


class CoarseToFine(PairMethod):
    """A method that finds a coarse pose by its features and refines it by ICP on the clouds.

    Args:
        icp: refine the pose; otherwise it stays what the registration itself found.
    """

    def __init__(self, icp: bool = True) -> None:
        self.icp = icp

    @abstractmethod
    def features(self, frame: Frame, cloud: o3d.geometry.PointCloud) -> Any:
        """What the method needs of one frame besides its cloud."""

    @abstractmethod
    def register(self, source: View, target: View) -> Coarse | None:
        """The coarse pose, or None where there is none."""

    def prepare(self, frame: Frame, turn: int = 0) -> View | None:
        """The frame's cloud and features; None when next to no depth was measured."""
        cloud = cloud_of(frame)
        if len(cloud.points) < MIN_POINTS:
            return None
        return View(cloud, self.features(frame, cloud))

    def match(self, source: View | None, target: View | None) -> Answer:
        """At most one candidate; its score is the number of inliers of the coarse pose."""
        if source is None or target is None:
            return Answer()
        o3d.utility.random.seed(0)
        coarse = self.register(source, target)
        if coarse is None:
            return Answer()
        finish = refine if self.icp else assess
        candidate = finish(source.cloud, target.cloud, *coarse)
        return Answer() if candidate is None else Answer((candidate,))


def cloud_of(frame: Frame, voxel_m: float = VOXEL_M) -> o3d.geometry.PointCloud:
    """Thinned points of a frame with normals towards the camera."""
    points = camera.backproject(frame.depth, frame.intrinsics)
    kept = points[(frame.depth > 0) & (frame.depth < MAX_DEPTH_M)]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(kept.astype(np.float64)))
    cloud = cloud.voxel_down_sample(voxel_m)
    if cloud.is_empty():
        return cloud
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2.0 * voxel_m, 30))
    cloud.orient_normals_towards_camera_location()
    return cloud


def fpfh(cloud: o3d.geometry.PointCloud) -> o3d.pipelines.registration.Feature:
    """FPFH descriptors with Open3D's customary radius of five voxels."""
    search = o3d.geometry.KDTreeSearchParamHybrid(5.0 * VOXEL_M, 100)
    return registration.compute_fpfh_feature(cloud, search)


def coarse_of(result: o3d.pipelines.registration.RegistrationResult) -> Coarse | None:
    """What Open3D's global registration found; None for fewer than three inliers."""
    inliers = len(result.correspondence_set)
    return (np.array(result.transformation), inliers) if inliers >= 3 else None


def refine(
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    coarse: Array,
    score: float,
) -> Candidate | None:
    """Two-stage point-to-plane ICP; None when the clouds do not touch afterwards."""
    pose = coarse
    for distance in ICP_DISTANCES_M:
        estimation = registration.TransformationEstimationPointToPlane()
        result = registration.registration_icp(source, target, distance, pose, estimation)
        pose = result.transformation
    candidate = assess(source, target, np.array(pose), score)
    return candidate if candidate.overlap else None


def assess(
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    target_T_source: Array,
    score: float,
) -> Candidate:
    """A pose with the overlap and the information matrix that pose graphs ask for."""
    information = registration.get_information_matrix_from_point_clouds(
        source, target, ICP_DISTANCES_M[-1], target_T_source
    )
    overlap = information[5, 5] / min(len(source.points), len(target.points))
    return Candidate(
        target_T_source, float(score), overlap=float(overlap), information=np.array(information)
    )
