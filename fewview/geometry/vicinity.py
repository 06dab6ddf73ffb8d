"""Which points can be near a surface at all, told without a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from fewview.types import Array, BoolArray


@dataclass(frozen=True)
class Vicinity:
    """Cells that may hold points within a distance of a surface; all others hold none.

    Attributes:
        low: (3,) corner of the first cell.
        cell_m: side of a cell, which is that distance.
        near: (x, y, z) cells beside or around a point of the surface; the outermost ones, into
            which everything beyond falls, never are.
    """

    low: Array
    cell_m: float
    near: BoolArray

    @classmethod
    def of(cls, points: Array, distance_m: float) -> Vicinity:
        """The vicinity of a surface's (n, 3) points."""
        if not len(points):
            return cls(np.zeros(3), distance_m, np.zeros((1, 1, 1), dtype=bool))
        low = points.min(axis=0) - 2.0 * distance_m
        index = ((points - low) / distance_m).astype(np.intp)
        near = np.zeros(index.max(axis=0) + 3, dtype=bool)
        near[tuple(index.T)] = True
        return cls(low, distance_m, ndimage.binary_dilation(near, np.ones((3, 3, 3))))

    def may_hold(self, points: Array) -> BoolArray:
        """(...) whether (..., 3) points may be within the distance of the surface."""
        index = ((points - self.low) / self.cell_m).astype(np.intp)
        last = np.array(self.near.shape) - 1
        index = np.clip(index, 0, last)
        flat = (index[..., 0] * (last[1] + 1) + index[..., 1]) * (last[2] + 1) + index[..., 2]
        return np.asarray(self.near.ravel()[flat])
