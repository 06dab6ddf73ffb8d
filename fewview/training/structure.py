"""The planar patch completion network as a training problem (Sec. 3.2 and supplementary)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview.completion.layout.points import POINTS
from fewview.completion.structure.network import (
    LevelPrediction,
    PointPrediction,
    StructureNetwork,
    StructureNetworkConfig,
    WallPrediction,
)
from fewview.training import losses
from fewview.training.plane_figures import (
    level_heights,
    plane_figures,
    point_centres,
    point_figures,
)
from fewview.training.plane_matches import match_loss, match_recall
from fewview.training.point_batches import given
from fewview.training.problem import Batch, Problem
from fewview.training.structure_batch import structure_batch

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample


@dataclass(frozen=True)
class StructureProblem(Problem):
    """Name the planes of furnished rooms from what one scan measures of them."""

    size: StructureNetworkConfig = field(default_factory=StructureNetworkConfig)
    """Of the network."""
    points: int = POINTS
    """Points of a scan."""
    tilt_deg: float = 1.0
    """Standard deviation of the error of the level frame about each horizontal axis."""
    normal: float = 0.5
    """Of the points' normals."""
    offset: float = 0.3
    """Of the Laplace likelihood of the offset to the centre of a point's plane."""
    semantics: float = 0.3
    """Of the points' cross-entropy."""
    exists: float = 3.0
    """Of the cross-entropy whether there is a wall."""
    azimuth: float = 5.0
    """Of the walls' error of direction, radians."""
    distance: float = 1.0
    """Of the Laplace likelihood of the walls' distance."""
    middle: float = 0.3
    """Of the Laplace likelihood of the walls' middle."""
    level: float = 0.5
    """Of the Laplace likelihood of the heights of floor and ceiling."""
    descriptor: float = 0.2
    """Of the contrastive loss."""
    matches: int = 64
    """Points of a scan for the contrastive loss."""
    class_weights: tuple[float, ...] = (0.0, 0.4, 0.8, 0.6, 1.0, 1.1, 2.0, 2.5, 2.0, 3.0, 1.0, 1.0)
    """Of unknown, wall, floor, ceiling, door, window, table, chair, sofa, bed, cabinet, other."""
    name: str = "structure"
    """Of the weights."""

    def network(self) -> StructureNetwork:
        """A network that has learnt nothing yet."""
        return StructureNetwork(self.size)

    def batch(self, rooms: Sequence[RoomSample], rng: np.random.Generator) -> Batch:
        """All cameras of the rooms: points with their planes, walls in slots, floor and ceiling."""
        return structure_batch(rooms, self.points, self.tilt_deg, self.matches, rng)

    def losses(self, network: nn.Module, batch: Batch) -> Batch:
        """What points, walls and levels are off by, and the descriptors' contrast."""
        points, walls, levels = network(given(batch))
        return {
            **self._point_losses(points, batch),
            **self._wall_losses(walls, batch),
            "level": self.level * _level_loss(levels, batch),
            "descriptor": self.descriptor * match_loss(points, walls, levels, batch),
        }

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Precision and recall of walls, seen and not, beside a box; errors; recall of planes."""
        points, walls, levels = network(given(batch))
        return {
            **plane_figures(walls, levels, batch),
            **point_figures(points, batch),
            **match_recall(points, walls, levels, batch),
        }

    def _point_losses(self, points: PointPrediction, batch: Batch) -> Batch:
        valid = batch["valid"].float()
        normal = losses.normal_error(points.normal.mT, batch["point_normal"].mT)
        turned = batch["point_normal"].norm(dim=-1) > 0.5
        centre, known = point_centres(batch)
        error = (batch["points"] + points.offset - centre).abs().sum(dim=-1)
        offset = losses.laplace(error, points.log_scale)
        classes = torch.tensor(self.class_weights, device=valid.device)
        return {
            "normal": self.normal * losses.weighted_mean(normal, valid * turned),
            "offset": self.offset * losses.weighted_mean(offset, valid * known),
            "semantics": self.semantics
            * losses.semantics(points.semantics.mT, batch["point_class"] * batch["valid"], classes),
        }

    def _wall_losses(self, walls: WallPrediction, batch: Batch) -> Batch:
        there = (batch["wall_plane"] >= 0).float()
        turn = walls.azimuth - batch["wall_azimuth"]
        azimuth = torch.atan2(turn.sin(), turn.cos()).abs()
        away = (walls.distance - batch["wall_distance"]).abs()
        beside = (walls.middle - batch["wall_middle"]).abs()
        distance = losses.laplace(away, walls.distance_log_scale)
        middle = losses.laplace(beside, walls.middle_log_scale)
        known = there * batch["wall_middle_known"]
        return {
            "exists": self.exists * F.binary_cross_entropy_with_logits(walls.exists, there),
            "azimuth": self.azimuth * losses.weighted_mean(azimuth, there),
            "distance": self.distance * losses.weighted_mean(distance, there),
            "middle": self.middle * losses.weighted_mean(middle, known),
        }


def _level_loss(levels: LevelPrediction, batch: Batch) -> Tensor:
    truth, known = level_heights(batch)
    error = (levels.height - truth).abs()
    return losses.weighted_mean(losses.laplace(error, levels.log_scale), known.float())
