"""The relation network of the local module (Sec. 3.3; supplementary, "Local Relation Network").

A PointNet over the points of two scans in one frame, the target's, with an image branch; three
fully connected layers classify pairs of its points. What depends on one scan alone is computed
once, whatever the number of poses, and the first layer is split into what each side, the pair of
scans and the geometry of the points bring into it: no features are ever written side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from fewview.completion.layout.image import ImageFeatures
from fewview.completion.layout.pointnet import POSITION_SCALE, SplitLinear
from fewview.completion.panorama.network import CLASSES
from fewview.refinement.pair_geometry import GEOMETRY, PosedPairs, moved, pair_geometry, picked
from fewview.refinement.relation_points import OUTSIDE, RelationPoints
from fewview.types import FloatArray

RELATIONS = ("none", "coplanar", "parallel", "perpendicular")
"""The classes; the first is no relation."""
OWN, PLACED = 11, 7


@dataclass(frozen=True)
class RelationNetworkConfig:
    """Size of the network. The paper's is 64, 1024 and 32; it does not tell the head's."""

    local: int = 64
    """Channels of a point's own feature."""
    whole: int = 256
    """Channels of the feature of both scans together."""
    image: int = 32
    """Channels of the image branch, a multiple of 8."""
    head: int = 128
    """Channels of the layers that classify pairs."""


class RelationScans(NamedTuple):
    """Points of S scans; see `RelationPoints`.

    Attributes:
        points, normals, colours: (S, N, 3).
        confidence: (S, N); predicted, pooled: (S, N) bool; pixels: (S, N).
        ring_colour: (S, H, 4 H, 3) uint8; ring_depth: (S, H, 4 H).
    """

    points: Tensor
    normals: Tensor
    colours: Tensor
    confidence: Tensor
    predicted: Tensor
    pooled: Tensor
    pixels: Tensor
    ring_colour: Tensor
    ring_depth: Tensor

    @staticmethod
    def of(scans: Sequence[RelationPoints]) -> RelationScans:
        """Put scans together, the shorter ones filled up with points that are not pooled."""
        rows = max(1, *(len(scan.points) for scan in scans))
        of_points = {
            name: np.stack([_filled(getattr(scan, name), rows) for scan in scans])
            for name in RelationScans._fields[:-2]
        }
        rings = {n: np.stack([getattr(s, n) for s in scans]) for n in RelationScans._fields[-2:]}
        return RelationScans(**{k: torch.from_numpy(v) for k, v in (of_points | rings).items()})


class RelationOutput(NamedTuple):
    """What the network says of Q pairs of scans.

    Attributes:
        relations: (Q, M, 4) logits of `RELATIONS`.
        semantics: (Q, 2 N, 12) logits of `CLASSES` of the sources' points, then of the targets'.
    """

    relations: Tensor
    semantics: Tensor


class _Features(NamedTuple):
    """Of points of the sources (Q, N, local) and of all scans as targets (S, N, local), and of the
    pairs (Q, whole)."""

    source: Tensor
    target: Tensor
    whole: Tensor


class RelationNetwork(nn.Module):
    """Classifies pairs of points of two scans under a pose that is not quite right."""

    def __init__(self, config: RelationNetworkConfig = RelationNetworkConfig()) -> None:
        super().__init__()
        self.config = config
        local, whole, head = config.local, config.whole, config.head
        self.image = ImageFeatures(config.image)
        self.own = nn.Linear(OWN, local)
        self.around = nn.Linear(config.image, local, bias=False)
        self.placed = nn.Linear(PLACED, local, bias=False)
        self.near = nn.Sequential(nn.ReLU(), nn.Linear(local, local), nn.ReLU())
        self.far = nn.Sequential(nn.Linear(local, whole), nn.ReLU())
        self.norm = nn.LayerNorm(whole)
        self.source_side = SplitLinear(local, whole, head)
        self.target_side = nn.Linear(local, head, bias=False)
        self.measured = nn.Linear(GEOMETRY, head, bias=False)
        self.relation = nn.Sequential(
            nn.ReLU(), nn.Linear(head, head), nn.ReLU(), nn.Linear(head, len(RELATIONS))
        )
        self.meaning = SplitLinear(local, whole, local)
        self.named = nn.Sequential(nn.ReLU(), nn.Linear(local, len(CLASSES)))

    def forward(self, scans: RelationScans, pairs: PosedPairs) -> RelationOutput:
        """Relations, and the side task of naming every point."""
        features = self._features(scans, pairs)
        both = torch.cat([features.source, features.target[pairs.target]], dim=1)
        named: Tensor = self.named(self.meaning(both, features.whole))
        return RelationOutput(self._relations(features, scans, pairs), named)

    def relations(self, scans: RelationScans, pairs: PosedPairs) -> Tensor:
        """(Q, M, 4) logits of `RELATIONS` alone."""
        return self._relations(self._features(scans, pairs), scans, pairs)

    def _features(self, scans: RelationScans, pairs: PosedPairs) -> _Features:
        image = self.image(scans.ring_colour, scans.ring_depth, scans.pixels.clamp_min(0))
        shown = (scans.pixels != OUTSIDE)[..., None]
        alone = self.own(_own_inputs(scans)) + self.around(image * shown)
        target = self.near(alone + self.placed(_placed_inputs(scans.points, scans.normals, 1.0)))
        with torch.autocast(scans.points.device.type, enabled=False):
            there = moved(
                scans.points[pairs.source], scans.normals[pairs.source], pairs.target_T_source
            )
        source = self.near(alone[pairs.source] + self.placed(_placed_inputs(*there, 0.0)))
        of_source = self._pooled(source, scans.pooled[pairs.source])
        of_target = self._pooled(target, scans.pooled)[pairs.target]
        return _Features(source, target, self.norm(torch.maximum(of_source, of_target)))

    def _pooled(self, near: Tensor, pooled: Tensor) -> Tensor:
        """(B, N, local) of which (B, N) count to (B, whole)."""
        return torch.as_tensor((self.far(near) * pooled[..., None]).amax(dim=1))

    def _relations(self, features: _Features, scans: RelationScans, pairs: PosedPairs) -> Tensor:
        with torch.autocast(scans.points.device.type, enabled=False):
            geometry = pair_geometry(scans.points, scans.normals, pairs)
        each = torch.arange(len(pairs.source), device=pairs.source.device)
        hidden = self.measured(geometry)
        side = self.source_side(features.source, features.whole)
        hidden = hidden + picked(side, each, pairs.source_point)
        hidden = hidden + picked(
            self.target_side(features.target), pairs.target, pairs.target_point
        )
        return torch.as_tensor(self.relation(hidden))


def _own_inputs(scans: RelationScans) -> Tensor:
    """(S, N, OWN) what points are in their own scan's frame."""
    flags = torch.stack([scans.confidence, scans.predicted.to(scans.confidence.dtype)], dim=-1)
    place = POSITION_SCALE * scans.points
    return torch.cat([place, scans.normals, scans.colours - 0.5, flags], dim=-1)


def _placed_inputs(points: Tensor, normals: Tensor, target: float) -> Tensor:
    """(B, n, PLACED) where points are in the target's frame, and whether they are the target's."""
    side = torch.full_like(points[..., :1], target)
    return torch.cat([POSITION_SCALE * points, normals, side], dim=-1)


def _filled(values: FloatArray, rows: int) -> FloatArray:
    """(n, ...) with zeros up to a number of rows."""
    return np.pad(values, ((0, rows - len(values)), *((0, 0),) * (values.ndim - 1)))
