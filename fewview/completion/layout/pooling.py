"""From points to a top-down grid: pooled features and seen free space, in bins of height."""

from __future__ import annotations

import torch
from torch import Tensor

from fewview.completion.layout.grid import CELLS, cells_of

BIN_EDGES_M = (-0.1, 0.7, 1.5)
BINS = len(BIN_EDGES_M) + 1
RAY_SAMPLES = 28
FREE_MARGIN_M = 0.2
FULL_COUNT = 8.0


def heights_over(floor: Tensor, points: Tensor) -> Tensor:
    """Heights (B, N) of points (B, N, 3) over floors z = h + a x + b y, given as (B, 3) h, a, b."""
    level = floor[:, None, 0] + (points[..., :2] * floor[:, None, 1:]).sum(dim=-1)
    return points[..., 2] - level


def pooled(features: Tensor, points: Tensor, heights: Tensor, valid: Tensor) -> Tensor:
    """Mean and maximum of the features of the points in each bin of each cell.

    Args:
        features: (B, N, C), not negative.
        points: (B, N, 3), metres.
        heights: (B, N) over the floor.
        valid: (B, N) bool.

    Returns:
        (B, BINS (2 C + 1), CELLS, CELLS): means, maxima and how full the bin is (0..1).
    """
    batch, _, channels = features.shape
    slots, inside = _slots(points, heights)
    weight = (valid & inside).to(features.dtype)[..., None]
    index = slots[..., None].expand(-1, -1, channels)
    masked = features * weight
    empty = features.new_zeros(batch, BINS * CELLS * CELLS, channels)
    most = empty.scatter_reduce(1, index, masked, "amax")
    count = empty[..., :1].scatter_add(1, slots[..., None], weight)
    mean = empty.scatter_add(1, index, masked) / count.clamp(min=1.0)
    full = torch.log1p(count.clamp(max=FULL_COUNT)) / torch.log1p(count.new_tensor(FULL_COUNT))
    return _as_image(torch.cat([mean, most, full], dim=-1))


def seen_through(points: Tensor, floor: Tensor, valid: Tensor) -> Tensor:
    """Which bins the camera looked through on its way to the points.

    Args:
        points: (B, N, 3), metres, the camera at the origin.
        floor: (B, 3) as in `heights_over`.
        valid: (B, N) bool.

    Returns:
        (B, BINS, CELLS, CELLS), 1 where a ray went through, else 0.
    """
    batch = len(points)
    distance = points.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    reach = (1.0 - FREE_MARGIN_M / distance).clamp(min=0.0)
    steps = (torch.arange(RAY_SAMPLES, device=points.device) + 0.5) / RAY_SAMPLES
    along = (points * reach)[:, :, None] * steps[:, None]
    along = along.reshape(batch, -1, 3)
    slots, inside = _slots(along, heights_over(floor, along))
    passed = inside & valid.repeat_interleave(RAY_SAMPLES, dim=1)
    empty = points.new_zeros(batch, BINS * CELLS * CELLS)
    return _as_image(empty.scatter_reduce(1, slots, passed.to(points.dtype), "amax")[..., None])


def _slots(points: Tensor, heights: Tensor) -> tuple[Tensor, Tensor]:
    """Number of the bin of a cell that each point is in, and which points are in the grid."""
    cells, inside = cells_of(points)
    edges = heights.new_tensor(BIN_EDGES_M)
    bins = torch.bucketize(heights.detach().contiguous(), edges)
    return bins * (CELLS * CELLS) + cells, inside


def _as_image(slots: Tensor) -> Tensor:
    """(B, BINS CELLS^2, C) to (B, BINS C, CELLS, CELLS)."""
    batch, _, channels = slots.shape
    grid = slots.reshape(batch, BINS, CELLS * CELLS, channels).transpose(2, 3)
    return grid.reshape(batch, BINS * channels, CELLS, CELLS)
