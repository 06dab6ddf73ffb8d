"""How much higher one levelled scan's camera stands than another's."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from fewview.completion.room_matches import floor_height
from fewview.types import Array, CompletedScan, FloatArray

BIN_M = 0.05
RANGE_M = 3.0
REACH_M = 0.6


def height_profile(scan: CompletedScan) -> FloatArray:
    """(2, H) histogram of the heights of upward and downward faces in the level frame."""
    up = scan.levelling.level_R_scan[2]
    heights, facing = scan.surface.points @ up, scan.surface.normals @ up
    bins = np.arange(-RANGE_M, RANGE_M + BIN_M / 2, BIN_M)
    counts = [np.histogram(heights[side * facing > 0.9], bins)[0] for side in (1, -1)]
    smooth = ndimage.gaussian_filter1d(np.stack(counts).astype(np.float32), 1.0, axis=1)
    return np.asarray(np.sqrt(smooth))


def lift(
    source: CompletedScan,
    target: CompletedScan,
    source_profile: FloatArray,
    target_profile: FloatArray,
) -> float:
    """What is added to heights in the source's level frame to get the target's, metres.

    Floors tell it, seen or predicted; without them, the shift at which the profiles of floors,
    table tops and ceilings agree best.
    """
    floors = floor_height(source), floor_height(target)
    if floors[0] is not None and floors[1] is not None:
        return floors[1] - floors[0]
    most = round(REACH_M / BIN_M)
    steps = range(-most, most + 1)
    scores = [_agreement(source_profile, target_profile, s) - 1e-3 * abs(s) for s in steps]
    return steps[int(np.argmax(scores))] * BIN_M


def lifted(target_T_source: Array, target: CompletedScan, source_lift: float) -> Array:
    """A levelled pose (4, 4) moved along the target's vertical to a lift."""
    up = target.levelling.level_R_scan[2]
    out = target_T_source.copy()
    out[:3, 3] += (source_lift - out[:3, 3] @ up) * up
    return out


def _agreement(source: FloatArray, target: FloatArray, step: int) -> float:
    width = source.shape[1]
    a = source[:, max(0, -step) : width - max(0, step)]
    b = target[:, max(0, step) : width - max(0, -step)]
    return float((a * b).sum())
