"""The 360-image completion network: an encoder-decoder with skips over the levelled ring.

Four by four pixels become channels first, so that the costly layers work at a quarter of the
resolution. Convolutions wrap around horizontally: turning the ring by a whole face turns the
answer, but for its normals. Group normalisation keeps a scan's answer independent of the others in
its batch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fewview.completion.panorama.blocks import ResidualBlock, doubled
from fewview.completion.panorama.ring import ring_normals, ring_rays, unit
from fewview.types import FloatArray

CLASSES = (
    "unknown",
    "wall",
    "floor",
    "ceiling",
    "door",
    "window",
    "table",
    "chair",
    "sofa",
    "bed",
    "cabinet",
    "other",
)
INPUTS = 10
NORMALS = slice(4, 7)
STEM = 4
COARSE = 2
GEOMETRY = (1, 1, 3, 1)
TYPICAL_LOG_DEPTH = 0.7
LOG_SCALE_RANGE = (-5.0, 2.0)
SNAP = 4


@dataclass(frozen=True)
class PanoramaNetworkConfig:
    """Size of the network."""

    width: int = 48
    """Channels at the finest level, a multiple of 16; deeper ones have 1.5, 2, 3 and 4 times as
    many."""
    descriptor: int = 32
    """Length of a pixel's descriptor."""


class RingPrediction(NamedTuple):
    """What the network says of every pixel of B rings.

    Attributes:
        log_depth: (B, S, 4 S), logarithm of the planar depth in metres.
        log_scale: (B, S, 4 S), logarithm of the Laplace scale of `log_depth`.
        normal: (B, 3, S, 4 S) unit, level frame.
        semantics: (B, 12, S/2, 2 S) logits of `CLASSES`, one for two by two pixels.
        descriptor: (B, D, S/2, 2 S), one for two by two pixels, of any length.
    """

    log_depth: Tensor
    log_scale: Tensor
    normal: Tensor
    semantics: Tensor
    descriptor: Tensor


def network_input(colour: Tensor, depth: Tensor) -> Tensor:
    """Rings as channels: colour 3, log depth 1, normal 3, height 1, mask 1, all 0 where nothing was
    measured, and the elevation of the pixel's ray.

    Args:
        colour: (B, S, 4 S, 3) uint8.
        depth: (B, S, 4 S) float32, 0 unknown.

    Returns:
        (B, 10, S, 4 S).
    """
    up = torch.from_numpy(ring_rays(depth.shape[1])[..., 2]).to(depth.device)
    known = (depth > 0)[:, None].to(depth.dtype)
    rgb = colour.permute(0, 3, 1, 2).to(depth.dtype) / 127.5 - 1.0
    log_depth = torch.log(depth.clamp_min(0.05))[:, None] - TYPICAL_LOG_DEPTH
    height = (depth * up)[:, None]
    elevation = up.expand_as(depth)[:, None]
    shown = [rgb * known, log_depth * known, ring_normals(depth), height, known, elevation]
    return torch.cat(shown, dim=1)


class PanoramaNetwork(nn.Module):
    """Completes rings; see `RingPrediction` for the answer."""

    def __init__(self, config: PanoramaNetworkConfig = PanoramaNetworkConfig()) -> None:
        super().__init__()
        widths = [int(config.width * factor) for factor in (1, 1.5, 2, 3, 4)]
        self.config = config
        self.stem = nn.Conv2d(INPUTS, widths[0], STEM, stride=STEM)
        self.encoder = nn.ModuleList(ResidualBlock(width) for width in widths[:-1])
        self.down = nn.ModuleList(
            nn.Conv2d(fine, coarse, 2, stride=2)
            for fine, coarse in zip(widths, widths[1:], strict=False)
        )
        self.bottom = nn.Sequential(ResidualBlock(widths[-1]), ResidualBlock(widths[-1]))
        self.fuse = nn.ModuleList(
            nn.Conv2d(fine + coarse, fine, 1)
            for fine, coarse in zip(widths, widths[1:], strict=False)
        )
        self.decoder = nn.ModuleList(ResidualBlock(width) for width in widths[:-1])
        self.geometry = nn.ConvTranspose2d(widths[0], sum(GEOMETRY), STEM, stride=STEM)
        coarse = STEM // COARSE
        self.meaning = nn.ConvTranspose2d(
            widths[0], len(CLASSES) + config.descriptor, coarse, stride=coarse
        )
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, inputs: Tensor) -> RingPrediction:
        """Complete (B, 10, S, 4 S) rings made by `network_input`; S is a multiple of 64."""
        x = self.stem(inputs.contiguous(memory_format=torch.channels_last))
        skips = []
        for block, down in zip(self.encoder, self.down, strict=True):
            x = block(x)
            skips.append(x)
            x = down(x)
        x = self.bottom(x)
        for block, fuse in zip(reversed(self.decoder), reversed(self.fuse), strict=True):
            x = block(fuse(torch.cat([skips.pop(), doubled(x)], dim=1)))
        depth, scale, normal, gate = self.geometry(x).float().split(GEOMETRY, dim=1)
        semantics, descriptor = self.meaning(x).float().tensor_split((len(CLASSES),), dim=1)
        return RingPrediction(
            depth[:, 0] + TYPICAL_LOG_DEPTH,
            (scale[:, 0] - 1.0).clamp(*LOG_SCALE_RANGE),
            _snapped(normal, gate),
            semantics,
            descriptor,
        )


def ring_tensors(colour: NDArray[np.uint8], depth: FloatArray) -> Tensor:
    """`network_input` of one ring given as arrays (S, 4 S, 3) and (S, 4 S)."""
    return network_input(torch.from_numpy(colour)[None], torch.from_numpy(depth)[None])


def _snapped(free: Tensor, gate: Tensor) -> Tensor:
    """Unit normals between what the network drew freely and the nearest axis of the ring."""
    free = unit(free)
    steep = free.sign() * free.abs().pow(SNAP)
    return unit(free + gate.sigmoid() * (unit(steep) - free))
