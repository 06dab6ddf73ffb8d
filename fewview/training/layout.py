"""How the layout network learns: what it should say, how far off it is, and figures of merit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview.completion.layout.complete import observed_cells
from fewview.completion.layout.grid import CLASSES, FREE, UNKNOWN, WALL, cell_centres, cells_of
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig, LayoutOutput
from fewview.completion.layout.points import POINTS
from fewview.evaluation.calibration import expected_calibration_error
from fewview.evaluation.segmentation import confusion, ious, mean_iou
from fewview.training import losses
from fewview.training.cell_matches import cell_matches, match_loss, match_recall
from fewview.training.point_batches import given, room_points
from fewview.training.problem import Batch, Problem
from fewview.types import Array, FloatArray

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

PRIOR_WEIGHT = 1.0
FLOOR_LEVERS_M = (1.0, 3.0, 3.0)


@dataclass(frozen=True)
class LayoutProblem(Problem):
    """Complete the layout of furnished rooms from what one scan measures of them."""

    size: LayoutNetworkConfig = field(default_factory=LayoutNetworkConfig)
    """Of the network."""
    points: int = POINTS
    """Points of a scan."""
    tilt_deg: float = 1.0
    """Standard deviation of the error of the level frame about each horizontal axis."""
    class_weights: tuple[float, ...] = (0.5, 2.0, 0.7, 1.5, 4.0)
    """Of unknown, wall, free floor, furniture, door."""
    unobserved: float = 1.0
    """What the cross-entropy of a cell counts that was not observed, against one that was."""
    floor: float = 0.5
    """Of the floor's error."""
    descriptor: float = 0.2
    """Of the contrastive loss."""
    matches: int = 128
    """Cells for the contrastive loss in each pair of views."""
    name: str = "layout"
    """Of the weights."""

    def network(self) -> LayoutNetwork:
        """A network that has learnt nothing yet."""
        network = LayoutNetwork(self.size)
        network.class_weights.copy_(torch.tensor(self.class_weights))
        return network

    def batch(self, rooms: Sequence[RoomSample], rng: np.random.Generator) -> Batch:
        """All cameras of the rooms: points, floor, layout (B, G, G) and matched cells."""
        scans = room_points(rooms, self.points, self.tilt_deg, rng)
        layout = torch.from_numpy(np.concatenate([room.layout for room in rooms]).astype(np.int64))
        layout, known = turned_layout(layout, scans.turns)
        matches = cell_matches(
            layout.numpy(), scans.room.numpy(), scans.frame_T_world, self.matches, rng
        )
        return {**scans.tensors(), "layout": layout, "layout_known": known, **matches}

    def losses(self, network: nn.Module, batch: Batch) -> Batch:
        """Weighted cross-entropy of the cells, floor error, and the descriptors' contrast."""
        output: LayoutOutput = network(given(batch))
        classes = torch.tensor(self.class_weights, device=output.logits.device)
        error = F.cross_entropy(output.logits, batch["layout"], reduction="none")
        weight = classes[batch["layout"]]
        weight = torch.where(observed_cells(output), weight, self.unobserved * weight)
        weight = weight * batch["layout_known"]
        floor = (output.floor - batch["floor"]) * error.new_tensor(FLOOR_LEVERS_M)
        return {
            "layout": losses.weighted_mean(error, weight),
            "floor": self.floor * F.smooth_l1_loss(floor, 0 * floor, beta=0.1),
            "descriptor": self.descriptor * match_loss(output.descriptors, batch),
        }

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Figures over the cells that were not observed, beside baselines; see `figures`."""
        output: LayoutOutput = network(given(batch))
        chance = cast(LayoutNetwork, network).probabilities(output.logits)
        truth, seen = batch["layout"], observed_cells(output)
        hidden = ~seen & batch["layout_known"]
        answers = {
            "": output.logits.argmax(dim=1),
            "copy_": torch.where(seen, truth, UNKNOWN),
            "prior_": cell_prior(truth, batch["room"]).argmax(dim=1),
        }
        out = {
            f"{name}{k}": v
            for name, answer in answers.items()
            for k, v in figures(answer, truth, hidden).items()
        }
        return {
            **out,
            "seen_accuracy": _mean(answers[""] == truth, seen),
            "calibration_error": calibration_error(chance, truth, batch["layout_known"]),
            "floor_error_m": float((output.floor - batch["floor"])[:, 0].abs().mean()),
            **match_recall(output.descriptors, seen, batch),
        }


def turned_layout(layout: Tensor, turns: Array | FloatArray) -> tuple[Tensor, Tensor]:
    """Layouts (B, G, G) on grids turned by (B, 3, 3) about the vertical, nearest cell.

    Returns:
        (B, G, G) and where they are known: the corners of a turned grid reach beyond the other.
    """
    back = torch.from_numpy(turns[:, None, :2, :2].astype(np.float32))
    places = torch.from_numpy(cell_centres()) @ back
    cells, inside = cells_of(places)
    found = layout.flatten(1).gather(1, cells.flatten(1)).reshape(layout.shape)
    return torch.where(inside, found, UNKNOWN), inside


def figures(answer: Tensor, truth: Tensor, hidden: Tensor) -> dict[str, float]:
    """How good layouts (B, G, G) are in the ``hidden`` cells, where nothing was seen.

    Returns:
        ``accuracy`` and ``iou`` (mean over the classes that occur) of those cells,
        ``free_iou`` and ``wall_iou`` among them, and of walls, the share of true ones within a
        cell of a predicted one (``wall_recall``) and the other way round (``wall_precision``).
    """
    where = hidden.cpu().numpy()
    counts = confusion(truth.cpu().numpy()[where], answer.cpu().numpy()[where], len(CLASSES))
    of_class = np.nan_to_num(ious(counts))
    wall, true_wall = answer == WALL, truth == WALL
    return {
        "accuracy": _mean(answer == truth, hidden),
        "iou": mean_iou(counts) if hidden.any() else 0.0,
        "free_iou": float(of_class[FREE]),
        "wall_iou": float(of_class[WALL]),
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


def calibration_error(chance: Tensor, truth: Tensor, where: Tensor) -> float:
    """Expected calibration error of the most probable class (Guo et al., ICML 2017, eq. 3)."""
    confidence, answer = chance.max(dim=1)
    right = (answer == truth)[where]
    return expected_calibration_error(confidence[where].cpu().numpy(), right.cpu().numpy())


def _mean(values: Tensor, where: Tensor) -> float:
    return float((values & where).sum() / where.sum().clamp(min=1))


def _grown(mask: Tensor) -> Tensor:
    return F.max_pool2d(mask[:, None].float(), 3, 1, 1)[:, 0] > 0
