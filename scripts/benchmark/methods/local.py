"""Local refinement from a given pose, and any method followed by one (the paper's local table)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import open3d as o3d
import small_gicp

from benchmark.methods.clouds import VOXEL_M, cloud_of, registration
from benchmark.methods.interface import Answer, PairMethod
from benchmark.methods.sparse_icp import sparse_icp, thinned
from fewview.completion import complete
from fewview.config import Config
from fewview.executor import single_threaded_libraries
from fewview.matching.prepared import PreparedScan, prepare
from fewview.refinement.local import refine_alone
from fewview.types import Array, Frame

ICP_DISTANCE_M = 0.2
"""Largest distance of a pair in plain and generalised ICP: the first radius of ours."""
ICP_ITERATIONS = 50


@dataclass(frozen=True)
class Local:
    """``refine`` takes two prepared scans and (K, 4, 4) target_T_source and gives better ones."""

    prepare: Callable[[Frame, int], Any]
    refine: Callable[[Any, Any, Array], Array]


def _each(refine: Callable[[Any, Any, Array], Array]) -> Callable[[Any, Any, Array], Array]:
    """A refinement of one (4, 4) pose as one of several."""

    def refine_all(source: Any, target: Any, poses: Array) -> Array:
        return np.array([refine(source, target, pose) for pose in poses]).reshape(-1, 4, 4)

    return refine_all


class Refined(PairMethod):
    """Every candidate of another method, refined.

    Args:
        base: the method.
        local: key of `LOCALS`.
    """

    def __init__(self, base: PairMethod, local: str) -> None:
        self.base, self.local = base, LOCALS[local]

    def glance(self, frame: Frame) -> Any:
        return self.base.glance(frame)

    def turns(self, glances: Any) -> tuple[int, ...]:
        return self.base.turns(glances)

    def prepare(self, frame: Frame, turn: int = 0) -> Any:
        return self.base.prepare(frame, turn), self.local.prepare(frame, turn)

    def match(self, source: Any, target: Any) -> Answer:
        answer = self.base.match(source[0], target[0])
        poses = np.array([c.target_T_source for c in answer.candidates]).reshape(-1, 4, 4)
        refined = self.local.refine(source[1], target[1], poses)
        return Answer(
            tuple(
                replace(candidate, target_T_source=pose)
                for candidate, pose in zip(answer.candidates, refined, strict=True)
            )
        )


def _cloud(frame: Frame, turn: int) -> o3d.geometry.PointCloud:
    return cloud_of(frame)


def _point_to_plane(
    source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, pose: Array
) -> Array:
    estimation = registration.TransformationEstimationPointToPlane()
    criteria = registration.ICPConvergenceCriteria(max_iteration=ICP_ITERATIONS)
    result = registration.registration_icp(
        source, target, ICP_DISTANCE_M, pose, estimation, criteria
    )
    return np.array(result.transformation)


def _generalised(
    source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, pose: Array
) -> Array:
    result = small_gicp.align(
        np.asarray(target.points),
        np.asarray(source.points),
        init_T_target_source=pose,
        registration_type="GICP",
        downsampling_resolution=VOXEL_M,
        max_correspondence_distance=ICP_DISTANCE_M,
        max_iterations=ICP_ITERATIONS,
    )
    return np.array(result.T_target_source)


def _sparse(source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, pose: Array) -> Array:
    return sparse_icp(thinned(source), np.asarray(target.points), np.asarray(target.normals), pose)


def _completed(frame: Frame, turn: int) -> PreparedScan:
    with single_threaded_libraries():
        return prepare(complete("", frame, turn, Config().features, 0))


def _ours(source: PreparedScan, target: PreparedScan, poses: Array) -> Array:
    with single_threaded_libraries():
        return refine_alone(source, target, poses, Config().refinement)


LOCALS = {
    "icp": Local(_cloud, _each(_point_to_plane)),
    "gicp": Local(_cloud, _each(_generalised)),
    "sparse_icp": Local(_cloud, _each(_sparse)),
    "ours": Local(_completed, _ours),
}
