"""What the point networks see of the image around each point: their image branch (Sec. 3.2).

A small encoder-decoder over the levelled ring, at a quarter of its resolution, tells what a point
belongs to, which neither its own colour nor the few points beside it can.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fewview.completion.panorama.blocks import ResidualBlock, doubled
from fewview.completion.panorama.network import INPUTS, STEM, network_input


class ImageFeatures(nn.Module):
    """Features of the surroundings of chosen pixels of rings."""

    def __init__(self, width: int) -> None:
        super().__init__()
        wide = 2 * width
        self.stem = nn.Sequential(nn.Conv2d(INPUTS, width, STEM, stride=STEM), ResidualBlock(width))
        self.coarse = nn.Sequential(
            nn.Conv2d(width, wide, 2, stride=2), ResidualBlock(wide), ResidualBlock(wide)
        )
        self.fine = nn.Sequential(
            nn.Conv2d(width + wide, width, 1), ResidualBlock(width), nn.GroupNorm(1, width)
        )

    def forward(self, colour: Tensor, depth: Tensor, pixels: Tensor) -> Tensor:
        """Features of several rings' pixels.

        Args:
            colour: (B, S, 4 S, 3) uint8.
            depth: (B, S, 4 S), metres, 0 unknown.
            pixels: (B, N) flat.

        Returns:
            (B, N, width).
        """
        size = depth.shape[1]
        skip = self.stem(network_input(colour, depth))
        maps = self.fine(torch.cat([skip, doubled(self.coarse(skip))], dim=1))
        row, column = pixels // (4 * size), pixels % (4 * size)
        cell = row // STEM * (4 * size // STEM) + column // STEM
        flat = maps.flatten(2).mT
        return torch.gather(flat, 1, cell[..., None].expand(-1, -1, flat.shape[2]))
