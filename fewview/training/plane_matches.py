"""The same plane seen or guessed by two cameras: contrast of the planes' descriptors."""

from __future__ import annotations

import torch
from torch import Tensor

from fewview.completion.structure.network import LevelPrediction, PointPrediction, WallPrediction
from fewview.training import losses
from fewview.training.problem import Batch

TEMPERATURE = 0.1
HIDDEN = -1e4
MIN_SEEN = 30


def match_loss(
    points: PointPrediction, walls: WallPrediction, levels: LevelPrediction, batch: Batch
) -> Tensor:
    """Descriptors of one plane in two cameras should be more alike than those of two planes.

    Points, predicted walls and levels of a camera are compared with all those of the next one of
    its room (Khosla et al., "Supervised Contrastive Learning", 2020, Eq. 2).
    """
    descriptors, plane = _described(points, walls, levels, batch)
    a, b = batch["match_pairs"].unbind(dim=1)
    logits = descriptors[a] @ descriptors[b].mT / TEMPERATURE
    same = (plane[a][:, :, None] == plane[b][:, None]) & (plane[a] >= 0)[:, :, None]
    logits = logits.masked_fill((plane[b] < 0)[:, None], HIDDEN)
    share = logits.log_softmax(dim=2)
    found = (share * same).sum(dim=2) / same.sum(dim=2).clamp(min=1)
    return losses.weighted_mean(-found, same.any(dim=2).float())


def match_recall(
    points: PointPrediction, walls: WallPrediction, levels: LevelPrediction, batch: Batch
) -> dict[str, float]:
    """How often a wall's most alike wall in the next camera is itself (``wall_match_1``).

    Among true walls in slots only; ``oo``, ``op``, ``pp``: seen by both, one, none of the cameras;
    ``chance``: what luck would give.
    """
    slot = batch["wall_plane"]
    seen = seen_planes(batch).gather(1, slot.clamp(min=0)) & (slot >= 0)
    a, b = batch["match_pairs"].unbind(dim=1)
    alike = walls.descriptor[a] @ walls.descriptor[b].mT
    alike = alike.masked_fill((slot[b] < 0)[:, None], -2.0)
    same = (slot[a][:, :, None] == slot[b][:, None]) & (slot[a] >= 0)[:, :, None]
    there = same.any(dim=2)
    hit = same.gather(2, alike.argmax(dim=2, keepdim=True))[..., 0]
    seen_there = (same & seen[b][:, None]).any(dim=2)
    both, none = there & seen[a] & seen_there, there & ~seen[a] & ~seen_there
    groups = {"oo": both, "op": there & ~both & ~none, "pp": none}
    out = {f"wall_match_1_{k}": float(hit[g].float().mean()) for k, g in groups.items()}
    chance = same.sum(dim=2) / (slot[b] >= 0).sum(dim=1, keepdim=True).clamp(min=1)
    return out | {"wall_match_chance_1": float(chance[there].mean())}


def seen_planes(batch: Batch) -> Tensor:
    """(B, P) planes on which at least `MIN_SEEN` different points of the scan lie."""
    label = batch["point_plane"]
    counts = torch.zeros_like(batch["plane_kind"])
    counts = counts.scatter_add(1, label.clamp(min=0), (label >= 0).long())
    return counts >= MIN_SEEN


def _described(
    points: PointPrediction, walls: WallPrediction, levels: LevelPrediction, batch: Batch
) -> tuple[Tensor, Tensor]:
    """Descriptors (B, M + K + 2, D) and the planes (B, M + K + 2) that they belong to, -1 none."""
    chosen = batch["match_points"]
    size = points.descriptor.shape[-1]
    near = points.descriptor.gather(1, chosen[..., None].expand(-1, -1, size))
    shown = batch["point_plane"].gather(1, chosen)
    plane = torch.cat([shown, batch["wall_plane"], batch["level_plane"]], dim=1)
    return torch.cat([near, walls.descriptor, levels.descriptor], dim=1), plane
