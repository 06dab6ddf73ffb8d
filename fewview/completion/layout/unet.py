"""A convolutional encoder-decoder with skips (Ronneberger et al., MICCAI 2015), GroupNorm."""

from __future__ import annotations

import torch
from torch import Tensor, nn

GROUPS = 8
LEVELS = (2, 3, 5, 8)


def convolution(inputs: int, out: int, stride: int = 1) -> nn.Sequential:
    """3 x 3 convolution, GroupNorm, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, out, 3, stride, padding=1, bias=False),
        nn.GroupNorm(GROUPS, out),
        nn.ReLU(),
    )


class EncoderDecoder(nn.Module):
    """Halves the grid four times and comes back.

    Args:
        inputs: channels.
        width: a multiple of 8, channels at full size; deeper levels have LEVELS times as many.
    """

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        sizes = [width, *(width * level for level in LEVELS)]
        self.stem = nn.Sequential(nn.Conv2d(inputs, width, 1), nn.ReLU())
        self.down = nn.ModuleList(
            nn.Sequential(convolution(a, b, 2), convolution(b, b))
            for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )
        self.narrow = nn.ModuleList(
            nn.Conv2d(b, a, 1) for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )
        self.up = nn.ModuleList(convolution(size, size) for size in sizes[:-1])

    def forward(self, grid: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, width, H, W); H and W multiples of 16."""
        skips = [self.stem(grid)]
        for down in self.down:
            skips.append(down(skips[-1]))
        x = skips.pop()
        for narrow, up in zip(reversed(self.narrow), reversed(self.up), strict=True):
            x = up(skips.pop() + nn.functional.interpolate(narrow(x), scale_factor=2.0))
        return torch.as_tensor(x)
