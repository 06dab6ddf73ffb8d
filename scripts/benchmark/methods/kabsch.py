"""Rigid motions between matched points."""

from __future__ import annotations

import numpy as np

from fewview.geometry import se3
from fewview.types import Array


def kabsch(source: Array, target: Array) -> Array:
    """Least-squares target_T_source (..., 4, 4) of (..., n, 3) matched points."""
    source_mean, target_mean = source.mean(axis=-2), target.mean(axis=-2)
    centred = source - source_mean[..., None, :], target - target_mean[..., None, :]
    rotation = se3.nearest_rotation(np.swapaxes(centred[1], -1, -2) @ centred[0])
    shift = target_mean - (rotation @ source_mean[..., None])[..., 0]
    return se3.pose(rotation, shift)
