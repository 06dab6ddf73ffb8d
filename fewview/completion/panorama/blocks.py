"""Layers over a ring, whose left and right edges meet."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

GROUPS = 8


class RingConv(nn.Module):
    """A 3 x 3 convolution that wraps around horizontally."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, padding=(1, 0))

    def forward(self, x: Tensor) -> Tensor:
        wrapped = torch.cat([x[..., -1:], x, x[..., :1]], dim=-1)
        out: Tensor = self.conv(wrapped)
        return out


class ResidualBlock(nn.Module):
    """Two normalised ring convolutions added to their input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.GroupNorm(GROUPS, width),
            nn.ReLU(),
            RingConv(width, width),
            nn.GroupNorm(GROUPS, width),
            nn.ReLU(),
            RingConv(width, width),
        )

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.layers(x)
        return out


def doubled(x: Tensor) -> Tensor:
    """Every pixel two by two times."""
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
