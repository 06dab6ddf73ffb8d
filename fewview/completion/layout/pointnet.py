"""Features of a set of points in the manner of PointNet (Qi et al., CVPR 2017)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from fewview.completion.layout.points import ScanPoints

INPUTS = 9
POSITION_SCALE = 0.25


class PointBatch(NamedTuple):
    """Points of several scans; see `ScanPoints`.

    Attributes:
        points: (B, N, 3); colours: (B, N, 3); normals: (B, N, 3); valid: (B, N) bool;
        pixels: (B, N).
        field_of_view: (B, CELLS, CELLS) bool; heading: (B,).
        ring_colour: (B, S, 4 S, 3) uint8; ring_depth: (B, S, 4 S).
    """

    points: Tensor
    colours: Tensor
    normals: Tensor
    valid: Tensor
    pixels: Tensor
    field_of_view: Tensor
    heading: Tensor
    ring_colour: Tensor
    ring_depth: Tensor

    @staticmethod
    def of(scans: Sequence[ScanPoints]) -> PointBatch:
        """Put scans of equally many points together."""
        return PointBatch(
            *(
                torch.from_numpy(np.stack([getattr(s, name) for s in scans]))
                for name in PointBatch._fields
            )
        )

    @property
    def inputs(self) -> Tensor:
        """(B, N, 9) position, colour and normal, each of the order of one."""
        parts = [POSITION_SCALE * self.points, self.colours - 0.5, self.normals]
        return torch.cat(parts, dim=-1)


class SplitLinear(nn.Module):
    """A linear layer over [local, global] features that never writes them side by side.

    W [l, g] = W_l l + W_g g, and W_g g is the same for all points of a scan.
    """

    def __init__(self, local: int, whole: int, out: int) -> None:
        super().__init__()
        self.local = nn.Linear(local, out)
        self.whole = nn.Linear(whole, out, bias=False)

    def forward(self, local: Tensor, whole: Tensor) -> Tensor:
        """(B, N, local) and (B, whole) to (B, N, out)."""
        return torch.as_tensor(self.local(local) + self.whole(whole)[:, None])


class PointFeatures(nn.Module):
    """Per-point features and their maximum over the scan."""

    def __init__(self, local: int, whole: int, image: int) -> None:
        super().__init__()
        self.own = nn.Linear(INPUTS, local)
        self.around = nn.Linear(image, local, bias=False)
        self.near = nn.Sequential(nn.ReLU(), nn.Linear(local, local), nn.ReLU())
        self.far = nn.Sequential(nn.Linear(local, whole), nn.ReLU())
        self.norm = nn.LayerNorm(whole)

    def forward(self, batch: PointBatch, image: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, local) features of the points and (B, whole) of the scans, from what the points
        are and the `ImageFeatures` (B, N, image) around them."""
        near = self.near(self.own(batch.inputs) + self.around(image))
        far = self.far(near) * batch.valid[..., None]
        return near, self.norm(far.amax(dim=1))
