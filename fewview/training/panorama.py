"""The 360-image completion network as a training problem (Sec. 3.2 and 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from torch import Tensor, nn

from fewview.completion.panorama import walls
from fewview.completion.panorama.network import (
    CLASSES,
    COARSE,
    PanoramaNetwork,
    PanoramaNetworkConfig,
    RingPrediction,
    network_input,
)
from fewview.completion.panorama.ring import unit
from fewview.evaluation.segmentation import confusion, mean_iou
from fewview.geometry import se3
from fewview.training import contrastive, losses
from fewview.training.problem import Batch, Problem
from fewview.types import BoolArray, IntArray

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

STACKED = ("colour", "depth", "normal", "semantics", "observed", "measured")
GREY = 127
MOST_LOG_ERROR = 2.0


@dataclass(frozen=True)
class PanoramaProblem(Problem):
    """Complete rings of furnished rooms from what one scan measures of them."""

    size: PanoramaNetworkConfig = field(default_factory=PanoramaNetworkConfig)
    """Of the network."""
    depth_likelihood: float = 0.2
    """Of the Laplace likelihood of the logarithm of the depth."""
    depth_l1: float = 0.5
    """Of the absolute error of the logarithm of the depth."""
    depth_relative: float = 0.5
    """Of the relative error of the depth."""
    normal: float = 1.0
    """Of the normals' cosine and absolute error."""
    semantics: float = 0.3
    """Of the cross-entropy."""
    descriptor: float = 0.3
    """Of the contrastive loss."""
    measured: float = 0.3
    """What a measured pixel counts against one that has to be guessed."""
    colourless: float = 0.15
    """Share of the training rings without colour, so that geometry alone is believed as well."""
    pairs: int = 320
    """Places for the contrastive loss in each pair of views."""
    class_weights: tuple[float, ...] = (0.0, 0.4, 0.8, 0.6, 1.0, 1.1, 2.0, 2.5, 4.0, 5.0, 1.0, 1.0)
    """Of unknown, wall, floor, ceiling, door, window, table, chair, sofa, bed, cabinet, other."""
    name: str = "panorama"
    """Of the weights."""

    def network(self) -> nn.Module:
        return PanoramaNetwork(self.size)

    def batch(self, rooms: Sequence[RoomSample], rng: np.random.Generator) -> Batch:
        """Views of all rooms one after the other, along the walls that each shows, with the names
        of `RoomSample`, and the places they share."""
        rooms = [along_walls(room) for room in rooms]
        rings = {name: np.concatenate([getattr(r, name) for r in rooms]) for name in STACKED}
        poses = se3.inverse(np.concatenate([room.level_T_world for room in rooms]))
        return {
            **{name: torch.from_numpy(array) for name, array in rings.items()},
            "world_T_level": torch.from_numpy(poses.astype(np.float32)),
            "chance": torch.from_numpy(rng.random(len(poses), dtype=np.float32)),
            **contrastive.sample_pairs(rooms, self.pairs, rng),
        }

    def losses(self, network: nn.Module, batch: Batch) -> dict[str, Tensor]:
        colour = batch["colour"]
        if network.training:
            without = (batch["chance"] < self.colourless)[:, None, None, None]
            colour = torch.where(without, torch.full_like(colour, GREY), colour)
        answer: RingPrediction = network(network_input(colour, batch["measured"]))
        known, seen = batch["depth"] > 0, batch["measured"] > 0
        weight = known * torch.where(seen, self.measured, 1.0)
        error = (answer.log_depth - _log(batch["depth"])).abs()
        normal = losses.normal_error(answer.normal, batch["normal"].permute(0, 3, 1, 2))
        classes = torch.tensor(self.class_weights, device=weight.device)
        labels = batch["semantics"][:, ::COARSE, ::COARSE].long()
        return {
            "depth_likelihood": self.depth_likelihood
            * losses.weighted_mean(losses.laplace(error, answer.log_scale), weight),
            "depth_l1": self.depth_l1 * losses.weighted_mean(error, weight),
            "depth_relative": self.depth_relative
            * losses.weighted_mean(_relative_error(answer.log_depth, batch["depth"]), weight),
            "normal": self.normal * losses.weighted_mean(normal, weight),
            "semantics": self.semantics * losses.semantics(answer.semantics, labels, classes),
            "descriptor": self.descriptor * _contrast(answer.descriptor, batch),
        }

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Errors inside and outside what the cameras saw, and recalls of the descriptors.

        Beside them the depth error of a baseline that knows no scan: the median of the batch.
        """
        answer: RingPrediction = network(network_input(batch["colour"], batch["measured"]))
        known = batch["depth"] > 0
        out: dict[str, float] = {}
        parts = {"unobserved": ~batch["observed"] & known, "observed": batch["measured"] > 0}
        for part, pixels in parts.items():
            figures = _geometry_figures(answer, batch, pixels)
            figures["semantics_iou"] = _mean_iou(answer.semantics, batch["semantics"], pixels)
            out |= {f"{name}_{part}": value for name, value in figures.items()}
        median = torch.where(known, batch["depth"], torch.nan).nanmedian(dim=0).values
        error = (median - batch["depth"]).abs() / batch["depth"]
        out["median_depth_relative_unobserved"] = float(error[parts["unobserved"]].mean())
        return out | contrastive.recall(unit(answer.descriptor), batch)


def along_walls(room: RoomSample) -> RoomSample:
    """The views of a room as rings along the walls that they show; unknown where not covered."""
    size = room.depth.shape[1]
    views = []
    for view in range(len(room.depth)):
        azimuth = walls.wall_azimuth(walls.seen_normals(room.measured[view]))
        pixels, scale, inside = walls.turned_pixels(size, azimuth)
        ring = {n: _gathered(getattr(room, n)[view], pixels, inside) for n in STACKED}
        back = walls.about_vertical(-azimuth)
        ring["depth"], ring["measured"] = ring["depth"] * scale, ring["measured"] * scale
        ring["normal"] = ring["normal"] @ back[:3, :3].T.astype(np.float32)
        views.append({**ring, "level_T_world": back @ room.level_T_world[view]})
    stacked = {name: np.stack([view[name] for view in views]) for name in views[0]}
    return cast("RoomSample", SimpleNamespace(**{**vars(room), **stacked}))


def _gathered(ring: np.ndarray, pixels: IntArray, inside: BoolArray) -> np.ndarray:
    values = ring.reshape(-1, *ring.shape[2:])[pixels]
    values[~inside] = 0
    return values


def _contrast(descriptor: Tensor, batch: Batch) -> Tensor:
    size = batch["depth"].shape[1]
    first, second = batch["rings"].unbind(dim=1)
    source = contrastive.picked(descriptor, first, batch["source"], size)
    target = contrastive.picked(descriptor, second, batch["target"], size)
    where = contrastive.places(batch, first, batch["source"])
    return losses.info_nce(unit(source.mT).mT, unit(target.mT).mT, where, batch["valid"])


def _geometry_figures(answer: RingPrediction, batch: Batch, pixels: Tensor) -> dict[str, float]:
    truth = batch["depth"][pixels]
    error = (answer.log_depth.exp()[pixels] - truth).abs()
    log_error = (answer.log_depth[pixels] - _log(truth)).abs()
    cosine = (answer.normal.permute(0, 2, 3, 1) * batch["normal"]).sum(dim=-1)[pixels]
    angle = torch.rad2deg(torch.acos(cosine.clamp(-1.0, 1.0)))
    return {
        "depth_l1_m": float(error.mean()),
        "depth_relative": float((error / truth).mean()),
        "depth_log_scale": float(answer.log_scale[pixels].exp().mean() / log_error.mean()),
        "normal_mean_deg": float(angle.mean()),
        "normal_median_deg": float(angle.median()),
        "normal_within_30": float((angle < 30.0).float().mean()),
    }


def _mean_iou(logits: Tensor, truth: Tensor, pixels: Tensor) -> float:
    """Intersection over union, averaged over the classes that occur in the truth."""
    guess = logits[:, 1:].argmax(dim=1) + 1
    labels, where = truth[:, ::COARSE, ::COARSE], pixels[:, ::COARSE, ::COARSE]
    counts = confusion(labels[where].cpu().numpy(), guess[where].cpu().numpy(), len(CLASSES))
    counts[0] = 0
    return mean_iou(counts)


def _relative_error(log_depth: Tensor, depth: Tensor) -> Tensor:
    return ((log_depth - _log(depth)).clamp(max=MOST_LOG_ERROR).exp() - 1.0).abs()


def _log(depth: Tensor) -> Tensor:
    return depth.clamp_min(0.05).log()
