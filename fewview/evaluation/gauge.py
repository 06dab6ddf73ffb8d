"""Errors of absolute poses: one gauge alignment, then scan by scan (the few-view protocol)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fewview.evaluation.metrics import (
    orthonormal,
    relative,
    rotation_error_deg,
    translation_error_m,
    within,
)
from fewview.geometry import se3
from fewview.types import Array, BoolArray


@dataclass(frozen=True)
class AbsoluteErrors:
    """Errors of n scans in one frame.

    Attributes:
        rotation_deg: (n,) geodesic angles.
        translation_m: (n,) distances between camera centres.
        placed: (n,) False where the pose was counted as identity.
        agreeing: (n,) scans of the largest group that is right relative to one of its members;
            unlike the errors it is not dragged along by scans that are wrong.
        truth_T_world: (4, 4) the gauge: maps the frame of the estimates into that of the truth.
    """

    rotation_deg: Array
    translation_m: Array
    placed: BoolArray
    agreeing: BoolArray
    truth_T_world: Array

    @property
    def right(self) -> BoolArray:
        """(n,) scans within 15 degrees and 0.3 m."""
        return within(self.rotation_deg, self.translation_m)


def align(truth: Array, estimate: Array) -> Array:
    """The motion truth_T_world that carries (n, 4, 4) estimates to (n, 4, 4) true poses.

    Rotation: the chordal mean of R_gt R_est^T. Translation: the mean of t_gt - R t_est.
    """
    spread = truth[:, :3, :3] @ np.swapaxes(estimate[:, :3, :3], -1, -2)
    rotation = se3.nearest_rotation(spread.sum(axis=0))
    translation = (truth[:, :3, 3] - estimate[:, :3, 3] @ rotation.T).mean(axis=0)
    return se3.pose(rotation, translation)


def absolute_errors(truth: Array, estimate: Sequence[Array | None]) -> AbsoluteErrors:
    """Score the world_T_scan of one component; None stands for a scan that is not part of it.

    Only placed scans define the gauge. The frame in which the others count as identity is that
    of the first placed scan, so they count as standing where it stands, whatever world a method
    chose: a change of either world frame changes nothing. Fewer than two placed scans are an
    answer to nothing: then every scan counts as identity and all of them define the gauge.

    Args:
        truth: (n, 4, 4) camera-to-world poses.
        estimate: n poses, camera to the component's world.
    """
    truth = orthonormal(truth)
    placed = np.array([pose is not None for pose in estimate])
    if placed.sum() < 2:
        placed[:] = False
    poses = _identity_where_missing(estimate, placed)
    defining = placed if placed.any() else ~placed
    truth_T_world = align(truth[defining], poses[defining])
    aligned = truth_T_world @ poses
    return AbsoluteErrors(
        rotation_error_deg(truth, aligned),
        translation_error_m(truth, aligned),
        placed,
        _largest_agreeing(truth, poses, placed),
        truth_T_world @ _first_T_world(estimate, placed),
    )


def _identity_where_missing(estimate: Sequence[Array | None], placed: BoolArray) -> Array:
    first_T_world = _first_T_world(estimate, placed)
    return np.stack(
        [
            first_T_world @ pose if pose is not None and keep else np.eye(4)
            for pose, keep in zip(estimate, placed, strict=True)
        ]
    )


def _first_T_world(estimate: Sequence[Array | None], placed: BoolArray) -> Array:
    for pose, keep in zip(estimate, placed, strict=True):
        if pose is not None and keep:
            return se3.inverse(pose)
    return np.eye(4)


def _largest_agreeing(truth: Array, poses: Array, placed: BoolArray) -> BoolArray:
    best = np.zeros(len(truth), dtype=bool)
    for anchor in np.flatnonzero(placed):
        expected = relative(truth, truth[anchor])
        found = relative(poses, poses[anchor])
        errors = rotation_error_deg(expected, found), translation_error_m(expected, found)
        agreeing = within(*errors) & placed
        if agreeing.sum() > max(best.sum(), 1):
            best = agreeing
    return best
