"""Places that two cameras of a room share, and how well descriptors find them.

A pixel of one ring and a pixel of another are a positive pair when the true points they show are
within 0.08 m of each other (Yang et al., CVPR 2019), whether the scans saw them or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from fewview.completion.panorama.ring import ring_pixels, ring_points, ring_rays
from fewview.geometry import se3
from fewview.training.losses import SAME_PLACE_M
from fewview.training.problem import Batch
from fewview.types import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

POSITIVE_M = 0.08
PROPOSALS = 8
PLAIN_CLASSES = (1, 2, 3)
PLAIN_WEIGHT = 0.35
KINDS = ("observed_observed", "observed_predicted", "predicted_predicted")
CANDIDATE_ROWS = 16


def sample_pairs(rooms: Sequence[RoomSample], count: int, rng: np.random.Generator) -> Batch:
    """Positive pairs between all cameras of each room.

    Sampled so that the three `KINDS` come about equally often, and walls, floor and ceiling a
    third as often as their area says.

    Args:
        rooms: R rooms of V views.
        count: n, places for each of the P = R V (V - 1) / 2 pairs of views.

    Returns:
        rings (P, 2) index into the R V rings of the batch; source and target (P, n) flat pixels;
        kind (P, n) index into `KINDS`; valid (P, n).
    """
    found = []
    for number, room in enumerate(rooms):
        views = len(room.depth)
        points = ring_points(room.depth).reshape(views, -1, 3).astype(np.float64)
        for a, b in combinations(range(views), 2):
            chosen = _sample(room, points, a, b, count, rng)
            found.append((np.array([number * views + a, number * views + b]), *chosen))
    names = ("rings", "source", "target", "kind", "valid")
    columns = zip(*found, strict=True)
    return {name: torch.from_numpy(np.stack(c)) for name, c in zip(names, columns, strict=True)}


def _sample(
    room: RoomSample, points: Array, a: int, b: int, count: int, rng: np.random.Generator
) -> tuple[IntArray, IntArray, IntArray, BoolArray]:
    source = rng.integers(points.shape[1], size=PROPOSALS * count)
    b_T_a = room.level_T_world[b] @ se3.inverse(room.level_T_world[a])
    there = se3.transform(b_T_a, points[a, source])
    target, _, inside = ring_pixels(there, room.depth.shape[1])
    gap = np.linalg.norm(points[b, target] - there, axis=1)
    good = np.flatnonzero(inside & (gap < POSITIVE_M) & (room.depth[a].ravel()[source] > 0))
    if len(good) == 0:
        nothing = np.zeros(count, dtype=np.int64)
        return nothing, nothing, nothing, np.zeros(count, dtype=bool)
    source, target = source[good], target[good]
    seen_a, seen_b = (room.measured[v].ravel() > 0 for v in (a, b))
    kind = 2 - seen_a[source].astype(np.int64) - seen_b[target]
    weight = 1.0 / np.bincount(kind, minlength=3)[kind]
    plain = np.isin(room.semantics[a].ravel()[source], PLAIN_CLASSES)
    weight *= np.where(plain, PLAIN_WEIGHT, 1.0)
    chosen = rng.choice(len(good), size=count, p=weight / weight.sum())
    return source[chosen], target[chosen], kind[chosen], np.ones(count, dtype=bool)


def places(batch: Batch, rings: Tensor, pixels: Tensor) -> Tensor:
    """World points (P, n, 3) that pixels (P, n) of rings (P,) truly show.

    The batch has depth (B, S, 4 S) and world_T_level (B, 4, 4).
    """
    depth = batch["depth"]
    rays = torch.from_numpy(ring_rays(depth.shape[1])).to(depth.device).flatten(0, 1)
    along = depth.flatten(1)[rings[:, None], pixels]
    pose = batch["world_T_level"][rings]
    return along[..., None] * rays[pixels] @ pose[:, :3, :3].mT + pose[:, None, :3, 3]


def recall(descriptors: Tensor, batch: Batch) -> dict[str, float]:
    """How often the descriptor of a place finds it among about 1000 places of the other view.

    A hit lies within 0.16 m of the place; places that no candidate comes so near do not count.
    Beside recall@1 and @5 the share of candidates that are hits: what choosing blindly gives.

    Args:
        descriptors: (B, D, S/2, 2 S) unit.
        batch: with what `sample_pairs` and `places` name.
    """
    size = batch["depth"].shape[1]
    first, second = batch["rings"].unbind(dim=1)
    queries = picked(descriptors, first, batch["source"], size)
    grid = candidate_pixels(size).to(second.device).expand(len(second), -1)
    found = picked(descriptors, second, grid, size)
    gap = torch.cdist(places(batch, first, batch["source"]), places(batch, second, grid))
    near = gap < SAME_PLACE_M
    order = (queries @ found.mT).topk(5, dim=2).indices
    hits = near.gather(2, order)
    counted = batch["valid"] & near.any(dim=2)
    out = {}
    for number, kind in enumerate(KINDS):
        of_kind = counted & (batch["kind"] == number)
        out[f"recall_1_{kind}"] = _mean(hits[..., 0][of_kind])
        out[f"recall_5_{kind}"] = _mean(hits.any(dim=2)[of_kind])
        out[f"chance_1_{kind}"] = _mean(near.float().mean(dim=2)[of_kind])
    return out


def candidate_pixels(size: int) -> Tensor:
    """(1024,) flat pixels on a grid over a ring."""
    step = size // CANDIDATE_ROWS
    rows = torch.arange(step // 2, size, step)
    columns = torch.arange(step // 2, 4 * size, step)
    return (rows[:, None] * 4 * size + columns).flatten()


def picked(descriptors: Tensor, rings: Tensor, pixels: Tensor, size: int) -> Tensor:
    """(P, n, D) of flat full-resolution pixels (P, n) from coarser maps (B, D, h, w)."""
    scale = size // descriptors.shape[2]
    row, column = pixels // (4 * size) // scale, pixels % (4 * size) // scale
    return descriptors.permute(0, 2, 3, 1)[rings[:, None], row, column]


def _mean(values: Tensor) -> float:
    return float(values.float().mean()) if values.numel() else float("nan")
