"""The verifier: one number for two scans drawn together, to be added to the aligner's score."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview.alignment.drawing import CHANNELS
from fewview.completion.layout.grid import HALF_M

GRID = 64
REACH_M = 4.8
"""Half the edge of the square that is looked at, around the middle between the two cameras."""
MARKS = 2
GROUPS = 8
MARK_M = 0.4


@dataclass(frozen=True)
class VerifierNetworkConfig:
    """Size of the network."""

    width: int = 64
    """Channels at half the resolution, a multiple of 16; 1.5 times as many deeper."""


class VerifierNetwork(nn.Module):
    """What speaks for two scans lying so to each other, as a convolutional network sees them."""

    def __init__(self, config: VerifierNetworkConfig = VerifierNetworkConfig()) -> None:
        super().__init__()
        self.config = config
        width, deep = config.width, config.width * 3 // 2
        self.layers = nn.Sequential(
            nn.Conv2d(2 * CHANNELS + MARKS, width, 4, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, stride=2, padding=1),
            _Residual(width),
            nn.Conv2d(width, deep, 3, stride=2, padding=1),
            _Residual(deep),
            _Residual(deep),
            nn.GroupNorm(GROUPS, deep),
            nn.ReLU(),
        )
        self.head = nn.Sequential(nn.Linear(2 * deep, deep), nn.ReLU(), nn.Linear(deep, 1))
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, together: Tensor) -> Tensor:
        """(B, 2 CHANNELS + MARKS, GRID, GRID) of `together` to (B,) logits."""
        x = self.layers(together.contiguous(memory_format=torch.channels_last)).float()
        pooled = torch.cat([x.mean(dim=(2, 3)), x.amax(dim=(2, 3))], dim=1)
        logit: Tensor = self.head(pooled)[:, 0]
        return logit


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.GroupNorm(GROUPS, width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1),
            nn.GroupNorm(GROUPS, width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1),
        )

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.layers(x)
        return out


def together(source: Tensor, target: Tensor, motion: Tensor) -> Tensor:
    """Two drawings resampled into one square around the middle between the cameras.

    Args:
        source, target: (B, CHANNELS, CELLS, CELLS).
        motion: (B, 3) yaw and shift (x, y) from the source's grid frame to the target's.

    Returns:
        (B, 2 CHANNELS + MARKS, GRID, GRID): the source's channels, the target's, and a spot at
        either camera; axes as the target's.
    """
    steps = REACH_M * (1.0 - (2.0 * torch.arange(GRID, device=motion.device) + 1.0) / GRID)
    x, y = torch.meshgrid(steps, steps, indexing="ij")
    yaw, shift = motion[:, 0], motion[:, 1:]
    around = torch.stack([x, y], dim=-1)[None]
    in_target = around + 0.5 * shift[:, None, None]
    in_source = _turned(around - 0.5 * shift[:, None, None], -yaw)
    spots = [_spot(in_source), _spot(in_target)]
    return torch.cat(
        [_sampled(source, in_source), _sampled(target, in_target), torch.stack(spots, dim=1)], dim=1
    )


def _turned(points: Tensor, angle: Tensor) -> Tensor:
    cos, sin = angle.cos()[:, None, None], angle.sin()[:, None, None]
    x, y = points.unbind(dim=-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)


def _sampled(images: Tensor, places: Tensor) -> Tensor:
    return F.grid_sample(images, -places.flip(-1) / HALF_M, align_corners=False)


def _spot(places: Tensor) -> Tensor:
    return torch.exp(-(places**2).sum(dim=-1) / (2.0 * MARK_M**2))
