"""The top-down grid of a levelled scan: the camera in the middle, +x at the top.

Row 0 is the strip at x = +4 m, column 0 the strip at y = +4 m; z points up.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from fewview.types import BoolArray, FloatArray

CELLS = 64
CELL_M = 0.125
HALF_M = 0.5 * CELLS * CELL_M
CLASSES = ("unknown", "wall", "free floor", "furniture", "door")
UNKNOWN, WALL, FREE, FURNITURE, DOOR = range(5)
AZIMUTH_BINS = 180


def cell_centres() -> FloatArray:
    """(CELLS, CELLS, 2) x, y of every cell's centre, metres."""
    along = HALF_M - CELL_M * (np.arange(CELLS, dtype=np.float32) + np.float32(0.5))
    return np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)


def location_channels() -> Tensor:
    """(3, CELLS, CELLS) x, y and distance of every cell's centre, in halves of the grid's edge."""
    centres = torch.from_numpy(cell_centres()).permute(2, 0, 1) / HALF_M
    return torch.cat([centres, centres.norm(dim=0, keepdim=True)])


def cells_of(points: Tensor) -> tuple[Tensor, Tensor]:
    """The cell of (..., 2 or 3) points.

    Returns:
        (...) int64 row * CELLS + column, 0 for points outside, and (...) bool: inside the grid.
    """
    cells = torch.floor((HALF_M - points[..., :2]) / CELL_M).long()
    inside = ((cells >= 0) & (cells < CELLS)).all(dim=-1)
    flat = cells[..., 0] * CELLS + cells[..., 1]
    return torch.where(inside, flat, 0), inside


def field_of_view(azimuths: FloatArray) -> BoolArray:
    """Which cells lie in a direction that the camera looked in.

    Args:
        azimuths: (n,) of its rays, radians, counter-clockwise from +x; closer than two degrees.

    Returns:
        (CELLS, CELLS) bool.
    """
    seen = np.zeros(AZIMUTH_BINS, dtype=bool)
    seen[_azimuth_bin(azimuths)] = True
    centres = cell_centres()
    return np.asarray(seen[_azimuth_bin(np.arctan2(centres[..., 1], centres[..., 0]))])


def _azimuth_bin(azimuths: FloatArray) -> np.ndarray:
    return np.asarray(
        np.floor(azimuths * (AZIMUTH_BINS / (2.0 * np.pi))).astype(int) % AZIMUTH_BINS
    )
