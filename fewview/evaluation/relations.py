"""Geometric relations between points of two scans, and how well they are predicted.

The paper's experiment on the quality of its relation prediction (Sec. 3.3, Sec. 4, supplementary).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, IntArray

MAX_ANGLE_DEG = 5.0
"""Normals closer than this to 0 or 90 degrees are parallel or perpendicular ..."""
MAX_OFFSET_M = 0.05
"""... and points closer than this to each other's plane share it: the predecessor's labels."""


class Relation(IntEnum):
    """The four classes; the values are the rows and columns of every confusion matrix."""

    NONE = 0
    COPLANAR = 1
    PARALLEL = 2
    PERPENDICULAR = 3


def true_relations(
    source_points: Array,
    source_normals: Array,
    target_points: Array,
    target_normals: Array,
    target_T_source: Array,
) -> IntArray:
    """The labels of n point pairs: `read_relations` under the true pose at 5 degrees and 0.05 m."""
    return read_relations(
        source_points,
        source_normals,
        target_points,
        target_normals,
        target_T_source,
        MAX_ANGLE_DEG,
        MAX_OFFSET_M,
    )


def read_relations(
    source_points: Array,
    source_normals: Array,
    target_points: Array,
    target_normals: Array,
    target_T_source: Array,
    max_angle_deg: float,
    max_offset_m: float,
) -> IntArray:
    """Read the relation of n point pairs off their normals and positions under a pose.

    Co-planar: the normals agree and each point lies on the other's plane (both terms of the
    paper's f_coplanar). Parallel: not co-planar, and the normals agree up to their sign, because
    the paper's f_parallel, 1 - ((R n1)^T n2)^2, does not see the sign; the two sides of a thin
    wall are therefore parallel, not co-planar. Perpendicular: within the same angle of 90 degrees.

    Args:
        source_points, source_normals: (n, 3) in the source frame, metres and unit vectors.
        target_points, target_normals: (n, 3) in the target frame, row i paired with row i.
        target_T_source: (4, 4).
        max_angle_deg: tolerance of all angles, bounds included; below 45.
        max_offset_m: tolerance of both plane offsets, bounds included.

    Returns:
        (n,) values of `Relation`.
    """
    turned = se3.rotate(target_T_source, source_normals)
    gap = se3.transform(target_T_source, source_points) - target_points
    cosine = np.einsum("ni,ni->n", turned, target_normals)
    sine = np.linalg.norm(np.cross(turned, target_normals), axis=1)
    angle = np.degrees(np.arctan2(sine, cosine))
    offset = np.maximum(
        np.abs(np.einsum("ni,ni->n", gap, turned)),
        np.abs(np.einsum("ni,ni->n", gap, target_normals)),
    )
    found = np.full(len(angle), Relation.NONE, dtype=np.int64)
    found[np.minimum(angle, 180.0 - angle) <= max_angle_deg] = Relation.PARALLEL
    found[np.abs(angle - 90.0) <= max_angle_deg] = Relation.PERPENDICULAR
    found[(angle <= max_angle_deg) & (offset <= max_offset_m)] = Relation.COPLANAR
    return found


def perturbed(
    target_T_source: Array, rng: np.random.Generator, max_deg: float = 30.0, max_m: float = 0.5
) -> Array:
    """A true (4, 4) pose moved away from the truth as the paper does before it predicts.

    The rotation is about a uniform axis through the source's origin by an angle uniform in
    0..``max_deg``, the translation uniform in [-``max_m``, ``max_m``]^3; they are exactly the
    rotation error and the difference of the translations of the result.
    """
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    turn = se3.rotation_exp(np.radians(rng.uniform(0.0, max_deg)) * axis)
    shift = rng.uniform(-max_m, max_m, size=3)
    return se3.pose(turn @ target_T_source[:3, :3], target_T_source[:3, 3] + shift)


def confusion(labels: IntArray, predicted: IntArray) -> IntArray:
    """(4, 4) counts of (n,) values of `Relation`: rows the label, columns the prediction."""
    size = len(Relation)
    counts = np.bincount(labels * size + predicted, minlength=size * size)
    return counts.reshape(size, size).astype(np.int64)


def row_shares(counts: IntArray) -> Array:
    """(4, 4) counts to shares of each label's pairs; NaN where a label never occurs."""
    total = counts.sum(axis=1, keepdims=True)
    return np.where(total > 0, counts / np.maximum(total, 1), np.nan)


def accuracies(counts: IntArray) -> Array:
    """(4,) share of each label's pairs that are predicted right; NaN where it never occurs."""
    return np.diagonal(row_shares(counts)).copy()
