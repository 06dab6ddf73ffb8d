"""Weighted rigid regression on points and normals (Horn 1987; Eq. 1 of the paper)."""

from __future__ import annotations

from fewview.geometry import se3
from fewview.types import Array


def fit_rigid(
    source: Array,
    target: Array,
    weights: Array,
    source_normals: Array,
    target_normals: Array,
    normal_weights: Array,
) -> Array:
    """The motion minimising sum w |R p + t - q|^2 + sum w_n |R n_p - n_q|^2.

    Args:
        source: (m, 3) points p.
        target: (m, 3) points q.
        weights: (m,) non-negative, not all zero.
        source_normals: (k, 3) unit vectors n_p.
        target_normals: (k, 3) unit vectors n_q.
        normal_weights: (k,) in square metres: what a turn of the normal counts against points.

    Returns:
        target_T_source (4, 4).
    """
    share = weights / weights.sum()
    source_mean, target_mean = share @ source, share @ target
    scatter = ((target - target_mean) * weights[:, None]).T @ (source - source_mean)
    scatter += (target_normals * normal_weights[:, None]).T @ source_normals
    rotation = se3.nearest_rotation(scatter)
    return se3.pose(rotation, target_mean - rotation @ source_mean)
