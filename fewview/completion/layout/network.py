"""The 2D layout completion network (Sec. 3.2 and supplementary, "2D Layout Completion Module").

Points get features, features go into cells and bins of height over a predicted floor, and an
encoder-decoder completes the grid. Seen free space and the field of view are channels of their
own, since an empty cell means little unless the camera looked through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from fewview.completion.layout.grid import CLASSES, location_channels
from fewview.completion.layout.image import ImageFeatures
from fewview.completion.layout.pointnet import PointBatch, PointFeatures, SplitLinear
from fewview.completion.layout.pooling import BINS, heights_over, pooled, seen_through
from fewview.completion.layout.unet import EncoderDecoder

DESCRIPTOR = 32
TYPICAL_FLOOR = (-1.45, 0.0, 0.0)
SLOPE_SCALE = 0.1


@dataclass(frozen=True)
class LayoutNetworkConfig:
    """Size of the network."""

    width: int = 32
    """Channels of the encoder-decoder at full size, a multiple of 8."""
    point_features: int = 16
    """Channels that each point brings into the grid."""
    image: int = 32
    """Channels of the image branch, a multiple of 8."""


class LayoutOutput(NamedTuple):
    """What the network says about several scans.

    Attributes:
        logits: (B, 5, CELLS, CELLS) of the weighted classes; see `LayoutNetwork.probabilities`.
        descriptors: (B, DESCRIPTOR, CELLS, CELLS) of unit length.
        floor: (B, 3) h, a, b of the floor z = h + a x + b y in the wall frame.
        free: (B, BINS, CELLS, CELLS), 1 where the camera looked through.
        occupied: (B, CELLS, CELLS) bool, cells with a point.
    """

    logits: Tensor
    descriptors: Tensor
    floor: Tensor
    free: Tensor
    occupied: Tensor


class LayoutNetwork(nn.Module):
    """Completes the layout around a camera.

    `class_weights` (5,) are the weights that the classes had in training; `Problem`s set them.
    """

    class_weights: Tensor
    centres: Tensor

    def __init__(self, config: LayoutNetworkConfig = LayoutNetworkConfig()) -> None:
        super().__init__()
        self.config = config
        self.image = ImageFeatures(config.image)
        self.features = PointFeatures(local=48, whole=128, image=config.image)
        self.floor = nn.Sequential(nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 3))
        self.mixed = SplitLinear(48 + 1, 128, 48)
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(48, config.point_features), nn.ReLU())
        channels = BINS * (2 * config.point_features + 1) + BINS + 1 + 3
        self.grid = EncoderDecoder(channels, config.width)
        self.head = nn.Conv2d(config.width, len(CLASSES) + DESCRIPTOR, 1)
        self.register_buffer("class_weights", torch.ones(len(CLASSES)))
        self.register_buffer("centres", location_channels(), persistent=False)

    def forward(self, batch: PointBatch) -> LayoutOutput:
        """Complete the layouts of several scans."""
        image = self.image(batch.ring_colour, batch.ring_depth, batch.pixels)
        near, whole = self.features(batch, image)
        scale = whole.new_tensor([1.0, SLOPE_SCALE, SLOPE_SCALE])
        floor = whole.new_tensor(TYPICAL_FLOOR) + scale * self.floor(whole)
        height = heights_over(floor.detach(), batch.points)
        mixed = self.mixed(torch.cat([near, height[..., None]], dim=-1), whole)
        cells = pooled(self.out(mixed), batch.points, height, batch.valid)
        free = seen_through(batch.points, floor.detach(), batch.valid)
        where = self.centres.expand(len(cells), -1, -1, -1)
        view = batch.field_of_view[:, None].to(cells.dtype)
        out = self.head(self.grid(torch.cat([cells, free, view, where], dim=1)))
        logits, descriptors = out.split([len(CLASSES), DESCRIPTOR], dim=1)
        occupied = cells.reshape(len(cells), BINS, -1, *cells.shape[2:])[:, :, -1].amax(dim=1) > 0
        return LayoutOutput(
            logits, nn.functional.normalize(descriptors, dim=1), floor, free, occupied
        )

    def classes(self, logits: Tensor) -> Tensor:
        """(B, CELLS, CELLS) classes chosen under the weights of training, by which a thin wall
        whose place is not sure to the cell is still a wall and not the room on either side."""
        return logits.argmax(dim=1)

    def probabilities(self, logits: Tensor) -> Tensor:
        """Class probabilities without the weights that the classes had in training.

        Cross-entropy with weights w is least where softmax(logits) is proportional to w p, so
        dividing by w brings back p.
        """
        return torch.softmax(logits - torch.log(self.class_weights)[:, None, None], dim=1)
