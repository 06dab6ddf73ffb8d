"""The planar patch completion network (Sec. 3.2 and supplementary, "Planar Patch Completion").

One branch says of every point the normal and centre of its plane, what it is, and a descriptor; the
other names the structural planes, walls, floor and ceiling, seen or not. The second branch reads,
beside the points' maximum, how many points support each direction and distance of a wall; it treats
all sectors of azimuth alike (circular convolutions) but for telling it where ahead is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview.completion.layout.image import ImageFeatures
from fewview.completion.layout.pointnet import PointBatch, PointFeatures, SplitLinear
from fewview.completion.panorama.network import CLASSES
from fewview.completion.structure import anchors
from fewview.completion.structure.anchors import ANCHORS, BINS, FINE, HEIGHT_BINS, SLOTS

DESCRIPTOR = 32
LOG_SCALE_RANGE = (-4.0, 1.5)
KERNEL = 11
TYPICAL_HEIGHTS_M = (-1.45, 1.15)
SCALARS = 5


@dataclass(frozen=True)
class StructureNetworkConfig:
    """Size of the network."""

    local: int = 64
    """Channels of a point."""
    whole: int = 256
    """Channels of a scan."""
    sector: int = 128
    """Channels of a sector of azimuth."""
    image: int = 32
    """Channels of the image branch, a multiple of 8."""


class PointPrediction(NamedTuple):
    """Of every point's plane.

    Attributes:
        normal: (B, N, 3) unit; offset: (B, N, 3) from the point to the centre, metres.
        log_scale: (B, N) of the offset's Laplace distribution.
        semantics: (B, N, 12) logits; descriptor: (B, N, DESCRIPTOR) unit.
    """

    normal: Tensor
    offset: Tensor
    log_scale: Tensor
    semantics: Tensor
    descriptor: Tensor


class WallPrediction(NamedTuple):
    """Of K = ANCHORS x SLOTS walls; see `anchors`.

    Attributes:
        exists: (B, K) logits.
        azimuth: (B, K) outward, radians.
        distance, distance_log_scale: (B, K), metres.
        middle, middle_log_scale: (B, K), metres left of the camera's foot point.
        descriptor: (B, K, DESCRIPTOR) unit.
    """

    exists: Tensor
    azimuth: Tensor
    distance: Tensor
    distance_log_scale: Tensor
    middle: Tensor
    middle_log_scale: Tensor
    descriptor: Tensor


class LevelPrediction(NamedTuple):
    """Of the floor and the ceiling: height, log_scale (B, 2); descriptor (B, 2, DESCRIPTOR)."""

    height: Tensor
    log_scale: Tensor
    descriptor: Tensor


class StructureNetwork(nn.Module):
    """Predicts planes; see `PointPrediction`, `WallPrediction` and `LevelPrediction`."""

    def __init__(self, config: StructureNetworkConfig = StructureNetworkConfig()) -> None:
        super().__init__()
        self.config = config
        local, whole, sector = config.local, config.whole, config.sector
        self.image = ImageFeatures(config.image)
        self.points = PointFeatures(local, whole, config.image)
        self.mixed = SplitLinear(local, whole, local)
        self.point_head = nn.Sequential(
            nn.ReLU(),
            nn.Linear(local, local),
            nn.ReLU(),
            nn.Linear(local, 7 + len(CLASSES) + DESCRIPTOR),
        )
        self.scene = PointFeatures(local, whole, config.image)
        self.sector = SplitLinear(FINE * (BINS + 1) + 2, whole, sector)
        self.around = nn.ModuleList(
            nn.Conv1d(sector, sector, KERNEL, padding=KERNEL // 2, padding_mode="circular")
            for _ in range(2)
        )
        self.trust = nn.Parameter(torch.ones(SLOTS))
        self.wall_head = nn.Linear(sector, SLOTS * (SCALARS + BINS + DESCRIPTOR))
        self.levels = nn.Sequential(
            nn.Linear(2 * HEIGHT_BINS + whole, 128), nn.ReLU(), nn.Linear(128, 2 * (2 + DESCRIPTOR))
        )

    def forward(self, batch: PointBatch) -> tuple[PointPrediction, WallPrediction, LevelPrediction]:
        """Predict the planes of several scans."""
        image = self.image(batch.ring_colour, batch.ring_depth, batch.pixels)
        _, whole = self.scene(batch, image)
        return self._of_points(batch, image), self._walls(batch, whole), self._levels(batch, whole)

    def _of_points(self, batch: PointBatch, image: Tensor) -> PointPrediction:
        near, whole = self.points(batch, image)
        out = self.point_head(self.mixed(near, whole))
        normal, offset, scale, semantics, descriptor = out.split(
            [3, 3, 1, len(CLASSES), DESCRIPTOR], dim=-1
        )
        return PointPrediction(
            F.normalize(normal + batch.normals, dim=-1),
            offset,
            scale[..., 0].clamp(*LOG_SCALE_RANGE),
            semantics,
            F.normalize(descriptor, dim=-1),
        )

    def _walls(self, batch: PointBatch, whole: Tensor) -> WallPrediction:
        sectors, most, azimuth = self._sectors(batch, whole)
        out = self.wall_head(sectors).reshape(len(most), ANCHORS, SLOTS, -1)
        seen = self.trust[:, None] * most[:, :, None]
        scalars, bins, descriptor = out.split([SCALARS, BINS, DESCRIPTOR], dim=-1)
        scalars, bins, descriptor = (t.flatten(1, 2) for t in (scalars, bins + seen, descriptor))
        exists, turn, middle, scale, middle_scale = scalars.unbind(dim=-1)
        centres = anchors.NEAREST_M + anchors.BIN_M * (torch.arange(BINS, device=out.device) + 0.5)
        return WallPrediction(
            exists,
            azimuth + anchors.SECTOR * torch.tanh(turn),
            bins.softmax(dim=-1) @ centres,
            scale.clamp(*LOG_SCALE_RANGE),
            middle,
            middle_scale.clamp(*LOG_SCALE_RANGE),
            F.normalize(descriptor, dim=-1),
        )

    def _sectors(self, batch: PointBatch, whole: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the sectors (B, ANCHORS, C), the most votes for each distance in them
        (B, ANCHORS, BINS), and the azimuths of their slots (K,)."""
        votes = anchors.wall_votes(batch.points, batch.normals, batch.valid).roll(FINE // 2, dims=1)
        far = 0.25 * anchors.reach(batch.points, batch.valid).roll(FINE // 2, dims=1)
        votes = votes.reshape(len(votes), ANCHORS, FINE, BINS)
        azimuth = anchors.anchor_azimuths(votes)
        aside = azimuth[::SLOTS] - batch.heading[:, None]
        ahead = torch.stack([aside.cos(), aside.sin()], dim=-1)
        found = torch.cat([votes.flatten(2), far.reshape(len(votes), ANCHORS, FINE), ahead], dim=-1)
        x = F.relu(self.sector(found, whole)).mT
        for layer in self.around:
            x = x + F.relu(layer(x))
        return x.mT, votes.amax(dim=2), azimuth

    def _levels(self, batch: PointBatch, whole: Tensor) -> LevelPrediction:
        votes = anchors.height_votes(batch.points, batch.normals, batch.valid)
        out = self.levels(torch.cat([votes.flatten(1), whole], dim=-1)).reshape(len(votes), 2, -1)
        height, scale, descriptor = out.split([1, 1, DESCRIPTOR], dim=-1)
        return LevelPrediction(
            height[..., 0] + height.new_tensor(TYPICAL_HEIGHTS_M),
            scale[..., 0].clamp(*LOG_SCALE_RANGE),
            F.normalize(descriptor, dim=-1),
        )
