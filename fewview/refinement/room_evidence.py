"""What the completed rooms of two scans say of a pose: seen against predicted, apart from seen
against seen."""

from __future__ import annotations

import numpy as np

from fewview.alignment import Alignment
from fewview.completion.panorama.ring import ring_pixels
from fewview.geometry import se3
from fewview.matching.prepared import PreparedScan
from fewview.types import Array, CompletedPanorama

TOLERANCE = 0.12
"""Relative error of a predicted depth that still counts as agreement."""


def room_evidence(
    source: PreparedScan, target: PreparedScan, poses: Array, alignment: Alignment | None
) -> dict[str, Array]:
    """Named quantities (K,) of (K, 4, 4) poses target_T_source; none without completed rooms.

    ``aligner``: log probability that the aligner leaves around the pose, ``aligner_yaw``: to its
    yaw. Of the points that one scan saw and that fall where the other predicts: ``met`` share at
    the predicted depth, ``inside`` share in front of it, ``through`` share behind it, all weighted
    with the prediction's confidence; ``foreseen`` log of how many.
    """
    out: dict[str, Array] = {}
    if alignment is not None:
        out["aligner"] = alignment.log_mass(poses)
        out["aligner_yaw"] = alignment.log_yaw(poses)
    first, second = source.scan.room.panorama, target.scan.room.panorama
    if first is not None and second is not None:
        counts = _foreseen(second, se3.transform(poses, source.sample))
        counts += _foreseen(first, se3.transform(se3.inverse(poses), target.sample))
        total = counts.sum(axis=0)
        names = ("met", "inside", "through")
        out |= dict(zip(names, counts / np.maximum(total, 1.0), strict=True))
        out["foreseen"] = np.log1p(total)
    return out


def _foreseen(panorama: CompletedPanorama, points: Array) -> Array:
    """(3, K) confidence summed over points (K, n, 3) of the scan's frame that meet what was
    predicted there, lie in front of it, and behind it."""
    level = se3.transform(panorama.level_T_scan, points.reshape(-1, 3))
    pixel, depth, inside = ring_pixels(level, len(panorama.depth))
    predicted = panorama.depth.ravel()[pixel]
    weight = np.where(
        inside & ~panorama.observed.ravel()[pixel], panorama.confidence.ravel()[pixel], 0
    )
    step = np.log(np.maximum(depth, 0.05) / predicted)
    kinds = (np.abs(step) <= TOLERANCE, step < -TOLERANCE, step > TOLERANCE)
    return np.stack([(weight * kind).reshape(points.shape[:2]).sum(axis=1) for kind in kinds])
