"""The largest common point set (LCP): how many points of one scan a pose brings near another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, BoolArray, IntArray

BLOCK = 50
"""Points by which the poses that can still win are counted at a time."""
CELLS_PER_DELTA = 2


@dataclass(frozen=True)
class Vicinity:
    """Which cells of a grid are near a scan's points.

    Attributes:
        near: (x, y, z), one cell of margin that is never near.
        origin: (3,) corner of the grid, metres.
        cell_m: size of a cell.
    """

    near: BoolArray
    origin: Array
    cell_m: float

    @staticmethod
    def of(points: Array, delta_m: float) -> Vicinity:
        """Mark all cells whose centre is within about ``delta_m`` of (n, 3) points."""
        cell_m = delta_m / CELLS_PER_DELTA
        reach = CELLS_PER_DELTA + 1
        origin = points.min(axis=0) - (reach + 1) * cell_m
        shape = np.ceil((points.max(axis=0) - origin) / cell_m).astype(int) + reach + 2
        steps = np.argwhere(np.ones((2 * reach + 1,) * 3)) - reach
        steps = steps[np.linalg.norm(steps, axis=1) * cell_m <= delta_m]
        own = np.floor((points - origin) / cell_m).astype(int)
        near = np.zeros(shape, dtype=bool)
        near[tuple(np.moveaxis(own[:, None] + steps, -1, 0))] = True
        return Vicinity(near, origin, cell_m)

    def hits(self, points: Array) -> BoolArray:
        """Which (..., 3) points are near."""
        cells = np.floor((points - self.origin) / self.cell_m).astype(int)
        inside = np.clip(cells, 0, np.array(self.near.shape) - 1)
        return np.asarray(self.near[tuple(np.moveaxis(inside, -1, 0))])


def largest(poses: Array, points: Array, target: Vicinity, least: int) -> tuple[int, int] | None:
    """The pose with the largest common set; poses that cannot win are given up early.

    Args:
        poses: (k, 4, 4) target_T_source.
        points: (n, 3) of the source, in random order.
        target: where the target's points are.
        least: what the common set must exceed.

    Returns:
        index of the pose and size of its set; None when no set exceeds ``least``.
    """
    alive: IntArray = np.arange(len(poses))
    counts = np.zeros(len(poses), dtype=np.int64)
    for start in range(0, len(points), BLOCK):
        block = points[start : start + BLOCK]
        counts[alive] += target.hits(se3.transform(poses[alive], block)).sum(axis=1)
        left = len(points) - start - len(block)
        alive = alive[counts[alive] + left > least]
        if not len(alive):
            return None
    best = int(alive[counts[alive].argmax()])
    return best, int(counts[best])
