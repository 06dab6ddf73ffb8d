"""What every pair needs of a scan and should not compute again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from fewview.alignment import Alignment, Embedded, draw, embed
from fewview.geometry.vicinity import Vicinity
from fewview.matching.heights import height_profile
from fewview.matching.manhattan import TopDown, top_down
from fewview.types import Array, BoolArray, CompletedScan, FloatArray

UPRIGHT_COS = 0.5
NEAR_M = 0.08
"""Points of two surfaces that are no further apart meet."""


@dataclass(frozen=True)
class PreparedScan:
    """A completed scan with search structures.

    Attributes:
        scan: the scan.
        tree: k-d tree of its surface points; vicinity: where points meet them.
        sample: (n, 3) even selection of the surface points.
        sample_upright: (n,) which of these lie on upright faces.
        depth_min, depth_max: (h, w) smallest and largest valid depth in 3 x 3 pixels, 0 unknown.
        raster: its top-down rasters.
        heights: see `height_profile`.
        above: its completed room drawn and embedded from above; None without a completed layout.
    """

    scan: CompletedScan
    tree: cKDTree
    vicinity: Vicinity
    sample: Array
    sample_upright: BoolArray
    depth_min: FloatArray
    depth_max: FloatArray
    raster: TopDown
    heights: FloatArray
    above: Embedded | None


def prepare(scan: CompletedScan, sample: int = 1000) -> PreparedScan:
    """Search structures of one scan; ``sample`` points are kept for visibility checks."""
    points = scan.surface.points
    chosen = slice(None, None, max(1, len(points) // sample))
    upright = np.abs(scan.surface.normals[chosen] @ scan.levelling.level_R_scan[2]) < UPRIGHT_COS
    low, high = _depth_bounds(scan.depth)
    layout = scan.room.layout
    return PreparedScan(
        scan=scan,
        tree=cKDTree(points),
        vicinity=Vicinity.of(points, NEAR_M),
        sample=points[chosen],
        sample_upright=upright,
        depth_min=low,
        depth_max=high,
        raster=top_down(scan),
        heights=height_profile(scan),
        above=None if layout is None else embed(draw(scan.room.ring, layout)),
    )


def aligned(source: PreparedScan, target: PreparedScan) -> Alignment | None:
    """The probability of the pair's levelled poses; None without two completed layouts."""
    if source.above is None or target.above is None:
        return None
    return Alignment(source.above, target.above)


def _depth_bounds(depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    low = ndimage.minimum_filter(np.where(depth > 0, depth, np.inf), size=3)
    high = ndimage.maximum_filter(depth, size=3)
    return np.where(np.isfinite(low), low, 0).astype(np.float32), high
