"""Errors of relative poses: the paper's two numbers, and what counts as right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, BoolArray

RIGHT_DEG = 15.0
"""A pose is right when it is within this rotation ..."""
RIGHT_M = 0.3
"""... and within this translation of the truth."""


def rotation_error_deg(truth: Array, estimate: Array) -> Array:
    """Geodesic angle between the rotations of (..., 4, 4) poses, degrees in 0..180."""
    delta = np.swapaxes(_rotation(truth), -1, -2) @ _rotation(estimate)
    return np.asarray(np.degrees(se3.rotation_angle(delta)))


def translation_error_m(truth: Array, estimate: Array) -> Array:
    """||t_gt - t|| of (..., 4, 4) poses, metres: the error at the source's origin."""
    return np.asarray(np.linalg.norm(truth[..., :3, 3] - estimate[..., :3, 3], axis=-1))


def translation_error_at_m(truth: Array, estimate: Array, point: Array) -> Array:
    """How far apart two (..., 4, 4) target_T_source carry a (3,) ``point`` of the source, metres.

    At the source's centroid this is the error of the paper's predecessors; unlike the one at the
    origin it does not depend on where the camera stood.
    """
    homogeneous = np.append(point, 1.0)
    return np.asarray(np.linalg.norm(((truth - estimate) @ homogeneous)[..., :3], axis=-1))


def within(
    rotation_deg: Array, translation_m: Array, max_deg: float = RIGHT_DEG, max_m: float = RIGHT_M
) -> BoolArray:
    """Which errors are inside the tolerance, bounds included."""
    return np.asarray((rotation_deg <= max_deg) & (translation_m <= max_m))


def relative(world_T_source: Array, world_T_target: Array) -> Array:
    """target_T_source of two camera-to-world poses."""
    return np.asarray(se3.inverse(world_T_target) @ world_T_source)


def orthonormal(world_T_scan: Array) -> Array:
    """The (..., 4, 4) poses with their rotation parts made exact; recorded truth often is not."""
    return se3.pose(_rotation(world_T_scan), world_T_scan[..., :3, 3])


def best_of_top_k(rotation_deg: Sequence[float], k: int) -> int | None:
    """The paper's top-k: index of the smallest rotation error among the first k candidates."""
    first = list(rotation_deg[:k])
    return int(np.argmin(first)) if first else None


def _rotation(pose: Array) -> Array:
    return se3.nearest_rotation(pose[..., :3, :3])
