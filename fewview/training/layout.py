"""How the layout network learns: what it should say, how far off it is, and figures of merit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from fewview.completion.layout.complete import observed_cells
from fewview.completion.layout.grid import CLASSES, FREE, UNKNOWN, WALL
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig, LayoutOutput
from fewview.training.cell_matches import cell_matches, match_loss, match_recall
from fewview.training.point_batches import given, room_points

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

PRIOR_WEIGHT = 1.0


@dataclass(frozen=True)
class LayoutProblem:
    """The 2D layout completion network and its training.

    Attributes:
        size: of the network.
        points: per scan.
        tilt_deg: standard deviation of the error of the level frame.
        class_weights: of the cross-entropy, one per class.
        unseen_weight: of the cross-entropy in cells that were not observed, against 1.
        floor_weight, match_weight: of the floor's and the descriptors' terms.
        matches: cells compared between two cameras of a room.
    """

    size: LayoutNetworkConfig = field(default_factory=LayoutNetworkConfig)
    points: int = 2048
    tilt_deg: float = 1.0
    class_weights: tuple[float, ...] = (0.5, 2.0, 0.7, 1.5, 4.0)
    unseen_weight: float = 1.0
    floor_weight: float = 0.5
    match_weight: float = 0.1
    matches: int = 128
    name: str = "layout"

    def network(self) -> LayoutNetwork:
        """A network that has learnt nothing yet."""
        network = LayoutNetwork(self.size)
        network.class_weights.copy_(torch.tensor(self.class_weights))
        return network

    def batch(self, rooms: Sequence[RoomSample], rng: np.random.Generator) -> dict[str, Tensor]:
        """All cameras of the rooms: points, floor, layout (B, G, G) and matched cells."""
        given_points = room_points(rooms, self.points, self.tilt_deg, rng)
        layout = np.concatenate([room.layout for room in rooms])
        found = cell_matches(
            layout, given_points.room.numpy(), given_points.level_T_world, self.matches, rng
        )
        return {
            **given_points.tensors(),
            "layout": torch.from_numpy(layout.astype(np.int64)),
            **found,
        }

    def losses(self, network: LayoutNetwork, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Weighted cross-entropy of the cells, floor error, and the descriptors' contrast."""
        output: LayoutOutput = network(given(batch))
        error = F.cross_entropy(output.logits, batch["layout"], reduction="none")
        weight = network.class_weights[batch["layout"]]
        weight = torch.where(observed_cells(output), weight, self.unseen_weight * weight)
        floor = output.floor - batch["floor"]
        slope = floor.new_tensor([1.0, 3.0, 3.0])
        return {
            "layout": (weight * error).sum() / weight.sum(),
            "floor": self.floor_weight * F.smooth_l1_loss(slope * floor, 0 * floor, beta=0.1),
            "match": self.match_weight * match_loss(output.descriptors, batch),
        }

    def metrics(self, network: LayoutNetwork, batch: Mapping[str, Tensor]) -> dict[str, float]:
        """Figures over the cells that were not observed, beside baselines; see `figures`."""
        with torch.no_grad():
            output: LayoutOutput = network(given(batch))
            chance = network.probabilities(output.logits)
        truth, seen = batch["layout"], observed_cells(output)
        copied = torch.where(seen, truth, UNKNOWN)
        prior = cell_prior(truth, batch["room"]).argmax(dim=1)
        out = figures(chance.argmax(dim=1), truth, seen)
        out |= {f"copy_{k}": v for k, v in figures(copied, truth, seen).items()}
        out |= {f"prior_{k}": v for k, v in figures(prior, truth, seen).items()}
        out["seen_accuracy"] = _mean(chance.argmax(dim=1) == truth, seen)
        out["calibration_error"] = calibration_error(chance, truth)
        out["floor_error_m"] = float((output.floor - batch["floor"])[:, 0].abs().mean())
        return out | match_recall(output.descriptors, seen, batch)


def figures(answer: Tensor, truth: Tensor, seen: Tensor) -> dict[str, float]:
    """How good layouts (B, G, G) are where nothing was seen.

    Returns:
        ``accuracy`` and ``iou`` (mean over the classes that occur) of the unseen cells,
        ``free_iou`` and ``wall_iou`` among them, and of walls, the share of true ones within a
        cell of a predicted one (``wall_recall``) and the other way round (``wall_precision``).
    """
    hidden = ~seen
    ious = [_iou(answer == c, truth == c, hidden) for c in range(len(CLASSES))]
    present = [iou for c, iou in enumerate(ious) if bool(((truth == c) & hidden).any())]
    wall, true_wall = answer == WALL, truth == WALL
    return {
        "accuracy": _mean(answer == truth, hidden),
        "iou": float(np.mean(present)) if present else 0.0,
        "free_iou": ious[FREE],
        "wall_iou": ious[WALL],
        "wall_recall": _mean(_grown(wall), true_wall & hidden),
        "wall_precision": _mean(_grown(true_wall), wall & hidden),
    }


def cell_prior(truth: Tensor, room: Tensor) -> Tensor:
    """Class frequencies (B, 5, G, G) per cell over the cameras of all other rooms."""
    counts = F.one_hot(truth, len(CLASSES)).permute(0, 3, 1, 2).float()
    own = counts.new_zeros(int(room.max()) + 1, *counts.shape[1:]).index_add(0, room, counts)
    others = counts.sum(dim=0) - own[room]
    overall = counts.mean(dim=(0, 2, 3))[:, None, None]
    total = others + PRIOR_WEIGHT * overall
    return total / total.sum(dim=1, keepdim=True)


def calibration_error(chance: Tensor, truth: Tensor, bins: int = 10) -> float:
    """Expected calibration error of the most probable class (Guo et al., ICML 2017, eq. 3)."""
    confidence, answer = chance.max(dim=1)
    right = (answer == truth).float()
    number = (confidence * bins).long().clamp(max=bins - 1).flatten()
    gap = torch.zeros(bins, device=chance.device)
    gap = gap.index_add(0, number, (confidence - right).flatten())
    return float(gap.abs().sum() / right.numel())


def _iou(a: Tensor, b: Tensor, where: Tensor) -> float:
    return float((a & b & where).sum() / ((a | b) & where).sum().clamp(min=1))


def _mean(values: Tensor, where: Tensor) -> float:
    return float((values & where).sum() / where.sum().clamp(min=1))


def _grown(mask: Tensor) -> Tensor:
    return F.max_pool2d(mask[:, None].float(), 3, 1, 1)[:, 0] > 0
